"""Re-planning in flight (model-predictive control) by repeated solves of the remaining mission.

At constant intervals during a simulated flight, the rest of the mission is solved for a re-plan.
The re-plan begins at the time at which its solve is expected to end. An adaptive controller follows
the newest plan, at first the plan made before take-off.

Re-plans may violate most limits at a penalty (soft limits), so that a re-plan can nearly always be
found. The limits of rotors and battery are hard. See docs/theory/soft_limits.md.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from time import perf_counter, process_time

import numpy as np
from scipy.integrate import solve_ivp

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import (
    ClosedLoop,
    Dynamics,
    Solution,
    TranscriptionError,
)
from pyomo_quad.flight.baselines import (
    RATE_HZ,
    ClosedLoopFlight,
    Integrator,
    assembled_flight,
    closed_loop,
    even_times,
    fly,
    refuse_other_vehicles,
    start_state,
)
from pyomo_quad.flight.controller import (
    AdaptiveController,
    BacksteppingLoop,
    mixer_matrix,
)
from pyomo_quad.flight.flight import (
    AIR_FORCE,
    VELOCITY_STATES,
    Flight,
    Flown,
    Resolve,
)
from pyomo_quad.flight.plan import Plan
from pyomo_quad.flight.planning import Planner
from pyomo_quad.flight.remaining import Belief, Course, Replanner, with_mass
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.tables import Knowledge, Replanning, SolveTiming

Computer = Callable[[float], float]
"""Function from the processor time of a solve here to its time aboard the vehicle [s]."""

_SLOPES = tuple((f"rigid_body.dv{axis}_dt", None) for axis in "xyz")
_FORCES = tuple((name, None) for name in AIR_FORCE)
# Limits of the unexplained vertical acceleration, relative to that by the thrust: masses from half
# to twice the assumed mass.
_MOST_AMISS = (-0.5, 1.0)
# Smallest vertical thrust, relative to the weight, from which the mass is estimated.
_LEAST_LIFT = 0.3
# Tolerance of the integrator of the estimate, far below the noise of any sensor.
_TOLERANCE = 1e-6


def replanned_name(knowledge: Knowledge) -> str:
    """Return the name of a flight with re-planning, such as "mpc/told".

    `knowledge` says which wind re-plans assume: the actual wind ("told"), the forecast corrected by
    an estimate ("estimated"), or the forecast alone ("untold").
    """
    return f"mpc/{knowledge.value}"


@dataclass(frozen=True, kw_only=True)
class _Leg:
    """Part of a flight, from `start` to `end` [s], in which the vehicle follows one plan.

    `course` has the plan, its reference path and its assumptions on mass and wind.
    """

    course: Course
    start: float
    end: float
    learnt: tuple[float, float, float]
    """Estimated acceleration that the plan does not include [m/s^2]."""
    last: FloatArray | None
    """The controller's states at the start of the part, None at take-off."""


class _Observer:
    """Estimator of the unexplained acceleration, which the assumed equations do not contain.

    The equations assumed before take-off are `Replanner.dynamics`. The estimator applies the
    adaptation law of the controller to the measured states.
    """

    def __init__(self, scenario: Scenario, replanner: Replanner, velocity: FloatArray) -> None:
        gains = scenario.baseline.gains
        # Wind and mass that differ from those of these equations cause the unexplained
        # acceleration.
        self._dynamics = dynamics = replanner.dynamics
        self._released = replanner.released
        self._mass, self._gravity = scenario.vehicle.total_mass, scenario.gravity
        self._columns = [dynamics.state_names.index(name) for name in VELOCITY_STATES]
        # Without tracking errors, the loop reduces to its estimator.
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
        """Present estimate of the unexplained acceleration, shape (3,) [m/s^2]."""
        return self._states[-3:].copy()

    def belief(self, flown: Flown) -> Belief:
        """Return the estimated mass and horizontal acceleration by the air, for the next plan.

        The mass explains the vertical part of the unexplained acceleration, and the air the rest.
        `flown` is the last simulated part of the flight. Implements docs/theory/soft_limits.md, eq.
        (4).
        """
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
        return Belief(
            mass=mass / (1.0 + excess) + released,
            unexplained=(along - excess * float(thrust[0]), aside - excess * float(thrust[1])),
        )

    def watch(self, flown: Flown) -> None:
        """Update the estimate of the unexplained acceleration with a simulated part of a flight.

        `flown` has the samples of this part, which begins where the last part ended.
        """
        explained = self._dynamics.table(_SLOPES, flown.t, flown.states, flown.controls)
        seen = np.hstack([flown.states[:, self._columns], explained])

        def rates(t: float, states: FloatArray) -> list[float]:
            now = [float(np.interp(t, flown.t, column)) for column in seen.T]
            return self._loop((0.0,) * 3, now[:3], (0.0,) * 3, now[3:], states.tolist())[1]

        span = (flown.t[0], flown.t[-1])
        learnt = solve_ivp(rates, span, self._states, rtol=_TOLERANCE, atol=_TOLERANCE)
        self._states = np.asarray(learnt.y[:, -1])


class _Aircraft:
    """Simulated vehicle in the actual wind, with its adaptive controller."""

    def __init__(self, scenario: Scenario, replanner: Replanner, dynamics: Dynamics) -> None:
        self.dynamics = dynamics
        self._scenario, self._replanner = scenario, replanner
        # The controller uses the assumed vehicle, which may differ from the simulated one.
        self._mixer = mixer_matrix(replanner.dynamics)
        self._measured = [dynamics.state_names.index(n) for n in replanner.dynamics.state_names]
        # Compiled closed loops; the mass is the only belief that the controller's law depends on.
        self._systems: dict[float, ClosedLoop] = {}

    def measured(self, state: FloatArray) -> FloatArray:
        """Return the states that the vehicle measures, in the order of the plans' equations.

        `state` may include states of the turbulence, which the vehicle does not measure.
        """
        return state[self._measured]

    def seen(self, flown: Flown) -> Flown:
        """Return a simulated part of the flight with only the states that the vehicle measures.

        States of the turbulence are left out of the samples `flown`.
        """
        return replace(flown, states=flown.states[:, self._measured])

    def fly(self, leg: _Leg, state: FloatArray, integrator: Integrator) -> ClosedLoopFlight:
        """Simulate one part of the flight, in which the controller follows one plan.

        `state` is the initial state of the vehicle, shape (n_states,).
        """
        belief = leg.course.belief
        controller = AdaptiveController(with_mass(self._scenario, belief), self._mixer, leg.learnt)
        if belief.mass not in self._systems:
            self._systems[belief.mass] = closed_loop(self.dynamics, controller)
        return fly(
            dynamics=self.dynamics,
            controller=controller,
            reference=leg.course.path,
            initial_state=state,
            times=even_times(leg.start, leg.end, RATE_HZ),
            integrator=integrator,
            last=leg.last,
            system=self._systems[belief.mass],
        )


class _ReplannedFlight:
    """Simulation of a flight in which the rest of the mission is planned again at intervals.

    Each new plan is solved from the measured state of the vehicle.
    """

    def __init__(
        self,
        scenario: Scenario,
        settings: Replanning,
        knowledge: Knowledge,
        *,
        replanner: Replanner,
        dynamics: Dynamics,
        computer: Computer,
        plan: Plan | None,
    ) -> None:
        self._settings, self._computer, self._replanner = settings, computer, replanner
        # Re-plans in the forecast wind alone use no estimates of mass and acceleration.
        self._is_observing = knowledge is not Knowledge.UNTOLD
        self._end = scenario.mission.fixed_duration
        self._aircraft = _Aircraft(scenario, replanner, dynamics)
        is_planned = plan is not None and replanner.believes_forecast
        known = plan.trajectories if plan is not None and is_planned else replanner.first()
        self._first = self._course = replanner.first_course(known)
        replanner.prepare(known)
        state = start_state(scenario, dynamics)
        self._t, self._state = 0.0, state
        self._controlled: FloatArray | None = None
        speeds = [dynamics.state_names.index(name) for name in VELOCITY_STATES]
        self._observer = _Observer(scenario, replanner, state[speeds])
        self.legs: list[_Leg] = []
        self.parts: list[Flown] = []
        self.resolves: list[Resolve] = []

    def fly(self) -> None:
        """Simulate the whole mission, and solve for a new plan at constant intervals of time.

        Each new plan replaces the present plan, if its solve succeeds.
        """
        measured_at = self._settings.interval
        hovering_at = inf
        for rest in self._replanner.remainders:
            if hovering_at <= rest.begin:
                self._advance(hovering_at)
                # Re-plans end soon after the start of a hover. Until the hover ends, the vehicle
                # follows the plan made before take-off.
                self._course = self._first
            hovering_at = rest.end
            measured_at = max(measured_at, rest.begin)
            while measured_at + self._settings.solve_time < rest.planned_until:
                self._advance(measured_at)
                arrived_at = self._replan(measured_at)
                measured_at = max(measured_at + self._settings.interval, arrived_at)
        self._advance(self._end)

    def _replan(self, measured_at: float) -> float:
        """Solve for a new plan from a measured state, and simulate the flight during the solve.

        The result is the time [s] at which the solve ends and the new plan takes over.
        """
        meant_for = measured_at + self._settings.solve_time
        estimate, belief = np.zeros(3), self._replanner.belief
        if self._is_observing:
            estimate, belief = (
                self._observer.estimate,
                self._observer.belief(self._aircraft.seen(self.parts[-1])),
            )
        measured = self._aircraft.measured(self._state)
        missing = estimate - self._course.estimate
        state = self._replanner.begun(self._course, measured_at, meant_for, measured, missing)
        began = process_time()
        solution = self._solved(meant_for, state, belief)
        if solution is None and self._replanner.is_off(self._course, measured_at, measured):
            # The second solve may take many more iterations, although the new plan may then be
            # late.
            solution = self._solved(meant_for, state, belief, is_patient=True)
        solve_s = process_time() - began
        aboard = self._computer(solve_s)
        arrived_at = min(max(meant_for, measured_at + aboard), self._end)
        self._advance(arrived_at)
        # If the solve fails, the vehicle keeps following the present plan.
        if solution is not None:
            self._course = self._replanner.course(solution, belief, estimate)
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

    def _solved(
        self, t: float, state: FloatArray, belief: Belief, *, is_patient: bool = False
    ) -> Solution | None:
        """Solve the remaining mission from a state at time t [s]; None if the solve fails.

        The new plan assumes the mass and the acceleration by the air in `belief`. `is_patient`
        allows as many iterations as in solves before take-off.
        """
        try:
            solution = self._replanner.solve(t, state, belief, is_patient=is_patient)
        except TranscriptionError:
            return None  # the measured state is outside the hard limits of rotors and battery
        return solution if solution.is_converged else None

    def _advance(self, end: float) -> None:
        """Simulate the flight along the present plan until time `end` [s].

        The estimate of the unexplained acceleration, which the assumed equations do not contain, is
        then updated from the simulated states.
        """
        if end - self._t > _SHORTEST * self._end:
            along, aside, upwards = (self._observer.estimate - self._course.estimate).tolist()
            leg = _Leg(
                course=self._course,
                start=self._t,
                end=end,
                learnt=(along, aside, upwards),
                last=self._controlled,
            )
            flight = self._aircraft.fly(leg, self._state, Integrator.RUNGE_KUTTA)
            flown = flight.flown
            self._state, self._controlled = flown.states[-1], flight.controller_states[-1]
            self.legs.append(leg)
            self.parts.append(flown)
            self._observer.watch(self._aircraft.seen(flown))
        self._t = end

    def flown_twice(self) -> list[tuple[Flown, Flown]]:
        """Return each part of the flight with its simulation by a second integrator, as pairs.

        Both simulations of a part start from the same state. Their difference verifies the flight.
        """
        # A second simulation of the whole flight soon deviates from the first. Plans of its own
        # differ, because a plan depends on the measured state down to its rounding errors. The
        # recorded plans do not correct its deviations.
        again = self._aircraft.fly
        return [
            (part, again(leg, part.states[0], Integrator.MULTISTEP).flown)
            for leg, part in zip(self.legs, self.parts, strict=True)
        ]


# Relative length of a part of the flight below which it counts as rounding.
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
    """Simulate a mission with repeated re-planning in flight, and verify the flight.

    `dynamics` is the vehicle in the actual wind, and `knowledge` says which wind re-plans assume.
    If `plan` is None, or re-plans assume another wind than `plan`, a new plan is made before
    take-off. `computer` maps
    processor times of solves to times aboard [s]. Raises a SolveError if there is no plan before
    take-off, or the flight is out of control.
    """
    began = perf_counter()
    refuse_other_vehicles(scenario, dynamics)
    settings = scenario.baseline.mpc or Replanning()
    if computer is None:
        computer = partial(_charged, settings)
    margins = None if plan is None else plan.margins
    flight = _ReplannedFlight(
        scenario,
        settings,
        knowledge,
        replanner=Replanner(scenario, knowledge, planner, margins),
        dynamics=dynamics,
        computer=computer,
        plan=plan,
    )
    flight.fly()
    assembled = assembled_flight(
        replanned_name(knowledge), scenario, dynamics, flight.flown_twice(), plan, began
    )
    return replace(assembled, resolves=tuple(flight.resolves))
