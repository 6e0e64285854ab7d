"""Autopilot on straight legs: its flight at given settings, and settings tuned for least energy.

An autopilot flies straight legs at one speed, with one limit on acceleration and one on jerk
(`routes`).  A saving over it says little unless these three settings are good ones.  So Nelder and
Mead's method searches for the settings of least energy, over flights under the controller; a flight
that breaks a limit of the vehicle or misses the goal costs more.  One triple serves the whole
mission.
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
from pyomo_quad.flight.routes import SETTLINGS_S, cruise_at, reached
from pyomo_quad.flight.weather import vehicle_flown
from pyomo_quad.scenario import Reference, Scenario, ScenarioError
from pyomo_quad.scenario.tables import CruiseSettings
from pyomo_quad.study.comparison import has_arrived, is_comparable
from pyomo_quad.study.tables import TableColumn

if TYPE_CHECKING:
    import pandas as pd


TUNED_CRUISE = f"{baseline_name(Reference.CRUISE)} tuned"
"""Name of the flight of an autopilot whose settings are tuned for least energy."""

# Ranges of speed, acceleration and jerk: those of MPC_XY_CRUISE, MPC_ACC_HOR and MPC_JERK_AUTO of
# PX4, extended to slower flight for small vehicles.
_RANGES = ((0.3, 20.0), (0.3, 15.0), (0.1, 80.0))
# The search starts at the largest of these speeds that is allowed, with PX4's default acceleration
# and jerk, and at factors on each of them.
_FIRST = (6.0, 3.0, 4.0)
_FACTORS = (1.5, 1.5, 2.0)
_FLIGHTS = 30
# The search ends when the costs of its simplex differ by this share.
_COST_TOLERANCE = 2e-4
# Cost of settings that cannot be flown: finite, because the search subtracts costs [J].
_FAILED_J = 1e12
# What a broken limit or a missed goal adds to the energy: a share of it, and that times the breach.
_PENALTY, _PENALTY_OF_BREACH = 0.5, 10.0
# Tolerance of the integrator in the search: energies to 2e-4, and a third of the work.
_TOLERANCE = 1e-3
# Share of the distance and speed of arrival within which a flight ends, so that rounding cannot
# undo its arrival.
_WITHIN = 0.999
# Best settings of the search that are flown until one keeps the limits to full accuracy.
_CONFIRMED = 4


@dataclass(frozen=True, kw_only=True)
class TriedCruise:
    """Settings that the tuning tried, with their flight at reduced accuracy."""

    settings: CruiseSettings
    """Settings asked for."""
    reached: CruiseSettings
    """Largest speed and acceleration of the flight: legs may be too short for the settings."""
    duration_s: float
    broken: tuple[str, ...]
    """Limits that the flight breaks, in words."""
    energy_J: float = inf
    """With the energy that the end state owes; infinite if the flight is out of control."""
    arrived: bool = False
    cost_J: float = inf
    """The energy, plus the penalty of a broken limit or a missed goal."""


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """Result of the tuning: best flight, settings that it reaches, and all settings tried."""

    flight: Flight
    settings: CruiseSettings
    tried: tuple[TriedCruise, ...]


def fly_cruise(
    scenario: Scenario, settings: CruiseSettings, plan: Plan | None, planner: Planner
) -> Flight:
    """Simulate the mission as an autopilot flies it with given settings.

    The flight waits at the goal until it has arrived, at most the last of `SETTLINGS_S`, and to the
    end of a mission of fixed duration.
    """
    longest, dynamics = _longest(scenario, settings, planner)
    flown = fly_reference(longest, Reference.CRUISE, dynamics=dynamics).flown
    end = _end(scenario, settings, flown, dynamics)
    told = cruise_at(scenario.cruising(settings), least_s=end)
    return fly_baseline(told, Reference.CRUISE, dynamics=vehicle_flown(planner, told), plan=plan)


def _longest(
    scenario: Scenario, settings: CruiseSettings, planner: Planner
) -> tuple[Scenario, Dynamics]:
    """Return the scenario of a cruise with the longest wait at the goal, and its vehicle."""
    told = cruise_at(
        scenario.cruising(settings), settling_s=SETTLINGS_S[-1], least_s=_least(scenario)
    )
    return told, vehicle_flown(planner, told)


def _least(scenario: Scenario) -> float:
    return 0.0 if scenario.mission.is_free else scenario.mission.fixed_duration


def _end(scenario: Scenario, settings: CruiseSettings, flown: Flown, dynamics: Dynamics) -> float:
    """Return the time at which a flight has arrived, not before the mission's own time [s].

    Without an arrival that is the end of the flight.
    """
    moving = cruise_at(scenario.cruising(settings)).mission.fixed_duration
    places, velocities = (
        flown.states[:, [dynamics.state_names.index(name) for name in states]]
        for states in (POSITION_STATES, VELOCITY_STATES)
    )
    miss = np.linalg.norm(places - scenario.mission.goal.position, axis=1)
    speed = np.linalg.norm(velocities, axis=1)
    arrived = (miss <= _WITHIN * ARRIVAL_DISTANCE_M) & (speed <= _WITHIN * ARRIVAL_SPEED_M_PER_S)
    first = max(moving, _least(scenario))
    nearest = int(np.argmin(np.abs(flown.t - first)))
    if arrived[nearest]:
        return first
    later = np.flatnonzero(arrived[nearest:])
    return float(flown.t[nearest + later[0] if later.size else -1])


def tune_cruise(scenario: Scenario, plan: Plan | None, planner: Planner) -> Tuning:
    """Tune speed, acceleration and jerk of an autopilot for least energy, and fly the result.

    Raises
    ------
    ScenarioError
        If zones block a leg, or no settings that were tried arrive within the limits.
    """
    tried = _search(scenario, plan, planner)
    for one in sorted(tried, key=lambda one: one.cost_J)[:_CONFIRMED]:
        flight = fly_cruise(scenario, one.settings, plan, planner)
        is_good = is_comparable(flight) if plan is not None else not flight.broken_limits
        if is_good and has_arrived(flight):
            named = replace(flight, name=TUNED_CRUISE)
            return Tuning(flight=named, settings=one.reached, tried=tried)
    broken = [limit for one in tried for limit in one.broken]
    raise ScenarioError(
        f"{scenario.name}: none of {len(tried)} settings of the autopilot arrives within the "
        f"limits ({broken[0] if broken else 'the goal is missed'}); leave cruise out of "
        "baseline.references, or allow more thrust or tilt."
    )


def _search(scenario: Scenario, plan: Plan | None, planner: Planner) -> tuple[TriedCruise, ...]:
    """Return the settings tried by Nelder and Mead's method."""
    fly = partial(_tried, scenario, plan=plan, planner=planner)
    tried: list[TriedCruise] = []
    bounds = np.log(_RANGES)
    bounds[0, 1] = min(bounds[0, 1], log(scenario.limits.speed_max or inf))

    def cost(x: FloatArray) -> float:
        speed, acceleration, jerk = np.exp(x).tolist()
        tried.append(fly(CruiseSettings(speed=speed, acceleration=acceleration, jerk=jerk)))
        return min(tried[-1].cost_J, _FAILED_J)

    first = np.clip(np.log(_FIRST), *bounds.T)
    simplex = np.vstack([first, first + np.diag(np.log(_FACTORS))])
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
    return tuple(tried[1:])


def _tried(
    scenario: Scenario, settings: CruiseSettings, *, plan: Plan | None, planner: Planner
) -> TriedCruise:
    longest, dynamics = _longest(scenario, settings, planner)
    within = reached(scenario.cruising(settings))
    try:
        flown = fly_reference(
            longest,
            Reference.CRUISE,
            dynamics=dynamics,
            integrator=Integrator.MULTISTEP,
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
    """Columns of the table of tried settings, in order."""

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
    """Return the tried settings as a table in order, empty without a tuning.

    Their energies are those of the search; `Tuning.flight` has the energy to full accuracy.
    """
    return TuningColumn.of_objects(() if tuning is None else tuning.tried)
