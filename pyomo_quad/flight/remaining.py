"""Solves of the remaining mission during a flight (re-planning), with soft limits.

A re-plan is a new plan for the rest of the mission, made in flight. It ends at the goal, or in the
next hover at a waypoint. Its limits may be violated at a penalty (see `model.soft_limits`). For
each waypoint, the problem of the mission after it is compiled before take-off. For penalty and
initial state, see docs/theory/soft_limits.md, eqs. (1) to (3).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from math import ceil, floor, log, sqrt

import numpy as np
from numpy.linalg import norm

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import (
    Mesh,
    Problem,
    RefinementOptions,
    Solution,
    SolveError,
    SolverOptions,
    Timeline,
    compile,
)
from pyomo_quad.flight.baselines import (
    path_of,
)
from pyomo_quad.flight.caches import REMAINING
from pyomo_quad.flight.controller import (
    rotor_columns,
    tilt_toward,
)
from pyomo_quad.flight.flight import (
    HELD_BREACH,
    POSITION_STATES,
    TILT_STATES,
    VELOCITY_STATES,
)
from pyomo_quad.flight.margins import KEPT_BY_CONTROLLER, tightened, used_up
from pyomo_quad.flight.plan import Trajectories, trajectories_of
from pyomo_quad.flight.planning import Planner
from pyomo_quad.flight.references import PlannedPath, Setpoint
from pyomo_quad.model import build_model, build_remaining, parameter_values, structure_key
from pyomo_quad.model.mission import free_times, measured_start
from pyomo_quad.model.soft_limits import BREACHES, PRICE, usual_price
from pyomo_quad.model.wind import still_air
from pyomo_quad.scenario import Scenario, ScenarioError
from pyomo_quad.scenario.tables import Knowledge

Numbers = dict[str, float | Callable[[float], float]]

# Axes of the estimated acceleration by the air; the vertical part is attributed to the mass.
_HORIZONTAL = "xy"
# First mesh of the plan before take-off if none is given: element length [s], least and largest
# number of elements, degree.
_ELEMENT_S, _FEWEST, _MOST, _FIRST_DEGREE = 1.25, 8, 24, 4
# Relative error of the states of this plan, and largest number of its meshes. On the first mesh,
# the pitch of `delivery` differed by 0.22 rad from the integral of its rate. The controller follows
# both, and the flight was 0.13 rad beyond its limit; on the refined mesh they differ by 0.001 rad.
_ROUGHLY, _FIRST_MESHES = 1e-2, 6
# Mesh of a re-plan: shortest and longest element [s], ratio of neighbours, degree. The last plan
# before a stop is flown for seconds: with 0.4 s as the shortest element, re-plans of `delivery`
# without turbulence cost 2.5 J of 15 kJ more, with a ratio of 2 they cost 5 J more.
_SHORT_S, _LONG_S, _GROWTH, _DEGREE = 0.2, 2.5, 1.5, 3
# Length of the first element of a hover [s]: limits are imposed at the collocation points only, and
# before the first point of an element of 0.4 s, a plan that braked with 4 m/s^2 exceeded the speed
# allowed in hover by 0.3 m/s.
_AT_ONCE_S = 0.05
# Factor on the remaining time after which a re-plan gets a new, shorter mesh.
_KEPT = 0.8
# Number of samples of a plan in the initial guess of another.
_GUESSED = 200
# Ratio and number of the penalties on violations that are tried before take-off, and largest
# violation (metres, radians, ...) at which no larger penalty is needed.
_RAISE, _PENALTIES, _MET = 10.0, 3, 1e-4
# Time after the start of a hover at a waypoint at which plans end [s], at most half of the hover;
# and fraction of this time for which plans must hover.
_INTO_HOLD, _SETTLED = 1.0, 0.75
# A re-solve keeps one barrier parameter, the largest without visible effect on the plan: limits
# become active at other points of each mesh, and beside a zone a barrier thirty times smaller took
# fifteen more iterations without benefit.  Linear systems are solved without iterative refinement
# and with smaller pivots: fewer digits are enough for a plan that is flown for a fifth of a second.
_BARRIER = (("mu_init", 3e-6), ("mu_target", 3e-6))
_HASTE = (("fast_step_computation", "yes"), ("mumps_pivtol", 1e-6), ("mumps_scaling", 0))
# Ipopt's tolerance and largest number of iterations of a re-solve: a plan that is late is useless.
_OPTIONS = SolverOptions(tolerance=1e-5, max_iterations=40, extra=(*_BARRIER, *_HASTE))
# Settings of the solves before take-off, which have no time limit.
_AT_LEISURE = SolverOptions(tolerance=1e-6, max_iterations=300)
# Last part of the mission that is not planned again [s], and its largest fraction of a short
# mission.  In five perturbed flights of ten seconds, re-planning until 0.6 s before the end cost 3
# to 30 J more, and the final distance from the goal was 1.2 to 1.7 times as large.
_LAST, _LAST_SHARE = 3.0, 0.3
# Part before a waypoint that is not planned again [s], shorter because only the position is
# required there; and the largest fraction before a hover at a waypoint, where the vehicle must be
# at rest: with a fraction below three tenths, limits were broken in gusts.
_NEAR, _HOLD_SHARE = 1.0, 0.5
# Name of the parameter that holds the distance kept from zones.
_CLEARANCE = "airspace.clearance"
# Additional distance of re-plans from zones [m]: between the points of the coarse mesh a plan may
# pass nearer, and the flight deviates from it; at 8 m/s, in `parcel`, by 9 mm if the wind is known
# and by 17 mm if it is estimated.
_SPARE_M = 0.03


@dataclass(frozen=True, kw_only=True)
class Belief:
    """Estimates that a plan made in flight is based on: mass, and acceleration caused by the air.

    `mass` is the estimated mass at take-off, with all payload, even if some has been released since
    [kg]. `unexplained` is the horizontal acceleration caused by the air, minus that caused by the
    assumed wind, along world x and y [m/s^2].
    """

    mass: float
    unexplained: tuple[float, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Remainder:
    """Rest of a mission after some of its waypoints, with its compiled optimal control problem.

    In flight, this problem is solved repeatedly for new plans (re-plans).
    """

    problem: Problem
    begin: float
    """Time at which the last waypoint before this rest is left [s]."""
    passages: tuple[float, ...]
    """Times at which the waypoints of its plans are reached and left [s]."""
    end: float
    """End time of its plans [s]: in the next hover at a waypoint, or the end of the mission."""
    is_holding: bool
    """Whether the vehicle hovers at the next waypoint."""
    released: float
    """Payload released so far [kg]."""
    numbers: Mapping[str, float]
    """Parameter values of the problem, by full name."""

    @property
    def planned_until(self) -> float:
        """Latest time [s] at which a new plan may begin, before the next waypoint or the end.

        After this time the vehicle follows its last plan.
        """
        # A plan must reach the next waypoint or the end exactly. With little time left, it would
        # spend much energy to counteract every gust.
        if not self.passages:
            return self.end - min(_LAST, _LAST_SHARE * (self.end - self.begin))
        ahead = self.passages[0] - self.begin
        near = (_LAST, _HOLD_SHARE) if self.is_holding else (_NEAR, _LAST_SHARE)
        return self.passages[0] - min(near[0], near[1] * ahead)

    def timeline(self, t: float) -> Timeline:
        """Return the mapping from fractions of the horizon to times, for a plan from time t [s].

        The start, the passages of waypoints and the end have fixed fractions in the compiled
        problem. Between them, the mapping is linear.
        """
        return Timeline(
            fractions=np.array(self.problem.compiled.declared.clock.fractions),
            times=np.array([t, *self.passages, self.end]),
        )

    def mesh(self, t: float) -> Mesh:
        """Return the mesh of a plan made in flight for the rest of the mission, from time t [s].

        It has short elements at the present time, where a disturbance is corrected, at the
        waypoints and at the end.
        """
        first = self.passages[0] if self.passages else self.end
        whole = first - self.begin
        # Successive solves on one mesh reuse the structure of the equations. A new mesh is made
        # when the time to the next waypoint, or to the end, has decreased by a fifth.
        shrunk = floor(log((first - t) / whole) / log(_KEPT)) if t > self.begin else 0
        then = self.timeline(first - whole * _KEPT**shrunk)
        pairs = pairwise(then.times.tolist())
        between = [inner for start, stop in pairs for inner in _graded(start, stop)]
        if self.is_holding:
            between.append(first + _AT_ONCE_S)
        fractions = then.fraction(np.array([*between, *then.times[1:-1]]))
        return Mesh.uniform(1, _DEGREE).with_breakpoints(fractions.tolist())

    def guess(self, t: float, known: Trajectories) -> dict[str, FloatArray]:
        """Return the initial guess of a new plan: samples of a known plan from time t [s] on.

        The result maps "time" and the full name of each variable to arrays of the same length.
        """
        declared = self.problem.compiled.declared
        times = np.linspace(t, self.end, _GUESSED)
        states = zip(known.state_names, known.states_at(times).T, strict=True)
        controls = zip(known.control_names, known.controls_at(times).T, strict=True)
        slots = {slot.name for slot in (*declared.states, *declared.algebraics)}
        named = {name: column for name, column in (*states, *controls) if name in slots}
        return {"time": times, **named}


def _graded(start: float, stop: float) -> list[float]:
    """Return the breakpoints of mesh elements between the times `start` and `stop` [s].

    Both ends are left out. The elements are short near them, and long in the middle.
    """
    half, widths = (stop - start) / 2, [_SHORT_S]
    if half < _SHORT_S:
        return []
    while sum(widths) < half:
        widths.append(min(_GROWTH * widths[-1], _LONG_S))
    ways = [way * half / sum(widths) for way in accumulate(widths)]
    return [*(start + way for way in ways), *(stop - way for way in ways[-2::-1])]


@dataclass(frozen=True, kw_only=True)
class Course:
    """Plan that the vehicle follows in flight, with its reference path and its assumptions.

    Attributes
    ----------
    plan : Trajectories
        The plan.
    path : PlannedPath
        The plan as a reference path of the controller.
    belief : Belief
        Mass and horizontal acceleration caused by the air that the plan assumes.
    estimate : ndarray, shape (3,)
        Estimate at the time of the solve: the vehicle's acceleration along world axes minus that by
        the equations `Replanner.dynamics` [m/s^2].
    """

    plan: Trajectories
    path: PlannedPath
    belief: Belief
    estimate: FloatArray


class Replanner:
    """Solver of the remaining mission in flight, with the present estimates of mass and wind.

    The attribute `dynamics` has the equations that are assumed before take-off. States are in the
    order of `dynamics.state_names`. The methods call the vehicle's acceleration minus that by these
    equations the unexplained acceleration. It shows errors of mass and wind.

    Parameters
    ----------
    scenario : Scenario
        The mission, and the vehicle as assumed by the controller.
    knowledge : Knowledge
        Wind that re-plans assume: the actual wind, the forecast corrected by an estimate, or the
        forecast alone. Calm air replaces a missing forecast.
    planner : Planner
        Planner that compiles the equations.
    margins : mapping, optional
        Scenario field -> amount by which its limit is tightened. Margins on rotor speed and thrust
        are ignored, so that re-plans may use both in full.

    Raises
    ------
    ScenarioError
        For a user's own model, or a waypoint without a time.
    """

    def __init__(
        self,
        scenario: Scenario,
        knowledge: Knowledge,
        planner: Planner,
        margins: Mapping[str, float] | None = None,
    ) -> None:
        if planner.builder is not build_model:
            raise ScenarioError(
                f"{scenario.name}: re-planning knows the declared model only; leave out "
                "baseline.mpc or the own model."
            )
        for k, waypoint in enumerate(scenario.mission.waypoints):
            if waypoint.at is None:
                raise ScenarioError(
                    f"{scenario.name}: re-planning passes waypoints at times that are given; solve "
                    f"the mission first, or give mission.waypoints[{k}].at."
                )
        is_told = knowledge is Knowledge.TOLD
        self.margins = margins or {}
        # The limits on rotor speed and thrust are hard, while the goal is a soft condition. Margins
        # on them could make a re-plan miss a goal that the vehicle has enough thrust to reach.
        soft = {name: m for name, m in self.margins.items() if name not in KEPT_BY_CONTROLLER}
        held = tightened(scenario, soft)
        believed = held.as_it_blows() if is_told else held.as_forecast()
        self._end = scenario.mission.fixed_duration
        self._scenario = scenario
        self.belief = Belief(mass=scenario.vehicle.total_mass, unexplained=(0.0, 0.0))
        self._whole, _ = planner.problem_for(believed)
        is_untold = not is_told and scenario.wind.forecast is None
        self._air: Numbers = {**still_air(self._whole.model)} if is_untold else {}
        #: Whether the wind that plans assume in flight is the forecast, so that a plan for the
        #: forecast is valid.
        self.believes_forecast = not is_untold and not (is_told and scenario.wind.forecast)
        self.remainders = _remainders(believed)
        #: Function of time [s]: mass of the payloads released before it [kg].
        self.released = scenario.release_schedule()
        self._numbers: Numbers = {**parameter_values(believed), **self._air}
        whole = self._whole.dynamics(parameters=self._numbers, horizon=(0.0, self._end))
        self.dynamics = whole.without_iterations()
        self._price = usual_price(scenario)
        gains = scenario.baseline.gains
        closing = gains.position * (gains.position + gains.velocity)
        #: Distance [m] at which closing the error takes the controller's largest correction.
        self.tube = gains.acceleration_max / closing
        self._last: dict[Remainder, Solution] = {}

    def at(self, t: float) -> Remainder:
        """Return the rest of the mission at time t [s], with its compiled problem."""
        return next(rest for rest in self.remainders[::-1] if rest.begin <= t)

    def first(self) -> Trajectories:
        """Return the plan of the whole mission, solved before take-off.

        Raises
        ------
        SolveError
            If the solve does not converge.
        """
        elements = min(max(ceil(self._end / _ELEMENT_S), _FEWEST), _MOST)
        found = self._whole.solve(
            mesh=Mesh.uniform(elements, _FIRST_DEGREE),
            tolerance=_ROUGHLY,
            parameters=self._numbers,
            horizon=(0.0, self._end),
            options=_AT_LEISURE,
            refinement=RefinementOptions(max_meshes=_FIRST_MESHES, limits_move=True),
        )
        if not found.status.is_solved:
            raise SolveError(f"re-planning: no plan before take-off: {found.message}")
        return trajectories_of(found)

    def prepare(self, plan: Trajectories) -> None:
        """Solve the remaining missions before take-off, as initial points of the solves in flight.

        `plan` is the plan made before take-off. If a solution breaks limits, the penalty on
        violations is increased for all later solves, and the solve is repeated. See
        docs/theory/soft_limits.md, eq. (2). If the solution still breaks limits after two
        increases, later solves use the penalty before these increases.
        """
        for rest in self.remainders:
            (state,), usual = self._states(plan, rest.begin), self._price
            for _ in range(_PENALTIES):
                guess = rest.guess(rest.begin, plan)
                found = self._solved(rest, rest.begin, state, self.belief, guess=guess)
                if not found.is_converged or breach_of(found) <= _MET:
                    break
                self._price *= _RAISE
            else:
                self._price = usual  # no penalty suffices: no flight keeps every limit

    def solve(
        self, t: float, state: FloatArray, belief: Belief, *, is_patient: bool = False
    ) -> Solution:
        """Solve the remaining mission from a given state at time t [s], for a re-plan.

        The solve starts from the last converged solution. It may take 40 iterations or, if
        `is_patient`, 300 as in solves before take-off. `belief` has the mass and the acceleration
        caused by the air that the re-plan assumes. `state` is in the order of
        `dynamics.state_names`. Raises a TranscriptionError if the state is outside the hard limits
        of rotors and battery.
        """
        rest = self.at(t)
        last = self._last.get(rest)
        return self._solved(rest, t, state, belief, last=last, is_patient=is_patient)

    def _solved(
        self,
        rest: Remainder,
        t: float,
        state: FloatArray,
        belief: Belief,
        *,
        guess: Mapping[str, FloatArray] | None = None,
        last: Solution | None = None,
        is_patient: bool = False,
    ) -> Solution:
        limits = self._scenario.limits
        held = dict(zip(self.dynamics.state_names, state.tolist(), strict=True))
        # A measured rotor speed slightly beyond its limit would make the problem infeasible.
        held |= {
            name: min(max(held[name], limits.rotor_speed_min), limits.rotor_speed_max)
            for name in (self.dynamics.state_names[k] for k in rotor_columns(self.dynamics))
        }
        now = rest.timeline(t)
        mesh = rest.mesh(t)
        warm = None
        if last is not None:
            # Without the iteration count of the cold start, above which it would be restarted cold.
            warm = replace(last.warm_start, cold_start=None)
            warm = warm.continued(mesh, last.timeline, now)
        solution = rest.problem.solve(
            mesh=mesh,
            parameters=self._with(belief, rest) | measured_start(held),
            horizon=(t, rest.end),
            guess=guess,
            warm_start=warm,
            options=_OPTIONS if warm is not None and not is_patient else _AT_LEISURE,
        )
        if solution.is_converged:
            self._last[rest] = solution
        return solution

    def _with(self, belief: Belief, rest: Remainder) -> Numbers:
        air = dict(zip(_HORIZONTAL, belief.unexplained, strict=True))
        learnt = {f"aerodynamics.unexplained[{axis}]": value for axis, value in air.items()}
        numbers = {**rest.numbers, PRICE: self._price}
        if _CLEARANCE in numbers:
            numbers[_CLEARANCE] += _SPARE_M
        return numbers | self._air | learnt | {"vehicle.mass": belief.mass - rest.released}

    def course(self, solution: Solution, belief: Belief, estimate: FloatArray) -> Course:
        """Return a re-plan (new plan in flight) with its reference path for the controller.

        `solution` is the solution of the re-plan. `belief` has the mass and the acceleration caused
        by the air that the re-plan assumes. `estimate` is the unexplained acceleration at the time
        of the solve, stored in the result [m/s^2].
        """
        plan, rest = trajectories_of(solution), self.at(solution.horizon[0])
        flow = rest.problem.dynamics(parameters=self._with(belief, rest), horizon=plan.horizon)
        path = path_of(plan, flow.without_iterations(), with_mass(self._scenario, belief))
        return Course(plan=plan, path=path, belief=belief, estimate=estimate)

    def first_course(self, plan: Trajectories) -> Course:
        """Return the plan made before take-off, with its reference path for the controller.

        The attribute `estimate` of the result is zero.
        """
        path = path_of(plan, self.dynamics, self._scenario)
        return Course(plan=plan, path=path, belief=self.belief, estimate=np.zeros(3))

    def is_off(self, course: Course, t: float, state: FloatArray) -> bool:
        """Return whether a flight has used up its margin to any limit in `margins.FIELDS`.

        A margin is used up if the vehicle is nearer to the limit than the plan is, by more than
        this margin. Limits without a margin have the margin zero. The vehicle
        follows the plan in `course`. `state`, shape (n_states,), is measured at time t [s].
        """
        now, limits = np.array([t]), self.dynamics.control_limits(HELD_BREACH)
        planned = self._states(course.plan, t)
        controls = course.plan.controls_at(now, limits)
        seen = [
            self.dynamics.limits_of(self.dynamics.solved(now, states, controls))
            for states in (planned, state[None])
        ]
        return any(
            lost > self.margins.get(field, 0.0)
            for before, after in zip(*seen, strict=True)
            for field, lost in used_up(before, after)
        )

    def begun(
        self, course: Course, start: float, end: float, state: FloatArray, unexplained: FloatArray
    ) -> FloatArray:
        """Predict the state at time `end` [s], from which the next re-plan starts.

        The vehicle follows the plan in `course`; `state` is measured at time `start` [s]. The
        result is the planned state if the controller can correct the deviation from it. Otherwise
        it is moved towards the measured state, just until the controller can correct the rest.

        `unexplained` is the present estimate of the unexplained acceleration, minus
        `course.estimate` [m/s^2]. Attitude and rotor speeds of the result differ from the plan, so
        that the thrust balances this acceleration. See docs/theory/soft_limits.md.
        """
        planned, later = self._states(course.plan, start, end)
        self._balance_added_acceleration(later, course.path(end), unexplained)
        places = [self.dynamics.state_names.index(name) for name in POSITION_STATES]
        distance = float(np.linalg.norm((state - planned)[places]))
        if distance <= self.tube:
            return later
        # As little as leaves the vehicle within the tube about the next plan.
        share = 1.0 - self.tube / distance
        speeds = [self.dynamics.state_names.index(name) for name in VELOCITY_STATES]
        faster = share * (state - planned)[speeds]
        later[places] += share * (state - planned)[places] + (end - start) * faster
        later[speeds] += faster
        return later

    def _balance_added_acceleration(
        self, state: FloatArray, setpoint: Setpoint, unexplained: FloatArray
    ) -> None:
        """Change a planned state so that the thrust balances an additional acceleration.

        This acceleration is `unexplained`, shape (3,) [m/s^2]. `setpoint` has the planned
        acceleration and yaw at the time of `state`. Attitude and rotor speeds in `state` are
        changed in place. Implements docs/theory/soft_limits.md, eq. (3).
        """
        weight = np.array([0.0, 0.0, self._scenario.gravity])
        given = np.array(setpoint.acceleration[:3]) + weight
        balancing, yaw = given - unexplained, setpoint.place[3]
        angles = [self.dynamics.state_names.index(name) for name in TILT_STATES]
        before, after = (tilt_toward(force.tolist(), yaw) for force in (given, balancing))
        state[angles] += np.subtract(after, before)
        state[rotor_columns(self.dynamics)] *= sqrt(norm(balancing) / norm(given))

    def _states(self, plan: Trajectories, *times: float) -> FloatArray:
        """Return a plan's states at given times [s], shape (n_times, n_states).

        The columns are in the order of `dynamics.state_names`.
        """
        names = list(plan.state_names)
        columns = [names.index(name) for name in self.dynamics.state_names]
        return plan.states_at(np.array(times))[:, columns]


def breach_of(solution: Solution) -> float:
    """Return the largest violation of a soft limit in the solution of a re-plan (plan in flight).

    It is the largest number, whatever the units of the limits (m, rad, ...).
    """
    declared, held = solution.problem.compiled.declared, solution.trajectory.statics.tolist()
    named = zip(declared.statics, held, strict=True)
    return max(number for slot, number in named if slot.component in BREACHES)


def _remainders(believed: Scenario) -> tuple[Remainder, ...]:
    """Return the remaining missions after the first 0, 1, 2, ... waypoints of a mission.

    `believed` is the whole mission, with the wind and the vehicle that plans assume.
    """
    mission, times = believed.mission, believed.nominal_times
    ahead = [_ahead(believed, k) for k in range(len(mission.waypoints) + 1)]
    key = structure_key(believed)
    problems = REMAINING.get(key) or REMAINING.store(key, tuple(map(_compiled, ahead)))
    released = [0.0, *accumulate(waypoint.release for waypoint in mission.waypoints)]
    remainders = []
    for k, (problem, left) in enumerate(zip(problems, ahead, strict=True)):
        *passages, end = left.nominal_times
        remainders.append(
            Remainder(
                problem=problem,
                begin=times[2 * k - 1] if k else 0.0,
                # A waypoint without hover is reached and left at the same time.
                passages=tuple(dict.fromkeys(passages)),
                end=end,
                is_holding=any(waypoint.hold > 0.0 for waypoint in left.mission.waypoints[:1]),
                released=released[k],
                numbers=parameter_values(left),
            )
        )
    return tuple(remainders)


def _ahead(believed: Scenario, k: int) -> Scenario:
    """Return the mission that remains after its first k waypoints, for re-plans in flight.

    It ends at the goal or, if hovers remain, during the first of them.
    """
    mission = believed.mission
    left = mission.waypoints[k:]
    values: dict[str, object] = {"waypoints": left}
    holding = next((n for n, waypoint in enumerate(left) if waypoint.hold > 0.0), None)
    # The parts after the hover do not affect the flight before it.
    if holding is not None:
        place = left[holding]
        at = believed.nominal_times[2 * (k + holding)]
        lasting = min(place.hold / 2, _INTO_HOLD)
        kept = place.model_copy(update={"hold": _SETTLED * lasting, "release": 0.0})
        yaw = mission.goal.yaw if place.yaw is None else place.yaw
        goal = mission.goal.model_copy(update={"position": place.position, "yaw": yaw})
        values = {"waypoints": (*left[:holding], kept), "goal": goal, "duration": at + lasting}
    return believed.model_copy(update={"mission": mission.model_copy(update=values)})


def _compiled(left: Scenario) -> Problem:
    model = build_remaining(left)
    return compile(model, times=free_times(model, left))


def with_mass(scenario: Scenario, belief: Belief) -> Scenario:
    """Return the scenario with the estimated mass of the vehicle.

    `belief.mass` includes the payload at take-off [kg]. The payload of the scenario is unchanged.
    The mass of the vehicle without payload is `belief.mass` minus this payload.
    """
    vehicle = scenario.vehicle
    learnt = vehicle.model_copy(update={"mass": belief.mass - vehicle.payload})
    return scenario.model_copy(update={"vehicle": learnt})
