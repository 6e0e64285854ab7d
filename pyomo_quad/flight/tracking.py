"""Simulated flights that follow a solution on a coarse mesh under feedback, to make it flyable.

Between its collocation points, the solution satisfies the equations of motion only approximately.
Its controls alone would miss the goal. A linear-quadratic regulator keeps the simulated vehicle
near the solution. The simulated states and controls satisfy the equations, at nearly the same
energy. Derivation and sources: docs/theory/tracking.md, eqs. (1) to (4), (6) and (7).

Arguments `demands` are changes of the path that the vehicle follows. They move the path out of
zones and away from limits, and set its velocity to zero while the mission hovers at a waypoint.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from math import ceil
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.collocation import ClosedLoop, OpenLoopSteps, control_polynomial, interpolate
from pyomo_quad.flight.deadline import keep_time
from pyomo_quad.flight.displacement import displaced
from pyomo_quad.flight.flight import (
    HELD_BREACH,
    POSITION_STATES,
    TILT_STATES,
    VELOCITY_STATES,
)
from pyomo_quad.flight.integration import discrete
from pyomo_quad.flight.plan import Trajectories
from pyomo_quad.flight.state_shifts import shifted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pyomo_quad.arrays import FloatArray
    from pyomo_quad.collocation import Dynamics, Mesh
    from pyomo_quad.flight.displacement import Displacement
    from pyomo_quad.flight.state_shifts import StateShift

# Interval between corrections of the feedback [s]: a tenth of the time in which the vehicle changes
# its tilt.
_LONGEST_S = 0.2
# Deviations of the states that the regulator weighs equally, in the unit of each state: a few
# centimetres and hundredths of a radian are small for a flight over many metres.
_DEVIATIONS = {
    **dict.fromkeys(POSITION_STATES, 0.05),
    **dict.fromkeys(VELOCITY_STATES, 0.1),
    **dict.fromkeys(TILT_STATES, 0.05),
    "rigid_body.psi": 0.05,
    "rigid_body.p": 0.3,
    "rigid_body.q": 0.3,
    "rigid_body.r": 1.0,
}
_ROTOR_SPEED, _ROTOR_DEVIATION = "rotors.omega[", 5.0
# Deviation of the rate of the yaw angle [rad/s], and of a velocity during a hover at a waypoint
# [m/s], that the regulator weighs like the deviations above. The limit on that velocity is 0.1 m/s.
_TURNING, _AT_REST = 3e-3, 0.02
# Factor on the weight of a state while the path is shifted in it.
_CLOSELY = 30.0
# Roll and yaw angle, and the body rates about the pitch and yaw axes.
_ROLL, _YAW, _Q, _R = "rigid_body.phi", "rigid_body.psi", "rigid_body.q", "rigid_body.r"
# Parameter of missions that keep the yaw angle.
_KEPT_HEADING = "mission.turning_max"
# Difference below which two times are equal [s].
_SAME_S = 1e-9
# Correction of a rotor's acceleration that the regulator weighs like the deviations above
# [rad/s^2]; and factor on the weights of the states at the end, where the vehicle must be at its
# goal.
_CORRECTION, _AT_THE_END = 200.0, 50.0
# Relative and absolute tolerance of the simulation; and the magnitude of a state, in its unit,
# above which the vehicle is lost.
_INTEGRATION, _LOST = 1e-10, 1e6


@dataclass(frozen=True, kw_only=True)
class Demands:
    """Changes of the path that a simulated vehicle follows.

    Without demands, the vehicle follows the path of a solution on a coarse mesh.

    Attributes
    ----------
    displacement : tuple of Push
        Displacements, each by one vector during a span of time; they are added.
    rests : tuple of (float, float)
        Start and end of hovers [s], in which the vehicle shall be at rest.
    shifts : tuple of StateShift
        Shifts in tilt, speed and rotor speeds, away from limits.
    """

    displacement: Displacement = ()
    rests: tuple[tuple[float, float], ...] = ()
    shifts: tuple[StateShift, ...] = ()


#: The path is that of the coarse solution.
NO_DEMANDS = Demands()


def can_be_tracked(dynamics: Dynamics) -> bool:
    """Return whether a model has all states that the linear-quadratic regulator needs.

    The regulator makes a simulated vehicle follow a solution on a coarse mesh. It needs position,
    velocity, attitude and body rates among the states of the equations `dynamics`.
    """
    return set(_DEVIATIONS) <= set(dynamics.state_names)


def tracked(
    dynamics: Dynamics,
    coarse: Trajectories,
    demands: Demands = NO_DEMANDS,
    previous: Trajectories | None = None,
) -> Trajectories | None:
    """Return the simulated flight of a vehicle that follows a coarse solution under feedback.

    `demands` changes the path that the vehicle follows. The controls anticipate the deviations in
    `previous`, an earlier result for `coarse`. The regulator corrects the controls once in each
    mesh element. Elements longer than 0.2 s are split, so that it corrects at least every 0.2 s.

    The result is None if the vehicle cannot follow the solution. Raises a SolveError if the
    integration fails, or the enclosing `Deadline` has passed.
    """
    start, end = coarse.horizon
    mesh = _split(coarse.mesh, end - start)
    borders = start + (end - start) * np.asarray(mesh.breakpoints)
    points = start + (end - start) * mesh.point_fractions
    path = _Path(
        mesh=mesh,
        borders=borders,
        points=points,
        states=coarse.states_at(borders),
        controls=coarse.controls_at(points),
    )
    aside = _aside(dynamics, path, demands)
    regulator = _regulator(dynamics, coarse, borders, demands)
    disturbances = regulator.driven_by(aside)
    if previous is not None:
        disturbances += _disturbances(path, regulator, previous)
    commands = _anticipating(regulator, disturbances)
    flown = _followed(dynamics, replace(path, states=path.states + aside), regulator, commands)
    if flown is None:
        return None
    joint, controls = flown

    def between(values: FloatArray) -> FloatArray:
        return interpolate(coarse.mesh, values, mesh.point_fractions, with_start=False)

    return Trajectories(
        mesh=mesh,
        horizon=coarse.horizon,
        state_names=coarse.state_names,
        control_names=coarse.control_names,
        costate_names=coarse.costate_names,
        states=joint[:, :-1],
        controls=controls,
        energy=joint[:, -1],
        costates=between(coarse.costates),
        hamiltonian=between(coarse.hamiltonian[:, None])[:, 0],
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Path:
    """Path that a simulated vehicle follows, on the mesh of its flight.

    At the element boundaries `borders` [s], it has the states `states`. At the collocation points
    `points` [s], it has the uncorrected controls `controls`.
    """

    mesh: Mesh
    borders: FloatArray
    points: FloatArray
    states: FloatArray
    controls: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class _Regulator:
    """Linear-quadratic regulator that keeps a simulated vehicle on its path.

    Each array has one entry for each of n mesh elements. Equations: docs/theory/tracking.md.

    Attributes
    ----------
    transitions, driven : ndarray, shapes (n, n_states, n_states), (n, n_states, n_controls)
        Matrices F and G of eq. (2), d_end = F d_start + G c, for a deviation d of the states and a
        correction c of the controls.
    gains : ndarray, shape (n, n_controls, n_states)
        Matrices K of eq. (4). The feedback is c = -K d_start.
    values : ndarray, shape (n, n_states, n_states)
        Matrices P of eq. (4), at the ends of the elements: d^T P d is the cost from there to the
        end of the flight.
    inverses : ndarray, shape (n, n_controls, n_controls)
        Matrices (h R + G^T P G)^-1 of eq. (4), where h is the duration of the element and R has the
        weights of squared corrections.
    """

    transitions: FloatArray
    driven: FloatArray
    gains: FloatArray
    values: FloatArray
    inverses: FloatArray

    def driven_by(self, aside: FloatArray) -> FloatArray:
        """Return the disturbances of the regulated system that a displacement of the path causes.

        `aside` has the displacement of the path's states at the n + 1 ends of the elements. The
        disturbance of element k is F aside[k] - aside[k + 1], with the matrix F of eq. (2).
        """
        # This defect of the displaced path in the linearised equations acts like a known
        # disturbance of the states, which the regulator can anticipate.
        carried = np.einsum("kij,kj->ki", self.transitions, aside[:-1])
        return np.asarray(carried - aside[1:])


def _are_within(times: FloatArray, rests: Sequence[tuple[float, float]]) -> Any:
    """Return which of n times are within at least one of several spans of time, shape (n,).

    The start and end of each span in `rests` [s] belong to it.
    """
    inside = [(times >= a - _SAME_S) & (times <= b + _SAME_S) for a, b in rests]
    return np.any(inside, axis=0) if inside else np.zeros(len(times), dtype=bool)


def _aside(dynamics: Dynamics, path: _Path, demands: Demands) -> FloatArray:
    """Return the changes of a path's states that `demands` causes, at the element boundaries.

    The shape is (n_elements + 1, n_states), in the order of `dynamics.state_names`. If the mission
    prescribes a constant heading, the changes also make the path's yaw angle exactly constant.
    """
    aside = np.zeros_like(path.states)
    # Pushes change position and velocity. The regulator finds the tilt that the displaced path
    # needs.
    moved = displaced(path.borders, demands.displacement)
    for names, values in zip((POSITION_STATES, VELOCITY_STATES), moved, strict=True):
        aside[:, [dynamics.state_names.index(name) for name in names]] = values
    at_rest = np.flatnonzero(_are_within(path.borders, demands.rests))[:, None]
    speeds = [dynamics.state_names.index(name) for name in VELOCITY_STATES]
    aside[at_rest, speeds] = -path.states[at_rest, speeds]
    # The coarse solution has the constant heading at its collocation points only.
    if _KEPT_HEADING in dynamics.parameter_names:
        columns = [dynamics.state_names.index(name) for name in (_ROLL, _YAW, _Q, _R)]
        roll, yaw, q, r = path.states[:, columns].T
        aside[:, columns[1]] = yaw[0] - yaw
        aside[:, columns[3]] = -q * np.tan(roll) - r
    return aside + shifted(dynamics.state_names, path.borders, demands.shifts)


def _split(mesh: Mesh, duration: float) -> Mesh:
    """Return a mesh in which each element longer than `_LONGEST_S` is split into equal parts.

    `duration` is the duration of the flight [s], which the mesh covers.
    """
    # The regulator corrects the controls once in each element.
    return mesh.with_breakpoints(
        first + (last - first) * part / count
        for first, last in pairwise(mesh.breakpoints)
        for count in (ceil((last - first) * duration / _LONGEST_S),)
        for part in range(1, count)
    )


def _regulator(
    dynamics: Dynamics,
    coarse: Trajectories,
    borders: FloatArray,
    demands: Demands = NO_DEMANDS,
) -> _Regulator:
    """Return the linear-quadratic regulator for the elements of a mesh.

    The equations are linearised along `coarse`. `borders` are the element boundaries [s]. During
    the hovers and shifts in `demands`, the affected states have a greater weight. Implements
    docs/theory/tracking.md, eqs. (2) to (4).
    """
    n_states, n_controls = len(dynamics.state_names), len(dynamics.control_names)
    # The controls are declared as constant states of the control law, so that `slopes` also
    # differentiates with respect to them.
    loop = ClosedLoop(
        dynamics,
        lambda _command, _x, own: (own, [0.0 * u for u in own]),
        n_command=0,
        n_own=n_controls,
    )
    middle, steps = 0.5 * (borders[1:] + borders[:-1]), np.diff(borders)
    joint = np.hstack(
        [coarse.states_at(middle), coarse.controls_at(middle), np.zeros((len(middle), 1))]
    )
    slopes = loop.slopes(middle, joint, np.zeros((len(middle), 0)))[1]
    inputs = slice(n_states, n_states + n_controls)
    transitions, driven = discrete(
        slopes[:, :n_states, :n_states], slopes[:, :n_states, inputs], steps
    )
    plain = np.diag([_weight(name) for name in dynamics.state_names])
    # The rate of the yaw angle depends on all body rates of a tilted vehicle.
    turning = slopes[:, dynamics.state_names.index(_YAW), :n_states] / _TURNING
    weights = plain + turning[:, :, None] * turning[:, None, :]
    # Velocities have a larger weight during demanded hovers, and states during their shifts.
    speeds = [dynamics.state_names.index(name) for name in VELOCITY_STATES]
    resting = np.flatnonzero(_are_within(borders[:-1], demands.rests))[:, None]
    weights[resting, speeds, speeds] += 1.0 / _AT_REST**2
    shifts = shifted(dynamics.state_names, borders[:-1], demands.shifts)
    rows, columns = np.nonzero(shifts)
    weights[rows, columns, columns] *= _CLOSELY
    price = np.eye(n_controls) / _CORRECTION**2
    gains, values = driven.transpose(0, 2, 1).copy(), np.zeros_like(transitions)
    inverses = np.zeros((len(steps), n_controls, n_controls))
    value = _AT_THE_END * plain
    for k in reversed(range(len(steps))):
        F, G = transitions[k], driven[k]
        values[k], inverses[k] = value, np.linalg.inv(steps[k] * price + G.T @ value @ G)
        gains[k] = inverses[k] @ (G.T @ value @ F)
        value = steps[k] * weights[k] + F.T @ value @ (F - G @ gains[k])
        value = 0.5 * (value + value.T)
    return _Regulator(
        transitions=transitions,
        driven=driven,
        gains=gains,
        values=values,
        inverses=inverses,
    )


def _disturbances(path: _Path, regulator: _Regulator, previous: Trajectories) -> FloatArray:
    """Return the disturbance of the states in each mesh element, from an earlier flight.

    It is d[k + 1] - (F d[k] + G c[k]) in element k, docs/theory/tracking.md, eq. (6). Here d is the
    deviation from the path, c the correction of the controls.
    """
    # `path` is that of the solution itself, without pushes and shifts.
    deviation = previous.states_at(path.borders) - path.states
    corrections = (
        np.add.reduceat(previous.controls - path.controls, path.mesh.first_node[:-1], axis=0)
        / np.asarray(path.mesh.degrees)[:, None]
    )
    explained = np.einsum("kij,kj->ki", regulator.transitions, deviation[:-1])
    explained += np.einsum("kij,kj->ki", regulator.driven, corrections)
    # The next flight is assumed to have the same disturbance, so that its controls can anticipate
    # it.
    return np.asarray(deviation[1:] - explained)


def _anticipating(regulator: _Regulator, disturbances: FloatArray) -> FloatArray:
    """Return the corrections of the controls that anticipate known disturbances of the states.

    The shape is (n_elements, n_controls). `disturbances` has the change of each state in each
    element that the linearised equations leave out, shape (n_elements, n_states). Implements
    docs/theory/tracking.md, eq. (7).
    """
    commands = np.zeros(regulator.gains.shape[:2])
    ahead = np.zeros(disturbances.shape[1])
    for k in reversed(range(len(commands))):
        F, G, K = regulator.transitions[k], regulator.driven[k], regulator.gains[k]
        push = ahead + regulator.values[k] @ disturbances[k]
        commands[k] = -regulator.inverses[k] @ (G.T @ push)
        ahead = (F - G @ K).T @ push
    return commands


def _weight(name: str) -> float:
    """Return the weight of a state's squared deviation in the linear-quadratic regulator's cost.

    It is 0 for a state that may deviate freely, such as the charge drawn from the battery.
    """
    if name.startswith(_ROTOR_SPEED):
        return 1.0 / _ROTOR_DEVIATION**2
    return 1.0 / _DEVIATIONS[name] ** 2 if name in _DEVIATIONS else 0.0


def _followed(
    dynamics: Dynamics, path: _Path, regulator: _Regulator, commands: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Simulate the vehicle under feedback along a path, element by element.

    `commands`, one row per element, adds to the path's controls and the feedback. The results are
    states with energy at the nodes, and corrected controls; None if a state diverges.
    Implements docs/theory/tracking.md, eq. (1).
    """
    mesh, controls = path.mesh, path.controls.copy()
    limits, held = dynamics.control_limits(), dynamics.control_limits(HELD_BREACH)
    steps = OpenLoopSteps(dynamics)
    joint = np.append(path.states[0], 0.0)
    nodes = [joint[None, :]]
    for e, (first, last) in enumerate(pairwise(path.borders.tolist())):
        keep_time()
        own = slice(mesh.first_node[e], mesh.first_node[e + 1])
        correction = commands[e] - regulator.gains[e] @ (joint[:-1] - path.states[e])
        controls[own] = np.clip(controls[own] + correction, *limits)
        flown = steps.carried(
            joint,
            np.array([first, *path.points[own][:-1], last]),
            control_polynomial(mesh, controls, e, first, last, held),
            _INTEGRATION,
        )
        joint = flown[-1]
        nodes.append(flown[1:])
        if not np.all(np.abs(joint[:-1]) < _LOST):
            return None
    return np.vstack(nodes), controls
