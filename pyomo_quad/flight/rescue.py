"""Fallbacks for failed solves: initial guesses, retries and diagnosis.

The initial guess of a long flight is steady flight between its ends: accelerate, cruise, brake.
A vehicle changes its attitude within a second, whatever the duration of the flight.  If equal
elements would be longer than that, the mesh has short elements at both ends that grow towards the
middle.  The speed of the steady flight follows from the duration or, if that is free, is the speed
of least energy per metre.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import cos, inf, sin, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import minimize_scalar

from pyomo_quad.collocation import (
    Allowance,
    Iteration,
    Mesh,
    Progress,
    RefinementOptions,
    Relaxation,
    Solution,
    SolveError,
    SolverOptions,
    Status,
    Trajectory,
    TranscriptionError,
    compile,
    diagnose,
)
from pyomo_quad.flight.failure import Failure
from pyomo_quad.flight.flight import POSITION_STATES, VELOCITY_STATES
from pyomo_quad.flight.plan import PlanStatus
from pyomo_quad.flight.routes import speed_profile
from pyomo_quad.flight.steady import PITCH, ROLL
from pyomo_quad.model import ask_for_least_time
from pyomo_quad.model.mission import free_times
from pyomo_quad.model.power import wider_smoothings
from pyomo_quad.scenario import ScenarioError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import ArrayLike

    from pyomo_quad.collocation import Diagnosis, Problem
    from pyomo_quad.flight.deadline import Deadline
    from pyomo_quad.flight.plan import Plan
    from pyomo_quad.flight.steady import FloatArray, SteadyFlight
    from pyomo_quad.scenario import Scenario
    from pyomo_quad.scenario.mission import NamedDuration

# Durations, as multiples of the mission's, through which a slow flight is sped up.
_SLOWER = (3.0, 2.0, 1.5, 1.2, 1.1)
_MOST_REMEDIES = 3
_LIMITS = "limits."
# How well, and on how many meshes, a kinked power is first solved with its corner rounded widely.
_ROUGHLY = {"tolerance": 1e-2, "refinement": RefinementOptions(max_meshes=5)}
# How often a mesh on which the corner itself fails is begun anew from that one.
_MOST_RETURNS = 6
_MESH = (10, 4)
_OPTIONS = SolverOptions(max_iterations=300)
# Meshes that give the least time to a small part of the share of it that counts as close.
_FEW_MESHES = 3
_CLOSE = 2e-3
# The multiples of the mission's duration between which the shortest flight is looked for, and
# the slow, easy one that the search starts from.
_RANGE = (0.01, 100.0)
_SLOW = 4.0
# To what share of it the least time is known where it is what is asked for: a limit broken between
# the points counts by the time it saves, and the damping has the price that it has by default.
_TIME_TOLERANCE = 1e-4
_TIMED = RefinementOptions(damping=1.0, allowance=Allowance(limit_breach=inf))


def given_up(plan: Plan, deadline: Deadline) -> Plan:
    """Return a plan, not converged where the time limit left neither a flight nor a proof."""
    if not deadline.is_over or plan.is_flyable or plan.status is PlanStatus.INFEASIBLE:
        return plan
    message = (
        f"given up after solver.time_limit = {deadline.limit_s:g} s; allow more time, or ask for "
        f"a lower solver.accuracy or fewer solver.elements. {plan.reached}"
    )
    if plan.attempts:
        message += f" Tried: {'; '.join(plan.attempts)}."
    return replace(plan, status=PlanStatus.NOT_CONVERGED, message=message, failure=None)


class Effort:
    """Stops a solve after so many iterations times points, which it counts."""

    def __init__(self, progress: Progress, most: float = inf) -> None:
        self._progress = progress
        self._most = most
        self.spent = 0

    def __call__(self, iteration: Iteration) -> bool:
        """Return False once the effort is spent, or the caller's own callback says so."""
        self.spent += iteration.mesh_points
        return self.spent <= self._most and self._progress(iteration) is not False


@dataclass(frozen=True, kw_only=True)
class Rescue:
    """Outcome of a rescue: the last solution, the attempts, and the failure if it failed."""

    solution: Solution
    attempts: tuple[str, ...]
    failure: Failure | None


class Rescuer:
    """Retries a failed mission.

    Parameters
    ----------
    longest : NamedDuration
        The mission's duration, the greatest where it is free.
    solve : callable
        Solve the mission to its tolerance from a trajectory.
    solve_plainly : callable
        Solve the mission on its first mesh past the waypoints themselves, or return None.
    solve_slowly : callable
        Solve the mission on its first mesh with another duration [s], from a trajectory or from
        nothing; None where the duration is free anyway.
    solve_shortest : callable
        Return the shortest flight of the mission, or None.
    progress : callable or None
        Called at each iteration; returning False stops the solve.
    """

    def __init__(
        self,
        *,
        longest: NamedDuration,
        solve: Callable[[Trajectory], Solution],
        solve_plainly: Callable[[], Solution | None],
        solve_slowly: Callable[[float, Trajectory | None], Solution | None],
        solve_shortest: Callable[[], Solution | None],
        progress: Progress | None,
    ) -> None:
        self._longest = longest
        self._solve = solve
        self._solve_plainly = solve_plainly
        self._solve_slowly = solve_slowly
        self._solve_shortest = solve_shortest
        self._progress = progress
        self._attempts: list[str] = []

    def __call__(self, failed: Solution) -> Rescue:
        """Return the rescue of a solution that did not converge."""
        self._note("first solve", failed)
        plain = self._solve_plainly()
        if plain is not None and plain.status.is_solved:
            solution = self._started_from(plain.trajectory, "by way of the waypoints themselves")
            if _has_ended(solution):
                return self._ended(solution, None)
        diagnosis = diagnose(failed, progress=self._progress)
        if diagnosis.feasible_point is not None:
            solution = self._started_from(diagnosis.feasible_point, "elastic restoration")
            if _has_ended(solution):
                return self._ended(solution, None)
        if not diagnosis.is_infeasible:
            solution = self._continued() or failed
            if _has_ended(solution):
                return self._ended(solution, None)
        shortest = self._solve_shortest()
        least = None if shortest is None else shortest.objective
        self._attempts.append(
            "shortest flight: none found" if least is None else f"shortest flight: {least:.4g} s"
        )
        is_contradicted = shortest is not None and shortest.objective <= self._longest.value
        if shortest is not None and is_contradicted:
            held, statics = shortest.trajectory, failed.trajectory.statics
            path = held if len(held.statics) == len(statics) else replace(held, statics=statics)
            solution = self._started_from(path, "guess from the shortest flight")
            if _has_ended(solution):
                return self._ended(solution, None)
        failure = Failure(
            longest=self._longest,
            shortest_duration_s=least,
            diagnosis=diagnosis,
            remedies=() if not diagnosis.is_infeasible else self._remedies(failed, diagnosis),
        )
        is_proven = failure.is_too_short or (diagnosis.is_infeasible and not is_contradicted)
        status = Status.INFEASIBLE if is_proven else Status.NOT_CONVERGED
        return self._ended(replace(failed, status=status), failure)

    def _ended(self, solution: Solution, failure: Failure | None) -> Rescue:
        return Rescue(solution=solution, attempts=tuple(self._attempts), failure=failure)

    def _note(self, what: str, solution: Solution) -> None:
        self._attempts.append(f"{what}: {solution.status.value}")

    def _started_from(self, trajectory: Trajectory, what: str) -> Solution:
        solution = self._solve(trajectory)
        self._note(what, solution)
        return solution

    def _continued(self) -> Solution | None:
        """Speed a slow flight up to the mission's duration; None when a step fails."""
        trajectory: Trajectory | None = None
        for factor in _SLOWER:
            slower = self._solve_slowly(factor * self._longest.value, trajectory)
            if slower is None:
                return None
            self._note(f"duration x {factor:g}", slower)
            if slower.status is Status.INTERRUPTED:
                return slower
            if slower.status.is_solved:
                trajectory = slower.trajectory
        if trajectory is None:
            return None
        return self._started_from(trajectory, "continuation in duration")

    def _remedies(self, failed: Solution, diagnosis: Diagnosis) -> tuple[Relaxation, ...]:
        """Return single limits that would do alone."""
        candidates = [r.name for r in diagnosis.relaxations] + [a.name for a in diagnosis.active]
        limits = [name for name in dict.fromkeys(candidates) if name.startswith(_LIMITS)]
        found: list[Relaxation] = []
        for name in limits[:_MOST_REMEDIES]:
            try:
                alone = diagnose(failed, families=frozenset({name}), progress=self._progress)
            except TranscriptionError:
                continue
            found.extend(alone.relaxations)
        return tuple(found)


def _has_ended(solution: Solution) -> bool:
    """Say whether nothing more is to be tried: it is solved, or was stopped."""
    return solution.status.is_solved or solution.status is Status.INTERRUPTED


def easier_numbers(problem: Problem, told: Scenario) -> tuple[dict[str, float], ...]:
    """Return parameter values that make a compiled problem easier, the easiest first."""
    held = {p.name for p in problem.compiled.declared.parameters}
    return tuple(numbers for numbers in wider_smoothings(told) if numbers.keys() <= held)


def under(arguments: dict[str, Any], numbers: dict[str, float]) -> dict[str, Any]:
    """Return a solve's arguments with other numbers, whose plans are none of the mission."""
    return arguments | {
        "parameters": (arguments["parameters"] or {}) | numbers,
        "refinement": replace(arguments["refinement"], on_mesh=None),
    }


def at_its_easiest(
    arguments: dict[str, Any], easier: tuple[dict[str, float], ...]
) -> dict[str, Any]:
    """Return a solve's arguments with the easiest numbers, its own where there are none."""
    return under(arguments, easier[0]) if easier else arguments


def by_way_of(
    easier: tuple[dict[str, float], ...],
    problem: Problem,
    arguments: dict[str, Any],
    guess: Any,
) -> Solution:
    """Solve from a guess by way of easier numbers, each from the solution under the last.

    A finer mesh on which that fails is begun anew, from the solution under the easiest.
    """
    solution, easiest = _by_way_of(easier, problem, arguments, guess)
    for _ in range(_MOST_RETURNS):
        if easiest is None or not solution.status.has_failed or solution.mesh == easiest.mesh:
            break
        on_mesh = arguments | {"mesh": solution.mesh}
        rough = under(on_mesh, easier[0]) | {"tolerance": None}
        again = problem.solve(**rough, guess=easiest.trajectory)
        if not again.status.is_solved:
            break
        easiest = again
        solution, _ = _by_way_of(easier[1:], problem, on_mesh, None, again)
    return solution


def _by_way_of(
    easier: tuple[dict[str, float], ...],
    problem: Problem,
    arguments: dict[str, Any],
    guess: Any,
    reached: Solution | None = None,
) -> tuple[Solution, Solution | None]:
    """Return the solution, and the first intermediate solution."""
    first = reached
    for numbers in easier:
        eased = under(arguments, numbers)
        if reached is None:
            tried = problem.solve(**eased | _ROUGHLY, guess=guess)
        else:
            on_mesh = {"tolerance": None, "mesh": reached.mesh, "warm_start": reached}
            tried = problem.solve(**eased | on_mesh)
        if tried.status is Status.INTERRUPTED:
            return _as_far_as(tried, problem, arguments), first
        if tried.status.is_solved:
            reached = tried
            first = first or reached
    if reached is None:
        return problem.solve(**arguments, guess=guess), None
    return problem.solve(**arguments | {"mesh": reached.mesh}, warm_start=reached), first


def _as_far_as(stopped: Solution, problem: Problem, arguments: dict[str, Any]) -> Solution:
    """Return a solve that was stopped under easier numbers, read under the mission's own."""
    here = {"tolerance": None, "mesh": stopped.mesh, "options": SolverOptions(max_iterations=0)}
    read = problem.solve(**arguments | here | {"progress": None}, warm_start=stopped)
    return replace(read, status=stopped.status, message=stopped.message)


def shortest_flight(
    model: Any, scenario: Scenario, progress: Progress | None, *, is_exact: bool = False
) -> Solution | None:
    """Fly the mission of a model in the least time.

    A few meshes do unless the mission's duration is close to what they give: then they are
    refined to the mission's own tolerance, for a time that is asked for to `_TIME_TOLERANCE`.

    Parameters
    ----------
    model : ConcreteModel
        Model of the scenario; its objective is replaced.
    scenario : Scenario
    progress : callable or None
        Called at each iteration; returning False stops the solve.
    is_exact : bool, optional
        Refine the time wherever it lies.

    Returns
    -------
    Solution or None
        Its objective is the time [s]; None when the solve failed.
    """
    duration, settings = scenario.nominal_duration, scenario.solver
    bounds = _RANGE[0] * duration, _RANGE[1] * duration
    free = declared_free_times(model, scenario)
    end = ask_for_least_time(model, bounds, _SLOW * duration)
    problem = compile(model, times=free | {scenario.nominal_duration: end})
    most = settings.max_refinements + 1
    tolerance = _TIME_TOLERANCE if is_exact else settings.tolerance
    refinement = _TIMED if is_exact else RefinementOptions()
    shortest, start = None, None
    for meshes in (most,) if is_exact else (_FEW_MESHES, most):
        solution = problem.solve(
            mesh=Mesh.uniform(*_MESH) if start is None else start.mesh,
            tolerance=tolerance,
            # It goes on with what it began: what the beginning took says nothing of the rest.
            warm_start=None if start is None else replace(start.warm_start, cold_start=None),
            options=_OPTIONS,
            refinement=replace(refinement, max_meshes=meshes),
            progress=progress,
        )
        if not solution.status.is_solved:
            break
        shortest = start = solution
        if abs(solution.objective - duration) > _CLOSE * duration:
            break
    return shortest


def declared_free_times(model: Any, scenario: Scenario) -> dict[float, Any]:
    """Return declared time -> the variable of a model that gives it.

    Raises
    ------
    ScenarioError
        If a model of the user's own lacks one.
    """
    mission = scenario.mission
    wanted = {"duration": mission.is_free, "mission.passing_time": bool(mission.waypoints)}
    for name, is_wanted in wanted.items():
        if is_wanted and model.find_component(name) is None:
            said = 'duration = "free"' if name == "duration" else "waypoints"
            raise ScenarioError(
                f"{scenario.name}: mission.{said}; the model of {scenario.model} must declare "
                f'a variable "{name}", as build_model does: add it or change the mission.'
            )
    return free_times(model, scenario)


# Equal elements longer than this [s] are too long for a change of attitude.
_LONGEST_S = 3.0
# The first and last element [s], how much longer each next one is, and their degree.
_ROUGH, _FINE = (0.1, 1.25, 4), (0.04, 1.15)
# In an element longer than this [s] place and velocity feel how the attitude bends inside: its
# degree is so much higher.
_BENDING_S, _MORE = 1.0, 2
# Acceleration and jerk of a guess, m/s^2 and m/s^3, and the range of its speeds, m/s.
_ACCELERATION, _JERK = 2.0, 4.0
_SPEEDS = 1.0, 30.0
_SPEED_TOLERANCE = 0.1
_SAMPLES = 400


def is_long(scenario: Scenario) -> bool:
    """Say whether a flight straight to its goal is long beside a change of attitude."""
    is_straight = not scenario.mission.waypoints and not scenario.airspace.keep_out
    return is_straight and scenario.nominal_duration > _LONGEST_S * scenario.solver.elements


def rough_mesh(duration: float) -> Mesh:
    """Return a mesh of a flight [s] on which to find it."""
    return _graded(duration, *_ROUGH)


def fine_mesh(duration: float, degree: int) -> Mesh:
    """Return a mesh of a flight [s] that its ends hardly need finer."""
    return _graded(duration, *_FINE, degree)


def _graded(duration: float, shortest: float, growth: float, degree: int) -> Mesh:
    """Return a mesh with short elements [s] at both ends, each next one longer by a factor."""
    widths = [shortest]
    while 2 * sum(widths) < duration:
        widths.append(growth * widths[-1])
    half = np.cumsum(widths[:-1]) / duration
    breakpoints = (0.0, *half.tolist(), *(1.0 - half[::-1]).tolist(), 1.0)
    degrees = degree + _MORE * (duration * np.diff(breakpoints) > _BENDING_S)
    return Mesh(breakpoints=breakpoints, degrees=tuple(degrees.tolist()))


def guess_of(scenario: Scenario, steady: SteadyFlight) -> dict[str, Any] | None:
    """Return a first guess, None where there is no steady flight along the way.

    Parameters
    ----------
    scenario : Scenario
    steady : SteadyFlight
        In the air that the flight goes through.
    """
    from scipy.interpolate import CubicHermiteSpline  # noqa: PLC0415  few flights are long

    mission = scenario.mission
    way = np.subtract(mission.goal.position, mission.start.position)
    distance = float(np.linalg.norm(way))
    if distance == 0.0:
        return None
    course = way / distance
    speed = _speed_for(distance, mission.longest.value)
    if mission.is_free:
        best = best_speed(steady, course, mission.price_of_time)
        speed = max(speed, min(best, scenario.limits.speed_max or inf))
    try:
        resting, cruising = (steady.held_in(steady.trim(v * course)) for v in (0.0, speed))
    except SolveError:
        return None
    profile = speed_profile(distance, speed, _ACCELERATION, _JERK)
    kept = np.diff(profile.times, append=inf) > 0.0
    times, *rows = (row[kept] for row in profile)
    when = np.linspace(0.0, times[-1], _SAMPLES)
    done = CubicHermiteSpline(times, *rows[:2])(when)
    speeds, accelerations = (np.interp(when, times, row) for row in rows[1:])
    share = speeds / speed
    guess = {name: resting[name] + share * (cruising[name] - resting[name]) for name in resting}
    guess |= _columns(POSITION_STATES, done, course, mission.start.position)
    guess |= _columns(VELOCITY_STATES, speeds, course)
    heading = mission.start.yaw
    ahead, aside = (
        (course[0] * c + course[1] * s) * accelerations / scenario.gravity
        for c, s in ((cos(heading), sin(heading)), (-sin(heading), cos(heading)))
    )
    guess[PITCH] = guess[PITCH] + ahead
    guess[ROLL] = guess[ROLL] - aside
    # An open end is told in shares of the horizon.
    if not mission.is_free:
        return guess | {"time": when}
    return guess | {"time": when / times[-1], "duration": times[-1]}


def _columns(
    names: Sequence[str], along: FloatArray, course: FloatArray, start: ArrayLike = (0.0, 0.0, 0.0)
) -> dict[str, FloatArray]:
    return dict(zip(names, (np.asarray(start) + along[:, None] * course).T, strict=True))


def _speed_for(distance: float, duration: float) -> float:
    """Return the speed of a cruise that lasts as long, or nearly where that is too short."""
    # Gathering speed and braking together cost speed / acceleration and what their bends take.
    left = duration - _ACCELERATION / _JERK
    room = left**2 - 4 * distance / _ACCELERATION
    return _ACCELERATION / 2 * (left - sqrt(max(room, 0.0)))


def best_speed(steady: SteadyFlight, course: FloatArray, price_of_time: float) -> float:
    """Return about the speed over ground at which a metre of the course costs least [m/s]."""

    def cost(speed: float) -> float:
        try:
            return (steady.trim(course * speed).power_W + price_of_time) / speed
        except SolveError:
            return inf

    found = minimize_scalar(
        cost, bounds=_SPEEDS, method="bounded", options={"xatol": _SPEED_TOLERANCE}
    )
    return float(found.x)
