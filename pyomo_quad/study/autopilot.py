"""Autopilot baseline on straight legs: its simulated flight, and tuning of its settings.

A leg is the straight line between two waypoints. An autopilot's settings are its limits on speed,
acceleration and jerk, which are equal on all legs. The module `flight.routes` computes the motion
along the legs.

A plan's energy saving is measured against an autopilot. For a fair comparison, the settings are
tuned for least energy by Nelder and Mead's method. In the search, a flight that breaks a limit of
the vehicle or misses the goal is penalised.

A flight ends near the goal, not exactly at the goal state. The costates of an argument `plan` give
an estimate of the energy between the two states. The tuning adds the estimate to the energy of the
flight. If `plan` is None, the estimate is left out. Arguments `planner` provide the vehicle's
equations for the simulation.
"""

from dataclasses import dataclass, replace
from functools import partial
from math import inf, log
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import minimize

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import Dynamics, EngineError
from pyomo_quad.flight import Flight, Plan, Planner
from pyomo_quad.flight.baselines import (
    RATE_HZ,
    Integrator,
    baseline_name,
    broken_under_control,
    fly_baseline,
    fly_reference,
)
from pyomo_quad.flight.flight import (
    ARRIVAL_DISTANCE_M,
    ARRIVAL_SPEED_M_PER_S,
    POSITION_STATES,
    VELOCITY_STATES,
    Flown,
)
from pyomo_quad.flight.long_flight import best_speed
from pyomo_quad.flight.routes import SETTLINGS_S, cruise_at, reached
from pyomo_quad.flight.steady import SteadyFlight
from pyomo_quad.flight.weather import vehicle_flown
from pyomo_quad.scenario import Reference, Scenario, ScenarioError
from pyomo_quad.scenario.tables import CruiseSettings
from pyomo_quad.study.comparison import has_arrived
from pyomo_quad.study.tables import TableColumn

if TYPE_CHECKING:
    import pandas as pd


TUNED_CRUISE = f"{baseline_name(Reference.CRUISE)} tuned"
"""Name of the flight of an autopilot whose settings are tuned for least energy."""

# Ranges of speed, acceleration and jerk: the ranges of PX4's parameters MPC_XY_CRUISE, MPC_ACC_HOR
# and MPC_JERK_AUTO, extended to slower flight for small vehicles.
_RANGES = ((0.3, 20.0), (0.3, 15.0), (0.1, 80.0))
# Speed, acceleration and jerk at which the search starts (the last two are PX4's defaults), and
# factors on each that give the other corners of its first simplex.
_FIRST = (6.0, 3.0, 4.0)
_FACTORS = (1.5, 1.5, 2.0)
# If legs are longer than this multiple of the distance over which the vehicle reaches the speed of
# steady flight, the search starts at that speed, and tries this factor on it first: a larger factor
# would only be rejected.
_LONG, _FACTOR_ON_STEADY = 20.0, 1.15
_FLIGHTS = 30
# Most samples of a flight of the search: limits change slowly in long flights.
_MOST_SAMPLES = 5000
# The search ends when the costs of its simplex differ by this share.
_COST_TOLERANCE = 2e-4
# Cost of settings whose flight fails: finite, because the search subtracts costs [J].
_FAILED_J = 1e12
# Penalty of a flight that breaks a limit or misses the goal, relative to its energy; and penalty
# per relative violation of the limit.
_PENALTY, _PENALTY_OF_BREACH = 0.5, 10.0
# Tolerance of the integrator in the search: energies accurate to 2e-4, at a third of the work.
_TOLERANCE = 1e-3
# Fraction of the distance and speed of arrival below which a flight is ended, so that rounding
# cannot undo its arrival.
_WITHIN = 0.999
# Largest number of settings, best first, that are flown to full accuracy until one is valid.
_CONFIRMED = 4


@dataclass(frozen=True, kw_only=True)
class TriedCruise:
    """Autopilot settings that a tuning tried, with the results of the simulated flight.

    The flight is simulated at reduced accuracy. `reached` holds the largest speed and acceleration
    of the reference trajectory, and the allowed jerk. If the vehicle does not arrive, `duration_s`
    is the whole simulated time.

    In three cases `energy_J` leaves out the energy from the end of the flight to the exact goal
    state: the vehicle does not arrive, the search had no plan, or the plan was made for a wind
    forecast.
    """

    settings: CruiseSettings
    """Limits on speed, acceleration and jerk given to the autopilot."""
    reached: CruiseSettings
    """Largest speed and acceleration of the flight: legs may be too short for the settings."""
    duration_s: float
    """Duration until arrival at the goal."""
    broken: tuple[str, ...]
    """Limits that the flight breaks, in words."""
    energy_J: float = inf
    """Energy until arrival, plus the energy to complete the flight from its end state to the exact
    goal state; infinite if the vehicle gets out of control."""
    arrived: bool = False
    """Whether the flight ends near the goal and slowly enough."""
    cost_J: float = inf
    """Objective of the search: the energy, plus the penalty of a broken limit or a missed goal."""


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """Result of tuning an autopilot for least energy.

    Attributes
    ----------
    flight : Flight
        Flight with the best settings, to full accuracy.
    settings : CruiseSettings
        The best settings. If the legs are too short to reach the limit on speed or acceleration,
        the largest value of the reference trajectory replaces the limit. The flight is the same.
    tried : tuple of TriedCruise
        All settings that the search tried, in the order tried.
    """

    flight: Flight
    settings: CruiseSettings
    tried: tuple[TriedCruise, ...]


def fly_cruise(
    scenario: Scenario, settings: CruiseSettings, plan: Plan | None, planner: Planner
) -> Flight:
    """Simulate a mission as an autopilot flies it, in the actual wind.

    At the end of the reference trajectory, the vehicle may be too far from the goal or too fast. It
    then waits at the goal for at most `SETTLINGS_S[-1]` seconds. With a plan, the flight begins in
    the plan's initial state. ScenarioError is raised if zones block the route or all places are
    equal, SolveError if the flight gets out of control.
    """
    longest, dynamics = _with_longest_wait(scenario, settings, planner)
    flown = fly_reference(longest, Reference.CRUISE, dynamics=dynamics).flown
    end = _end(scenario, settings, flown, dynamics)
    told = cruise_at(scenario.cruising(settings), least_s=end)
    # With a plan, its costates give an estimate of the energy from the end of the flight to the
    # exact goal state.
    return fly_baseline(told, Reference.CRUISE, dynamics=vehicle_flown(planner, told), plan=plan)


def _with_longest_wait(
    scenario: Scenario, settings: CruiseSettings, planner: Planner
) -> tuple[Scenario, Dynamics]:
    """Return mission and dynamics of an autopilot's flight with the longest wait at the goal.

    The mission has a fixed duration, which includes the wait of `SETTLINGS_S[-1]` seconds.
    """
    told = cruise_at(
        scenario.cruising(settings), settling_s=SETTLINGS_S[-1], least_s=_least(scenario)
    )
    return told, vehicle_flown(planner, told)


def _least(scenario: Scenario) -> float:
    return 0.0 if scenario.mission.is_free else scenario.mission.fixed_duration


def _end(scenario: Scenario, settings: CruiseSettings, flown: Flown, dynamics: Dynamics) -> float:
    """Return the earliest time at which a simulated flight of an autopilot can end [s].

    The vehicle has arrived at this time. If it never arrives, the result is the last time in
    `flown`.
    """
    moving = cruise_at(scenario.cruising(settings)).mission.fixed_duration
    places, velocities = (
        flown.states[:, [dynamics.state_names.index(name) for name in states]]
        for states in (POSITION_STATES, VELOCITY_STATES)
    )
    miss = np.linalg.norm(places - scenario.mission.goal.position, axis=1)
    speed = np.linalg.norm(velocities, axis=1)
    arrived = (miss <= _WITHIN * ARRIVAL_DISTANCE_M) & (speed <= _WITHIN * ARRIVAL_SPEED_M_PER_S)
    # Not before the end of the reference trajectory or of a fixed duration of the mission.
    first = max(moving, _least(scenario))
    nearest = int(np.argmin(np.abs(flown.t - first)))
    if arrived[nearest]:
        return first
    later = np.flatnonzero(arrived[nearest:])
    return float(flown.t[nearest + later[0] if later.size else -1])


def tune_cruise(scenario: Scenario, plan: Plan | None, planner: Planner) -> Tuning:
    """Tune an autopilot for least energy, and fly the result.

    The search simulates flights at reduced accuracy. At most four of its settings are flown again
    at full accuracy, those of least cost first. The first of these flights that arrives and keeps
    all limits is the result.

    With a `plan`, energies include the estimated energy from the end of a flight to the exact goal
    state, if it is known. If no flight arrives within the limits, ScenarioError is raised. Other
    errors are those of `fly_cruise`.
    """
    tried = _search(scenario, plan, planner)
    # The search simulates at reduced accuracy. Its best settings are flown at full accuracy, and
    # the first flight that arrives within the limits is taken.
    for one in sorted(tried, key=lambda one: one.cost_J)[:_CONFIRMED]:
        flight = fly_cruise(scenario, one.settings, plan, planner)
        # Under a forecast, the plan's costates are those of another wind, so that the energy to the
        # exact goal state is unknown. The flight counts nevertheless.
        if not flight.broken_limits and has_arrived(flight):
            named = replace(flight, name=TUNED_CRUISE)
            return Tuning(flight=named, settings=one.reached, tried=tried)
    broken = [limit for one in tried for limit in one.broken]
    raise ScenarioError(
        f"{scenario.name}: none of {len(tried)} settings of the autopilot arrives within the "
        f"limits ({broken[0] if broken else 'the goal is missed'}); leave cruise out of "
        "baseline.references, or allow more thrust or tilt."
    )


def _search(scenario: Scenario, plan: Plan | None, planner: Planner) -> tuple[TriedCruise, ...]:
    """Return all settings, in order, that Nelder and Mead's search for least energy tried.

    With a `plan`, the energy of a flight includes the estimated energy from its end to the exact
    goal state.
    """
    fly = partial(_tried, scenario, plan=plan, planner=planner)
    tried: dict[tuple[float, ...], TriedCruise] = {}
    bounds = np.log(_RANGES)
    bounds[0, 1] = min(bounds[0, 1], log(scenario.limits.speed_max or inf))

    def cost(x: FloatArray) -> float:
        speed, acceleration, jerk = settings = tuple(np.exp(x).tolist())
        if settings not in tried:
            told = CruiseSettings(speed=speed, acceleration=acceleration, jerk=jerk)
            tried[settings] = fly(told)
        return min(tried[settings].cost_J, _FAILED_J)

    settings, factors = _start_of_search(scenario, planner)
    first = np.clip(np.log(settings), *bounds.T)
    simplex = np.vstack([first, first + np.diag(np.log(factors))])
    scale = cost(first)
    minimize(
        cost,
        first,
        method="Nelder-Mead",
        bounds=bounds,
        options={
            "initial_simplex": np.clip(simplex, *bounds.T),
            "maxfev": _FLIGHTS,
            "xatol": inf,
            "fatol": _COST_TOLERANCE * scale,
        },
    )
    return tuple(tried.values())


def _start_of_search(
    scenario: Scenario, planner: Planner
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the first vertex of the search's simplex, and the factors that give the others.

    Both are triples for speed [m/s], acceleration [m/s^2] and jerk [m/s^3]. Each other vertex
    multiplies one setting by its factor.
    """
    places = np.array(scenario.mission.positions)
    lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
    _, acceleration, jerk = _FIRST
    if min(lengths) < _LONG * _FIRST[0] ** 2 / acceleration:
        return _FIRST, _FACTORS
    # On long legs nearly all of the flight is steady, at the speed of least energy per metre.
    steady = SteadyFlight(scenario, planner.dynamics(scenario))
    course = (places[-1] - places[-2]) / lengths[-1]
    speed = min(best_speed(steady, course, 0.0), scenario.limits.speed_max or inf)
    if min(lengths) < _LONG * speed**2 / acceleration:
        return _FIRST, _FACTORS
    return (speed, acceleration, jerk), (_FACTOR_ON_STEADY, *_FACTORS[1:])


def _tried(
    scenario: Scenario, settings: CruiseSettings, *, plan: Plan | None, planner: Planner
) -> TriedCruise:
    longest, dynamics = _with_longest_wait(scenario, settings, planner)
    within = reached(scenario.cruising(settings))
    try:
        flown = fly_reference(
            longest,
            Reference.CRUISE,
            dynamics=dynamics,
            integrator=Integrator.MULTISTEP,
            rate_hz=min(RATE_HZ, _MOST_SAMPLES / longest.mission.fixed_duration),
            tolerance=_TOLERANCE,
        ).flown
    except EngineError:
        return TriedCruise(
            settings=settings,
            reached=within,
            duration_s=longest.mission.fixed_duration,
            broken=("out of control",),
        )
    end = _end(scenario, settings, flown, dynamics)
    arrived = end < flown.t[-1]
    kept = flown.t <= end
    part = Flown(
        t=flown.t[kept],
        states=flown.states[kept],
        controls=flown.controls[kept],
        energy=flown.energy[kept],
    )
    breaches = dynamics.violations(part.t, part.states, part.controls)
    broken = broken_under_control(longest, dynamics, part, breaches)
    energy = float(np.interp(end, flown.t, flown.energy))
    if plan is not None and arrived and scenario.wind.forecast is None:
        final = dict(zip(dynamics.state_names, part.states[-1].tolist(), strict=True))
        energy += plan.owed_energy(final)
    penalty = 0.0 if arrived and not broken else _PENALTY
    penalty += _PENALTY_OF_BREACH * max(broken.values(), default=0.0)
    return TriedCruise(
        settings=settings,
        reached=within,
        duration_s=end,
        energy_J=energy,
        arrived=arrived,
        broken=tuple(broken),
        cost_J=energy * (1.0 + penalty),
    )


class TuningColumn(TableColumn):
    """Columns of the table of settings that the tuning of an autopilot tried.

    Each row is one choice of speed, acceleration and jerk, with the results of its simulated
    flight. Speed and acceleration have two columns: as set, and as reached.
    """

    SPEED = "speed_asked_m_per_s", lambda one: one.settings.speed
    SPEED_REACHED = "speed_reached_m_per_s", lambda one: one.reached.speed
    ACCELERATION = "acceleration_asked_m_per_s2", lambda one: one.settings.acceleration
    ACCELERATION_REACHED = "acceleration_reached_m_per_s2", lambda one: one.reached.acceleration
    JERK = "jerk_m_per_s3", lambda one: one.settings.jerk
    DURATION = "duration_s", lambda one: one.duration_s
    ENERGY = "energy_J", lambda one: one.energy_J
    ARRIVED = "arrived", lambda one: one.arrived
    BROKEN_LIMITS = "broken_limits", lambda one: "; ".join(one.broken) or "none"


def tuning_table(tuning: Tuning | None) -> "pd.DataFrame":
    """Return a table of the settings that the tuning of an autopilot tried, in the order tried.

    The table is empty if `tuning` is None. Its energies have the reduced accuracy of the search.
    """
    return TuningColumn.of_objects(() if tuning is None else tuning.tried)
