"""Flyable trajectories near a coarse solution, for a search that runs out of time.

A trajectory is flyable if a simulation of its controls, without feedback, reaches the goal. The
controls of a coarse solution may miss the goal. Starting from this solution, the equations are
solved on finer meshes, without optimising again. If the simulated flight then breaks a limit
slightly, for example the floor by a few centimetres between two points of the mesh, the equations
are solved once more with a limit that is stricter by more than the violation.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.collocation import MeshRecord, Status, mesh_for_states
from pyomo_quad.flight.flight import POSITION_STATES
from pyomo_quad.flight.limit_words import excess
from pyomo_quad.scenario.accuracy import FIGURES, Accuracy

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from pyomo_quad.collocation import Problem, Solution
    from pyomo_quad.flight.plan import Plan
    from pyomo_quad.scenario.airspace import Airspace

# Tolerances of the lowest accuracy, which a usable plan must meet.
_QUICK = FIGURES[Accuracy.QUICK]
# For each mesh the error of states above which an element is refined, and the tolerance on the
# residuals of the equations.  The first mesh only provides the start for the next; in simulation
# without feedback, the errors of the last grow to less than a tenth of a metre in a minute.
_MESHES = ((1e-2, 1e-4), (2e-4, 1e-8), (1e-5, 1e-9))
# Least degree of an element, so that errors decrease fast from mesh to mesh.
_DEGREE = 6
# Violation of limits allowed at collocation points, relative to that of a usable plan: between the
# points the violation is at least twice as large.
_AT_POINTS = 0.3
# Fractions of an element at which the path is checked for intrusion into zones.
_LOOKS = np.linspace(0.0, 1.0, 20, endpoint=False)
# Name of the parameter that holds the distance kept from zones.
_CLEARANCE = "airspace.clearance"
# Parameters of limits on positions, with the sign of the change that makes the limit stricter.
_FLOOR, _CEILING = "airspace.floor", "airspace.ceiling"
_AIRSPACE = ((_FLOOR, 1.0), (_CEILING, -1.0), (_CLEARANCE, 1.0))
# Parameters of the heights at which a mission starts and ends.
_ENDS = ("mission.start_z", "mission.goal_z")
# Parameter of each limit that can be made stricter, by the name of the limit without its index; and
# the sign of the change that makes the limit stricter. A parameter with braces has the same index.
_STRICTER = {
    "airspace.ceiling_limit": (_CEILING, -1.0),
    "airspace.floor_limit": (_FLOOR, 1.0),
    "airspace.keep_out": (_CLEARANCE, 1.0),
    "limits.pitch_limit": ("limits.pitch_max", -1.0),
    "limits.roll_limit": ("limits.roll_max", -1.0),
    "limits.speed_limit": ("limits.speed_max", -1.0),
    "mission.hold_distance": ("mission.passing_radius[{}]", -1.0),
    "mission.passing_near": ("mission.passing_radius[{}]", -1.0),
}
# Violation of a limit, relative to the larger of 1 and the limit, above which a stricter limit is
# not tried; and the change of the limit relative to the violation, since the violation between the
# points of another mesh may be somewhat larger.
_SLIGHT, _MORE = 0.2, 1.5


def flyable_from(
    problem: Problem, arguments: dict[str, Any], coarse: Solution, airspace: Airspace
) -> Iterator[Solution]:
    """Yield flyable trajectories near a coarse optimum, on ever finer meshes.

    A trajectory is flyable if a simulation of its controls, without feedback, reaches the goal. The
    equations are satisfied on the finer meshes, but the energy is not minimised again. Between the
    points of coarse elements, a path may cut the corners of keep-out zones; therefore the clearance
    is increased by the deepest intrusion of the coarse path.

    Parameters
    ----------
    problem : Problem
        Compiled problem of the mission.
    arguments : dict
        Keyword arguments with which `Problem.solve` solves the mission.
    coarse : Solution
        Solution on a coarse mesh.
    airspace : Airspace
        Airspace of the mission.

    Yields
    ------
    Solution
        Feasible trajectories, not optimised, the coarsest first; none if a solve fails.
    """
    numbers = within_airspace(arguments["parameters"] or {})
    if _CLEARANCE in numbers:
        numbers[_CLEARANCE] += _deepest_cut(coarse, airspace)
    own = problem.instance(arguments["parameters"], arguments["horizon"])
    finer = partial(mesh_for_states, options=arguments["refinement"], least_degree=_DEGREE)
    found, (mesh, error) = coarse, finer(coarse, _MESHES[0][0])
    begun = _record(coarse, error)
    for k, (_, feasibility_tolerance) in enumerate(_MESHES):
        found = problem.flyable(
            found,
            mesh,
            parameters=numbers,
            horizon=arguments["horizon"],
            breach=_AT_POINTS * _QUICK.breach,
            feasibility_tolerance=feasibility_tolerance,
            progress=arguments["progress"],
        )
        if found.status is not Status.CONVERGED:
            return
        mesh, error = finer(found, _MESHES[min(k + 1, len(_MESHES) - 1)][0])
        if k > 0:
            # The energy beyond that of the coarse optimum is the only known measure of its error.
            history = begun, _record(found, error)
            yield replace(found, instance=own, error_estimate=error, history=history)


def within_airspace(numbers: Mapping[str, float]) -> dict[str, float]:
    """Return the mission's parameters with stricter floor, ceiling and clearance from zones.

    The solve for a flyable trajectory may violate each limit by a small fraction, for example a
    floor at a height of 20 m by 6 cm. The returned limits are stricter by this allowance, so that
    the trajectory keeps the limits of the mission itself.

    Parameters
    ----------
    numbers : mapping
        Full name of a parameter -> value, for the mission.

    Returns
    -------
    dict
        All parameters, some of them changed.
    """
    allowed = _AT_POINTS * _QUICK.breach
    changed = {
        name: numbers[name] + sign * allowed * max(1.0, abs(numbers[name]))
        for name, sign in _AIRSPACE
        if name in numbers
    }
    return _with_open_ends({**numbers, **changed})


def _with_open_ends(numbers: dict[str, float]) -> dict[str, float]:
    """Return parameters whose floor and ceiling allow the heights of start and goal.

    `numbers` maps full names of parameters to values; a floor or a ceiling that was made too strict
    is relaxed in place.
    """
    ends = [numbers[name] for name in _ENDS if name in numbers]
    for name, choose in ((_FLOOR, min), (_CEILING, max)):
        if name in numbers and ends:
            numbers[name] = choose(numbers[name], *ends)
    return numbers


def stricter_limits(plan: Plan) -> dict[str, float]:
    """Return changes of parameters that make stricter the limits which a simulated flight broke.

    Each limit becomes stricter by somewhat more than its violation in the simulated flight of a
    plan.

    Parameters
    ----------
    plan : Plan
        Plan with the result of its simulation.

    Returns
    -------
    dict
        Full name of a parameter -> change to add. It is empty if the flight breaks no limit, if a
        violation is large, or if the package knows no parameter of a broken limit.
    """
    if plan.flown is None:
        return {}
    flown = plan.flown
    changes: dict[str, float] = {}
    for breach in plan.dynamics.violations(flown.t, flown.states, flown.controls):
        if breach.relative <= _QUICK.breach:
            continue
        limit, _, index = breach.name.partition("[")
        if breach.relative > _SLIGHT or limit not in _STRICTER:
            return {}
        parameter, sign = _STRICTER[limit]
        name = parameter.format(index.removesuffix("]"))
        change = sign * _MORE * excess(breach, plan.dynamics.unit(breach.name))[0]
        changes[name] = max(changes.get(name, 0.0), change, key=abs)
    return changes


def led_inside(
    problem: Problem, arguments: dict[str, Any], near: Solution, changes: Mapping[str, float]
) -> Solution | None:
    """Return a flyable trajectory within stricter limits, near a trajectory that breaks limits.

    A trajectory is flyable if a simulation of its controls, without feedback, reaches the goal.

    Parameters
    ----------
    problem : Problem
        Compiled problem of the mission.
    arguments : dict
        Keyword arguments with which `Problem.solve` solves the mission.
    near : Solution
        Last trajectory of `flyable_from`.
    changes : mapping
        Full name of a parameter -> change to add, as from `stricter_limits`.

    Returns
    -------
    Solution or None
        Feasible trajectory, not optimised, with the parameters of the mission; None if the solve
        fails or the mission lacks a parameter.
    """
    numbers = within_airspace(arguments["parameters"] or {})
    if not changes or not changes.keys() <= numbers.keys():
        return None
    for name, change in changes.items():
        # A small radius keeps half of its length.
        numbers[name] += change if numbers[name] <= 0.0 else max(change, -0.5 * numbers[name])
    numbers = _with_open_ends(numbers)
    finer = partial(mesh_for_states, options=arguments["refinement"], least_degree=_DEGREE)
    error, feasibility_tolerance = _MESHES[-1]
    found = problem.flyable(
        near,
        finer(near, error)[0],
        parameters=numbers,
        horizon=arguments["horizon"],
        breach=_AT_POINTS * _QUICK.breach,
        feasibility_tolerance=feasibility_tolerance,
        progress=arguments["progress"],
    )
    if found.status is not Status.CONVERGED:
        return None
    left = finer(found, error)[1]
    history = (*near.history[:1], _record(found, left))
    return replace(found, instance=near.instance, error_estimate=left, history=history)


def _deepest_cut(solution: Solution, airspace: Airspace) -> float:
    """Return the deepest intrusion of a solution's path into a zone or its clearance [m], or 0."""
    if not airspace.keep_out:
        return 0.0
    names = [slot.name for slot in solution.problem.compiled.declared.states]
    borders = solution.mesh.breakpoints
    fractions = np.concatenate([a + (b - a) * _LOOKS for a, b in pairwise(borders)])
    places = solution.trajectory.states_at(fractions)[:, [names.index(n) for n in POSITION_STATES]]
    depth = max(float(zone.depth(places).max()) for zone in airspace.keep_out)
    return max(0.0, depth + airspace.clearance)


def _record(solution: Solution, error: float) -> MeshRecord:
    return MeshRecord(
        elements=solution.mesh.elements,
        points=solution.mesh.points,
        iterations=solution.iterations[-1].iteration if solution.iterations else 0,
        objective=solution.objective,
        error=error,
        wall_s=solution.wall_s,
    )
