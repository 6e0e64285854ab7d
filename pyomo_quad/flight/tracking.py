"""Simulated flights that follow a solution on a coarse mesh under feedback, to make it flyable.

Between its collocation points, the solution satisfies the equations of motion only approximately.
If its controls are simulated in open loop, the flight therefore misses the goal: an error in the
speed of a rotor grows into an error of position with the fourth power of time. This module
simulates the equations while a linear-quadratic regulator keeps the vehicle near the solution. The
resulting states and controls satisfy the equations to the tolerance of the integrator, and their
energy is close to the energy of the solution. Derivation and sources: docs/theory/tracking.md, eqs.
(1) to (4).
"""

from __future__ import annotations

from itertools import pairwise
from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.collocation import ClosedLoop, control_polynomial, interpolate
from pyomo_quad.flight.flight import (
    HELD_BREACH,
    POSITION_STATES,
    TILT_STATES,
    VELOCITY_STATES,
)
from pyomo_quad.flight.integration import discrete, integrate
from pyomo_quad.flight.plan import Trajectories
from pyomo_quad.flight.verification import rates_in_element

if TYPE_CHECKING:
    from pyomo_quad.arrays import FloatArray
    from pyomo_quad.collocation import Dynamics, Mesh

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
    "rigid_body.r": 0.01,
}
_ROTOR_SPEED, _ROTOR_DEVIATION = "rotors.omega[", 5.0
# Correction of a rotor's acceleration that the regulator weighs like the deviations above
# [rad/s^2]; and factor on the weights of the states at the end, where the vehicle must be at its
# goal.
_CORRECTION, _AT_THE_END = 200.0, 50.0
# Relative and absolute tolerance of the simulation; and the magnitude of a state, in its unit,
# above which the vehicle is lost.
_INTEGRATION, _LOST = 1e-10, 1e6


def can_be_tracked(dynamics: Dynamics) -> bool:
    """Return whether a model has all states that the linear-quadratic regulator needs.

    The regulator makes a simulated vehicle follow a solution on a coarse mesh. It needs position,
    velocity, attitude and body rates.
    """
    return set(_DEVIATIONS) <= set(dynamics.state_names)


def tracked(dynamics: Dynamics, coarse: Trajectories) -> Trajectories | None:
    """Return the simulated flight of a vehicle that follows a coarse solution under feedback.

    In each element of the result, the controls are those of the solution plus a constant
    correction, clipped to the limits of the controls.

    Parameters
    ----------
    dynamics : Dynamics
        Equations of the vehicle.
    coarse : Trajectories
        States and controls of a solution.

    Returns
    -------
    Trajectories or None
        States, controls and energy of the flight, on the solution's mesh with long elements split;
        costates and Hamiltonian are interpolated. None if the vehicle cannot follow the solution.

    Raises
    ------
    SolveError
        If the integrator fails.
    """
    start, end = coarse.horizon
    mesh = _split(coarse.mesh, end - start)
    borders = start + (end - start) * np.asarray(mesh.breakpoints)
    gains = _gains(dynamics, coarse, borders)
    points = start + (end - start) * mesh.point_fractions
    flown = _followed(dynamics, mesh, borders, points, coarse, gains)
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


def _split(mesh: Mesh, duration: float) -> Mesh:
    """Return a mesh in which each element longer than `_LONGEST_S` [s] is split into equal parts.

    The regulator that follows a coarse solution corrects the controls once in each element.
    `duration` is the duration of the flight [s], which the mesh covers.
    """
    return mesh.with_breakpoints(
        first + (last - first) * part / count
        for first, last in pairwise(mesh.breakpoints)
        for count in (ceil((last - first) * duration / _LONGEST_S),)
        for part in range(1, count)
    )


def _gains(dynamics: Dynamics, coarse: Trajectories, borders: FloatArray) -> FloatArray:
    """Return the feedback matrices of the linear-quadratic regulator, one for each mesh element.

    Implements docs/theory/tracking.md, eqs. (2) to (4), by linearisation about the solution
    `coarse`.

    `borders` has the times of the element boundaries [s], shape (n_elements + 1,). The result has
    shape (n_elements, n_controls, n_states).
    """
    n_states, n_controls = len(dynamics.state_names), len(dynamics.control_names)
    # The controls are declared as constant states of the control law, so that `slopes` also
    # differentiates with respect to them.
    loop = ClosedLoop(
        dynamics.without_iterations(),
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
    weights = np.diag([_weight(name) for name in dynamics.state_names])
    price = np.eye(n_controls) / _CORRECTION**2
    value, gains = _AT_THE_END * weights, np.zeros((len(steps), n_controls, n_states))
    for k in reversed(range(len(steps))):
        F, G = transitions[k], driven[k]
        gains[k] = np.linalg.solve(steps[k] * price + G.T @ value @ G, G.T @ value @ F)
        value = steps[k] * weights + F.T @ value @ (F - G @ gains[k])
        value = 0.5 * (value + value.T)
    return gains


def _weight(name: str) -> float:
    """Return the weight of a state's squared deviation in the linear-quadratic regulator's cost.

    The regulator keeps a simulated vehicle near a solution. `name` is the name of the state. The
    weight is 0 for a state that need not stay near the solution, such as the charge drawn from the
    battery.
    """
    if name.startswith(_ROTOR_SPEED):
        return 1.0 / _ROTOR_DEVIATION**2
    return 1.0 / _DEVIATIONS[name] ** 2 if name in _DEVIATIONS else 0.0


def _followed(
    dynamics: Dynamics,
    mesh: Mesh,
    borders: FloatArray,
    points: FloatArray,
    coarse: Trajectories,
    gains: FloatArray,
) -> tuple[FloatArray, FloatArray] | None:
    """Simulate the vehicle under feedback along a solution, one mesh element after the other.

    Implements docs/theory/tracking.md, eq. (1).

    Parameters
    ----------
    dynamics : Dynamics
        Equations of the vehicle.
    mesh : Mesh
        Mesh of the simulated flight.
    borders, points : ndarray
        Times of the element boundaries and of the collocation points of this mesh [s].
    coarse : Trajectories
        The solution that the vehicle follows.
    gains : ndarray, shape (n_elements, n_controls, n_states)
        Feedback matrices, from `_gains`.

    Returns
    -------
    ndarray, shape (n_points + 1, n_states + 1)
        States and energy at the nodes.
    ndarray, shape (n_points, n_controls)
        Controls at the collocation points, with the corrections by feedback. None instead of both
        arrays if a state grows beyond `_LOST`.
    """
    controls, wanted = coarse.controls_at(points), coarse.states_at(borders)
    limits, held = dynamics.control_limits(), dynamics.control_limits(HELD_BREACH)
    flow = ClosedLoop(
        dynamics, lambda command, _x, _own: (command, ()), n_command=controls.shape[1], n_own=0
    )
    state = np.append(coarse.states[0], 0.0)
    nodes = [state[:, None]]
    for e, (first, last) in enumerate(pairwise(borders.tolist())):
        own = slice(mesh.first_node[e], mesh.first_node[e + 1])
        correction = gains[e] @ (wanted[e] - state[:-1])
        controls[own] = np.clip(controls[own] + correction, *limits)
        polynomial = control_polynomial(mesh, controls, e, first, last, held)
        flown = integrate(
            rates_in_element(flow, polynomial, dynamics.just_after(first)),
            (first, last),
            state,
            np.append(points[own][:-1], last),
            dynamics.steps_between(first, last),
            flight="tracking",
            remedy="Ask for more solver.elements.",
            method="DOP853",
            rtol=_INTEGRATION,
            atol=_INTEGRATION,
        )
        state = flown[:, -1]
        nodes.append(flown)
        if not np.all(np.abs(state[:-1]) < _LOST):
            return None
    return np.hstack(nodes).T, controls
