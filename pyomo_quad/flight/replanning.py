"""Re-planning in flight (model-predictive control) by repeated solves of the remaining mission.

Every interval the state is measured, and the flight of the rest of the mission with the least
energy is solved for, from where the vehicle will be once the solve is done, warm-started from the
plan that is being flown.  Its controls are applied until the next plan, unless it assumes calm air
for want of a forecast while the wind acts by drag: the adaptive controller follows such a plan
throughout.  Where the wind is an acceleration by itself, as in the paper, it does not: begun anew
at each plan, the controller has not learnt that acceleration yet and is blown away (18 m in
`paper_wind`).  If the next plan is late or its solve fails, the previous plan continues under the
adaptive controller.  The adaptive controller also flies the last seconds: a plan that meets the
goal exactly would there counteract every gust at any cost, based on a forecast whose error is as
large as the gust's change.

Waypoints are passed at their times.  Shortly before a waypoint, and while the vehicle holds there,
there is no re-planning: the last plan continues under the adaptive controller.  The mission after
the waypoint has its own equations; it is compiled and solved once before take-off.

Plans keep an additional distance of three centimetres from zones, for the error of a coarse mesh.

A wind that differs from the forecast, or a mass that differs from the assumed mass, causes an
acceleration that the equations do not explain.  The identifier of the adaptive law estimates it,
and the plans include it.  Its vertical part is attributed to the mass, even if an updraft causes
it; the rest is attributed to the wind.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import accumulate
from math import ceil, inf
from time import perf_counter, process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from pyomo_quad.collocation import (
    Dynamics,
    Mesh,
    Problem,
    Solution,
    SolveError,
    SolverOptions,
    Timeline,
    Trajectory,
    TranscriptionError,
    compile,
)
from pyomo_quad.flight.baselines import (
    RATE_HZ,
    Integrator,
    assembled_flight,
    even_times,
    fly,
    path_of,
    refuse_other_vehicles,
    start_state,
)
from pyomo_quad.flight.caches import REMAINING
from pyomo_quad.flight.controller import (
    AdaptiveController,
    BacksteppingLoop,
    mixer_matrix,
    rotor_columns,
)
from pyomo_quad.flight.flight import (
    AIR_FORCE,
    HELD_BREACH,
    VELOCITY_STATES,
    Flight,
    Flown,
    Resolve,
)
from pyomo_quad.flight.plan import Plan, Trajectories, trajectories_of
from pyomo_quad.flight.planning import Planner
from pyomo_quad.flight.references import SampledPath
from pyomo_quad.flight.verification import OpenLoop
from pyomo_quad.model import build_model, build_remaining, parameter_values, structure_key
from pyomo_quad.model.mission import free_times, measured_start
from pyomo_quad.model.wind import still_air
from pyomo_quad.scenario import Scenario, ScenarioError
from pyomo_quad.scenario.tables import Knowledge, Replanning, SolveTiming
from pyomo_quad.scenario.wind import WindCoupling

FloatArray = NDArray[np.float64]
Numbers = dict[str, float | Callable[[float], float]]
Computer = Callable[[float], float]
"""Processor seconds that a solve took here -> seconds that it takes aboard."""

_HORIZONTAL = "xy"
_SLOPES = tuple((f"rigid_body.dv{axis}_dt", None) for axis in "xyz")
_FORCES = tuple((name, None) for name in AIR_FORCE)
# Shares of the thrust expected that may be lacking or left over: of a mass from half to twice.
_MOST_AMISS = (-0.5, 1.0)
# With less of the weight carried, nothing is said of the mass.
_LEAST_LIFT = 0.3
# The mesh of every solve: fine enough for a thousandth of the energy above hover, and for 30 ms.
_ELEMENT_S, _FEWEST, _MOST, _DEGREE = 1.25, 8, 24, 4
# A re-solve keeps to one barrier parameter, as large as costs nothing that is seen: limits begin
# and cease to hold at other points of each mesh, and beside a zone a thirtieth of it took fifteen
# iterations in vain.  What does not converge soon comes too late; linear steps are not refined.
_BARRIER = (("mu_init", 3e-6), ("mu_target", 3e-6))
_HASTE = (("fast_step_computation", "yes"),)
_OPTIONS = SolverOptions(tolerance=1e-5, max_iterations=15, extra=(*_BARRIER, *_HASTE))
# Before take-off there is time.
_AT_LEISURE = SolverOptions(tolerance=1e-6, max_iterations=300)
# Rest of the mission [s] that is flown under feedback instead of being planned again, and the
# share of a short one.  Of five perturbed flights of ten seconds, planning to 0.6 s before the end
# cost from 3 to 30 J more and ended from 1.2 to 1.7 times as far off.
_LAST, _LAST_SHARE = 3.0, 0.3
# The same ahead of a waypoint, of which only the place must be met, and the share ahead of a hold,
# where it must be met at rest: in gusts it did not keep its limits under three tenths.
_NEAR, _HOLD_SHARE = 1.0, 0.5
_CLEARANCE = "airspace.clearance"
# Planned beyond the clearance of zones, m: the mesh of a plan in flight lets it pass nearer between
# its points, and what is flown is not quite what is planned; at 8 m/s, in `parcel`, by 9 mm with
# the wind told and by 17 mm with the wind estimated.
_SPARE_M = 0.03
# Of what is predicted while a solve goes on, and of the estimate; both are far below the noise of
# any sensor.
_TOLERANCE = 1e-6


def replanned_name(knowledge: Knowledge) -> str:
    """Return the name of a re-planned flight by its knowledge of the wind."""
    return f"mpc/{knowledge.value}"


@dataclass(frozen=True, kw_only=True)
class _Belief:
    """Estimated mass [kg] and horizontal acceleration by the air [m/s^2]."""

    mass: float
    unexplained: tuple[float, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Remainder:
    """Part of the mission that remains after some of its waypoints."""

    problem: Problem
    begin: float
    """Time at which the last of these waypoints is left [s]."""
    passages: tuple[float, ...]
    """Times at which the remaining waypoints are reached and left [s]."""
    end: float
    """End time of the mission [s]."""
    is_holding: bool
    """Whether the mission has a hold at the next waypoint."""
    released: float
    """Payload released so far [kg]."""
    numbers: Mapping[str, float]

    @property
    def planned_until(self) -> float:
        """Time after which re-planning ends [s]."""
        if not self.passages:
            return self.end - min(_LAST, _LAST_SHARE * (self.end - self.begin))
        ahead = self.passages[0] - self.begin
        near = (_LAST, _HOLD_SHARE) if self.is_holding else (_NEAR, _LAST_SHARE)
        return self.passages[0] - min(near[0], near[1] * ahead)

    def timeline(self, t: float) -> Timeline:
        """Return the passing times of the remaining mission, counted from a given time."""
        return Timeline(
            fractions=np.array(self.problem.compiled.declared.clock.fractions),
            times=np.array([t, *self.passages, self.end]),
        )

    def guess(self, mesh: Mesh, now: Timeline, last: Solution) -> Trajectory:
        """Return the rest of the previous plan as a guess on a mesh of the remaining mission."""
        path = last.trajectory
        nodes, points = (
            last.timeline.fraction(now.time(fractions))
            for fractions in (mesh.node_fractions, mesh.point_fractions)
        )
        statics = [
            self.problem.values.static_value(slot)
            for slot in self.problem.compiled.declared.statics
        ]
        return Trajectory(
            mesh=mesh,
            states=path.states_at(nodes),
            algebraics=path.algebraics_at(points),
            statics=np.array(statics, dtype=float),
        )


@dataclass(frozen=True, kw_only=True)
class _Course:
    """Plan that is being flown, with the estimates and the remaining mission behind it."""

    plan: Trajectories
    belief: _Belief
    rest: _Remainder
    estimate: FloatArray
    """Unexplained acceleration that the belief accounts for [m/s^2]."""


@dataclass(frozen=True, kw_only=True)
class _Leg:
    """Part of a flight, in open loop or under feedback."""

    course: _Course
    start: float
    end: float
    is_tracked: bool
    learnt: tuple[float, float, float]
    """Estimated acceleration that the plan does not include [m/s^2]."""


class Replanner:
    """Solver of the remaining mission with the present estimates of mass and wind.

    Parameters
    ----------
    scenario : Scenario
        The mission and the vehicle as believed.
    knowledge : Knowledge
        Information on the wind.
    planner : Planner
        Keeps the compiled equations.
    """

    def __init__(self, scenario: Scenario, knowledge: Knowledge, planner: Planner) -> None:
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
        believed = scenario.as_it_blows() if is_told else scenario.as_forecast()
        self._end = scenario.mission.fixed_duration
        self._scenario = scenario
        self.belief = _Belief(mass=scenario.vehicle.total_mass, unexplained=(0.0, 0.0))
        whole, _ = planner.problem_for(believed)
        is_untold = not is_told and scenario.wind.forecast is None
        self._air: Numbers = {**still_air(whole.model)} if is_untold else {}
        self.remainders = _remainders(believed)
        numbers = {**parameter_values(believed)} | self._air
        self.dynamics = whole.dynamics(parameters=numbers, horizon=(0.0, self._end))
        elements = min(max(ceil(self._end / _ELEMENT_S), _FEWEST), _MOST)
        self._mesh = Mesh.uniform(elements, _DEGREE)
        self._last: dict[_Remainder, Solution] = {}

    def released(self, t: float) -> float:
        """Return the mass of the payload released until a time [kg]."""
        return max((rest.released for rest in self.remainders if rest.begin < t), default=0.0)

    def at(self, t: float) -> _Remainder:
        """Return the remaining mission at a time."""
        return next(rest for rest in self.remainders[::-1] if rest.begin <= t)

    def prepare(self, plan: Trajectories, belief: _Belief) -> None:
        """Solve the remaining mission after each waypoint once, to have warm starts in flight."""
        for rest in self.remainders[1:]:
            self.solve(rest.begin, plan.states_at(np.array([rest.begin]))[0], belief)

    def solve(self, t: float, state: FloatArray, belief: _Belief) -> Solution:
        """Solve the remaining mission from a state at a time."""
        limits = self._scenario.limits
        held = dict(zip(self.dynamics.state_names, state.tolist(), strict=True))
        # Rotors that run a little beyond their limit leave no flight within it to be found.
        held |= {
            name: min(max(held[name], limits.rotor_speed_min), limits.rotor_speed_max)
            for name in (self.dynamics.state_names[k] for k in rotor_columns(self.dynamics))
        }
        rest = self.at(t)
        last, now = self._last.get(rest), rest.timeline(t)
        mesh = self._mesh.with_breakpoints(tuple(now.fractions[1:-1].tolist()))
        start: dict[str, Any] = {"options": _AT_LEISURE}
        if last is not None:
            start = {
                "options": _OPTIONS,
                "warm_start": last.warm_start.continued(mesh, last.timeline, now),
            }
        elif self._last:
            start["guess"] = rest.guess(mesh, now, next(iter(self._last.values())))
        solution = rest.problem.solve(
            mesh=mesh,
            parameters=self._with(belief, rest) | measured_start(held),
            horizon=(t, self._end),
            **start,
        )
        if solution.is_converged:
            self._last[rest] = solution
        return solution

    def _with(self, belief: _Belief, rest: _Remainder) -> Numbers:
        air = dict(zip(_HORIZONTAL, belief.unexplained, strict=True))
        learnt = {f"aerodynamics.unexplained[{axis}]": value for axis, value in air.items()}
        numbers = {**rest.numbers}
        if _CLEARANCE in numbers:
            numbers[_CLEARANCE] += _SPARE_M
        return numbers | self._air | learnt | {"vehicle.mass": belief.mass - rest.released}

    def path(self, course: _Course) -> SampledPath:
        """Return a course as a reference path for the controller."""
        flow = course.rest.problem.dynamics(
            parameters=self._with(course.belief, course.rest), horizon=course.plan.horizon
        )
        vehicle = _with_mass(self._scenario, course.belief, course.rest.released).vehicle
        return path_of(course.plan, flow, vehicle)

    def predicted(
        self, course: _Course, start: float, end: float, state: FloatArray, unexplained: FloatArray
    ) -> FloatArray:
        """Return the state that a course predicts at a time."""
        speeds = [self.dynamics.state_names.index(name) for name in VELOCITY_STATES]
        limits = self.dynamics.control_limits(HELD_BREACH)
        inside = self.dynamics.just_after(start)

        def rates(t: float, x: FloatArray) -> FloatArray:
            controls = course.plan.controls_at(np.array([t]), limits)[0]
            slope = self.dynamics.rates(max(t, inside), x, controls)
            slope[speeds] += unexplained
            return slope

        if end <= start:
            return state
        flown = solve_ivp(rates, (start, end), state, rtol=_TOLERANCE, atol=_TOLERANCE)
        return np.asarray(flown.y[:, -1])


def _remainders(believed: Scenario) -> tuple[_Remainder, ...]:
    """Return the remaining missions after each number of passed waypoints."""
    mission, times = believed.mission, believed.nominal_times
    ahead = [
        believed.model_copy(
            update={"mission": mission.model_copy(update={"waypoints": mission.waypoints[k:]})}
        )
        for k in range(len(mission.waypoints) + 1)
    ]
    key = structure_key(believed)
    problems = REMAINING.get(key) or REMAINING.store(key, tuple(map(_compiled, ahead)))
    released = [0.0, *accumulate(waypoint.release for waypoint in mission.waypoints)]
    return tuple(
        _Remainder(
            problem=problem,
            begin=times[2 * k - 1] if k else 0.0,
            # One that does not hold is reached and left at once.
            passages=tuple(dict.fromkeys(times[2 * k : -1])),
            end=times[-1],
            is_holding=any(waypoint.hold > 0.0 for waypoint in left.mission.waypoints[:1]),
            released=released[k],
            numbers=parameter_values(left),
        )
        for k, (problem, left) in enumerate(zip(problems, ahead, strict=True))
    )


def _compiled(left: Scenario) -> Problem:
    model = build_remaining(left)
    return compile(model, times=free_times(model, left))


class _Observer:
    """Estimator of the acceleration that the equations do not explain (adaptive law)."""

    def __init__(self, scenario: Scenario, replanner: Replanner, velocity: FloatArray) -> None:
        gains = scenario.baseline.gains
        self._dynamics = dynamics = replanner.dynamics
        self._released = replanner.released
        self._mass, self._gravity = scenario.vehicle.total_mass, scenario.gravity
        self._columns = [dynamics.state_names.index(name) for name in VELOCITY_STATES]
        # Without errors to close, the loop is its identifier alone.
        self._loop = BacksteppingLoop(
            outer=(0.0,) * 3,
            inner=(0.0,) * 3,
            reach=inf,
            identification=gains.force_identification,
            effort_max=inf,
            adaptation=gains.force_adaptation,
            disturbance_max=gains.force_max,
        )
        self._states = np.array([*(0.0,) * 3, *velocity, *(0.0,) * 3])

    @property
    def estimate(self) -> FloatArray:
        """Estimated acceleration that the equations do not explain, shape (3,) [m/s^2]."""
        return self._states[-3:].copy()

    def belief(self, flown: Flown) -> _Belief:
        """Return the mass and wind that explain the estimate at the end of a part of the flight."""
        last = flown.t[-1:], flown.states[-1:], flown.controls[-1:]
        acceleration = self._dynamics.table(_SLOPES, *last)[0]
        forces = self._dynamics.table(_FORCES, *last)[0]
        released = self._released(float(flown.t[-1]))
        mass = self._mass - released
        thrust = acceleration - forces / mass
        thrust[2] += self._gravity
        along, aside, upwards = self.estimate.tolist()
        lifting = max(float(thrust[2]), _LEAST_LIFT * self._gravity)
        excess = min(max(upwards / lifting, _MOST_AMISS[0]), _MOST_AMISS[1])
        return _Belief(
            mass=mass / (1.0 + excess) + released,
            unexplained=(along - excess * float(thrust[0]), aside - excess * float(thrust[1])),
        )

    def watch(self, flown: Flown) -> None:
        """Update the estimate with a part of the flight."""
        explained = self._dynamics.table(_SLOPES, flown.t, flown.states, flown.controls)
        seen = np.hstack([flown.states[:, self._columns], explained])

        def rates(t: float, states: FloatArray) -> list[float]:
            now = [float(np.interp(t, flown.t, column)) for column in seen.T]
            return self._loop((0.0,) * 3, now[:3], (0.0,) * 3, now[3:], states.tolist())[1]

        span = (flown.t[0], flown.t[-1])
        learnt = solve_ivp(rates, span, self._states, rtol=_TOLERANCE, atol=_TOLERANCE)
        self._states = np.asarray(learnt.y[:, -1])


class _Aircraft:
    """Simulated vehicle in the actual wind that flies the plans."""

    def __init__(self, scenario: Scenario, replanner: Replanner, dynamics: Dynamics) -> None:
        self.dynamics = dynamics
        self._alone = OpenLoop(dynamics)
        self._scenario, self._replanner = scenario, replanner
        # The controller knows the vehicle as it is believed, not as it flies.
        self._mixer = mixer_matrix(replanner.dynamics)
        self._measured = [dynamics.state_names.index(n) for n in replanner.dynamics.state_names]

    def measured(self, state: FloatArray) -> FloatArray:
        """Return the measured states, without the states of the turbulence."""
        return state[self._measured]

    def seen(self, flown: Flown) -> Flown:
        """Return a part of the flight with the measured states only."""
        return replace(flown, states=flown.states[:, self._measured])

    def fly(self, leg: _Leg, state: FloatArray, integrator: Integrator) -> Flown:
        """Simulate a part of the flight."""
        plan, belief = leg.course.plan, leg.course.belief
        if leg.is_tracked:
            return fly(
                dynamics=self.dynamics,
                controller=AdaptiveController(
                    _with_mass(self._scenario, belief, self._replanner.released(leg.end)),
                    self._mixer,
                    leg.learnt,
                ),
                reference=self._replanner.path(leg.course),
                initial_state=state,
                times=even_times(leg.start, leg.end, RATE_HZ),
                integrator=integrator,
            ).flown
        shortest = np.diff(plan.mesh.breakpoints).min() * (plan.horizon[1] - plan.horizon[0])
        return self._alone.fly(
            plan.mesh,
            plan.controls,
            state,
            plan.horizon,
            part=(leg.start, leg.end),
            samples_per_element=ceil(min(shortest, leg.end - leg.start) * RATE_HZ),
            method=integrator.value,
        )


def _with_mass(scenario: Scenario, belief: _Belief, released: float) -> Scenario:
    """Return the controller's vehicle with the estimated mass, less the released payload."""
    vehicle = scenario.vehicle
    learnt = vehicle.model_copy(update={"mass": belief.mass - released - vehicle.payload})
    return scenario.model_copy(update={"vehicle": learnt})


class _ReplannedFlight:
    """Re-planned flight in progress: its parts, the present plan and the observer."""

    def __init__(
        self,
        scenario: Scenario,
        settings: Replanning,
        knowledge: Knowledge,
        *,
        replanner: Replanner,
        dynamics: Dynamics,
        computer: Computer,
    ) -> None:
        self._settings, self._computer, self._replanner = settings, computer, replanner
        self._is_observing = knowledge is not Knowledge.UNTOLD
        is_drag = scenario.wind.coupling is WindCoupling.DRAG
        self._is_followed = is_drag and not self._is_observing
        self._end = scenario.mission.fixed_duration
        self._aircraft = _Aircraft(scenario, replanner, dynamics)
        state = start_state(scenario, dynamics)
        self._t, self._state = 0.0, state
        first = replanner.solve(0.0, self._aircraft.measured(state), replanner.belief)
        if not first.is_converged:
            raise SolveError(f"re-planning: no plan before take-off: {first.message}")
        self._take(first, replanner.belief, np.zeros(3), 0.0)
        replanner.prepare(self._course.plan, replanner.belief)
        # When the next plan is due, and the last one's controls are no longer applied alone.
        self._due = settings.interval + settings.solve_time
        speeds = [dynamics.state_names.index(name) for name in VELOCITY_STATES]
        self._observer = _Observer(scenario, replanner, state[speeds])
        self.legs: list[_Leg] = []
        self.parts: list[Flown] = []
        self.resolves: list[Resolve] = []

    def fly(self) -> None:
        """Simulate the whole mission."""
        measured_at = self._settings.interval
        for rest in self._replanner.remainders:
            measured_at = max(measured_at, rest.begin)
            while measured_at + self._settings.solve_time < rest.planned_until:
                self._advance(measured_at)
                arrived_at = self._replan(measured_at)
                measured_at = max(measured_at + self._settings.interval, arrived_at)
            self._due = min(self._due, self._t)
        self._advance(self._end)

    def _replan(self, measured_at: float) -> float:
        """Solve from a measurement while the flight goes on; return the time of the new plan."""
        meant_for = measured_at + self._settings.solve_time
        estimate, belief = np.zeros(3), self._replanner.belief
        if self._is_observing:
            estimate, belief = (
                self._observer.estimate,
                self._observer.belief(self._aircraft.seen(self.parts[-1])),
            )
        state = self._replanner.predicted(
            self._course, measured_at, meant_for, self._aircraft.measured(self._state), estimate
        )
        began = process_time()
        solution = self._solved(meant_for, state, belief)
        solve_s = process_time() - began
        aboard = self._computer(solve_s)
        arrived_at = min(max(meant_for, measured_at + aboard), self._end)
        self._advance(arrived_at)
        if solution is not None:
            self._take(solution, belief, estimate, meant_for)
            self._due = arrived_at + self._settings.interval
        self.resolves.append(
            Resolve(
                t=measured_at,
                arrived_at=arrived_at,
                solve_s=solve_s,
                is_converged=solution is not None,
                is_late=aboard > self._settings.solve_time,
            )
        )
        return arrived_at

    def _take(self, solution: Solution, belief: _Belief, estimate: FloatArray, t: float) -> None:
        plan, rest = trajectories_of(solution), self._replanner.at(t)
        self._course = _Course(plan=plan, belief=belief, rest=rest, estimate=estimate)

    def _solved(self, t: float, state: FloatArray, belief: _Belief) -> Solution | None:
        """Return the solution of the remaining mission, None if the solve fails."""
        try:
            solution = self._replanner.solve(t, state, belief)
        except TranscriptionError:
            return None  # measured beyond a limit, from where no plan within it starts
        return solution if solution.is_converged else None

    def _advance(self, end: float) -> None:
        """Fly the present plan until a time, under feedback once the next plan is due."""
        border = self._t if self._is_followed else min(max(self._due, self._t), end)
        for start, stop, is_tracked in ((self._t, border, False), (border, end, True)):
            if stop - start > _SHORTEST * self._end:
                course = self._course
                along, aside, upwards = (self._observer.estimate - course.estimate).tolist()
                learnt = (along, aside, upwards)
                self._fly(
                    _Leg(course=course, start=start, end=stop, is_tracked=is_tracked, learnt=learnt)
                )
        self._t = end

    def _fly(self, leg: _Leg) -> None:
        flown = self._aircraft.fly(leg, self._state, Integrator.RUNGE_KUTTA)
        self._state = flown.states[-1]
        self.legs.append(leg)
        self.parts.append(flown)
        self._observer.watch(self._aircraft.seen(flown))

    def flown_twice(self) -> list[tuple[Flown, Flown]]:
        """Simulate each part again with the other integrator, from the same initial state.

        That is where it was measured and planned from: flown again all the way, by plans that
        answered other roundings, a flight leaves them within seconds as any without feedback does.
        """
        again = self._aircraft.fly
        return [
            (part, again(leg, part.states[0], Integrator.MULTISTEP))
            for leg, part in zip(self.legs, self.parts, strict=True)
        ]


# Parts of the flight shorter than this share of it are rounding.
_SHORTEST = 1e-9


def _charged(settings: Replanning, solve_s: float) -> float:
    return solve_s if settings.clock is SolveTiming.MEASURED else settings.solve_time


def fly_replanned(
    scenario: Scenario,
    knowledge: Knowledge,
    *,
    dynamics: Dynamics,
    planner: Planner,
    plan: Plan | None = None,
    computer: Computer | None = None,
) -> Flight:
    """Simulate a mission with repeated re-planning.

    It is verified as a controlled flight is, from one solve to the next: the plan at hand, applied
    by another integrator from the same state, ends at the same place and spends the same energy.

    Parameters
    ----------
    scenario : Scenario
        The mission, and the vehicle as it is believed to be.
    knowledge : Knowledge
        What is believed of the wind.
    dynamics : Dynamics
        The vehicle that flies, in the wind that blows.
    plan : Plan, optional
        Prices the flight's end.
    computer : callable, optional
        How long a solve takes aboard; by default what the scenario states or this process takes.

    Raises
    ------
    ScenarioError
        If the model is not the declared one.
    SolveError
        If there is no plan before take-off, or the flight is out of control.
    """
    began = perf_counter()
    refuse_other_vehicles(scenario, dynamics)
    settings = scenario.baseline.mpc or Replanning()
    if computer is None:
        computer = partial(_charged, settings)
    flight = _ReplannedFlight(
        scenario,
        settings,
        knowledge,
        replanner=Replanner(scenario, knowledge, planner),
        dynamics=dynamics,
        computer=computer,
    )
    flight.fly()
    assembled = assembled_flight(
        replanned_name(knowledge), scenario, dynamics, flight.flown_twice(), plan, began
    )
    return replace(assembled, resolves=tuple(flight.resolves))
