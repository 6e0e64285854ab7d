"""Comparison of the flights of a mission in one table, and the effect of adaptation.

Adaptation means that the controller estimates the disturbance acceleration, and compensates it. The
disturbance acceleration is the force of the air on the vehicle divided by the mass.
"""

from collections.abc import Iterator, Mapping, Sequence
from math import isclose, isfinite, nan
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import Dynamics
from pyomo_quad.flight.baselines import (
    ClosedLoopFlight,
    baseline_name,
    fly_reference,
    reference_path,
)
from pyomo_quad.flight.columns import ALL_COLUMNS, ENERGY, ROTORS, TIME, column_of
from pyomo_quad.flight.controller import CONTROLLER_STATES
from pyomo_quad.flight.flight import (
    AIR_FORCE,
    ARRIVAL_DISTANCE_M,
    ARRIVAL_SPEED_M_PER_S,
    POSITION_STATES,
    VELOCITY_STATES,
    Flight,
)
from pyomo_quad.flight.references import ReferencePath
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.tables import Reference, Replanning
from pyomo_quad.study.certificate import SAME_TIME, Certificate
from pyomo_quad.study.tables import TableColumn

if TYPE_CHECKING:
    import pandas as pd


# Columns of `adaptation_study`. Distance of the vehicle from the path point of the same time [m].
ERROR_WITH = "position_error_with_adaptation_m"
ERROR_WITHOUT = "position_error_without_adaptation_m"
# The controller's estimate of the disturbance acceleration, and the true one, both in the flight
# with adaptation [m/s^2].
ESTIMATED = tuple(f"estimated_disturbance_{axis}_m_per_s2" for axis in "xyz")
TRUE = tuple(f"true_disturbance_{axis}_m_per_s2" for axis in "xyz")

_ESTIMATES = tuple(f"disturbance_{axis}_m_per_s2" for axis in "xyz")


def adaptation_study(scenario: Scenario, *, dynamics: Dynamics) -> "pd.DataFrame":
    """Simulate a mission with and without the controller's adaptation; return a table over time.

    Both flights follow the same quintic path in the actual wind. Duration and passing times must be
    fixed. The columns are `ERROR_WITH`, `ERROR_WITHOUT`, `ESTIMATED` and `TRUE`.
    """
    import pandas as pd  # noqa: PLC0415  0.3 s that a solve has no use for

    told = (scenario.with_values({"baseline.adaptation": adapts}) for adapts in (True, False))
    flights = [fly_reference(one, Reference.QUINTIC, dynamics=dynamics) for one in told]
    path = reference_path(scenario, Reference.QUINTIC)
    flown = flights[0].flown
    keys = tuple((force, None) for force in AIR_FORCE)
    forces = dynamics.table(keys, flown.t, flown.states, flown.controls)
    columns = [CONTROLLER_STATES.index(name) for name in _ESTIMATES]
    errors = (_error(path, dynamics, flight) for flight in flights)
    table = {TIME: flown.t} | dict(zip((ERROR_WITH, ERROR_WITHOUT), errors, strict=True))
    table |= dict(zip(ESTIMATED, flights[0].controller_states[:, columns].T, strict=True))
    table |= dict(zip(TRUE, forces.T / scenario.vehicle.total_mass, strict=True))
    return pd.DataFrame(table)


def _error(path: ReferencePath, dynamics: Dynamics, flight: ClosedLoopFlight) -> FloatArray:
    wanted = np.array([path(t).place[:3] for t in flight.flown.t])
    columns = [dynamics.state_names.index(name) for name in POSITION_STATES]
    return np.linalg.norm(flight.flown.states[:, columns] - wanted, axis=1)


OPTIMAL = "optimal"
FAIR_BASELINE = baseline_name(Reference.QUINTIC)
"""Name of the baseline for savings: a smooth path for the same mission, made without a plan."""
INSIDE_DISTANCE_M = 0.1
"""Distance from the goal within which the column `time_inside_0p1_m_s` counts time [m]."""

_PLACE = tuple(column_of(state).name for state in POSITION_STATES)


class ComparisonColumn(TableColumn):
    """Columns of the table that compares the flights of a mission, one row for each flight.

    A simulated flight ends near the goal. Its owed energy is the estimated energy from there to the
    exact goal state. The lower bound is that on the energy of every flight of the mission, from
    `study.certificate`. With E = energy + owed energy of a flight, and E_plan that of the plan:

    - excess = E - energy of hovering for the duration of the flight;
    - gap = 100 (E - lower bound) / E;
    - saving = 100 (E - E_plan) / E;
    - saving of excess = 100 (E - E_plan) / excess.
    """

    SCENARIO = "scenario"
    FLIGHT = "flight"
    DURATION = "duration_s"
    ENERGY = "energy_J"
    OWED_ENERGY = "owed_energy_J"
    HOVER_ENERGY = "hover_energy_J"
    EXCESS_ENERGY = "excess_energy_J"
    LOWER_BOUND = "lower_bound_J"
    OPTIMALITY_GAP = "optimality_gap_percent"
    SAVING = "saving_percent"
    SAVING_OF_EXCESS = "saving_of_excess_percent"
    TERMINAL_MISS = "terminal_miss_m"
    ARRIVED = "arrived"
    LIMITS_KEPT = "limits_kept"
    BROKEN_LIMITS = "broken_limits"
    VERIFIED = "verified"
    PEAK_POWER = "peak_power_W"
    PEAK_TILT = "peak_tilt_rad"
    PEAK_ROTOR_ACCELERATION = "peak_rotor_acceleration_rad_per_s2"
    TIME_INSIDE = "time_inside_0p1_m_s"
    BATTERY_USED = "battery_used_percent"


RESERVE = "reserve_percent"
"""Column for the unused share of the limits of rotor speed and thrust: the smaller of the two, at
its least over the flight; only if the scenario sets `limits.reserve`."""


def has_arrived(flight: Flight) -> bool:
    """Return whether a flight ends at the goal and nearly at rest.

    The limits of final distance and speed are `ARRIVAL_DISTANCE_M` and `ARRIVAL_SPEED_M_PER_S`.
    """
    speed = np.linalg.norm([flight.terminal_miss.get(name, 0.0) for name in VELOCITY_STATES])
    return bool(flight.terminal_miss_m <= ARRIVAL_DISTANCE_M and speed <= ARRIVAL_SPEED_M_PER_S)


def compare_flights(
    scenario: Scenario,
    flights: Sequence[Flight],
    certificate: Certificate,
    hover_energy_J: float,
) -> "pd.DataFrame":
    """Compare the flights of one mission in a table of the columns `ComparisonColumn`.

    In `flights`, the flight of the run's plan has the name "optimal". `scenario` is the attribute
    `mission_flown` of this plan. `hover_energy_J` is the energy of hovering for the
    duration of `scenario`. `certificate` holds the lower bound on the mission's energy, for the
    columns of bound and gap. Undefined values are NaN. If the scenario sets `limits.reserve`, the
    column `RESERVE` is added.
    """
    # With a forecast, the plan was made for the forecast wind, but bound and other flights are of
    # the actual wind.
    is_told_the_wind = scenario.wind.forecast is None
    optimum = next((f for f in flights if f.name == OPTIMAL and is_comparable(f)), None)
    rows = []
    for flight in flights:
        is_optimum, arrived = flight.name == OPTIMAL, has_arrived(flight)
        settled, is_valid = settled_energy(flight), is_comparable(flight)
        # The bound covers only flights that arrive within the limits, and some durations only.
        is_bounded = is_valid and (is_told_the_wind or not is_optimum)
        is_bounded = is_bounded and certificate.is_of(flight.duration_s)
        is_rival = is_valid and is_told_the_wind and not is_optimum
        hover = _hover_energy(scenario, flight, hover_energy_J)
        excess = settled - hover
        # Savings need a comparable plan and a comparable other flight, both for the actual wind.
        saved = saved_of_excess = nan
        if optimum is not None and is_rival:
            saved = settled - settled_energy(optimum)
            is_timed_alike = isclose(flight.duration_s, optimum.duration_s, rel_tol=SAME_TIME)
            # The energy of hovering depends on the duration. A plan below hovering would save over
            # 100 %.
            if is_timed_alike and settled_energy(optimum) >= hover:
                saved_of_excess = saved
        rows.append(
            {
                ComparisonColumn.SCENARIO: scenario.name,
                ComparisonColumn.FLIGHT: flight.name,
                ComparisonColumn.DURATION: flight.duration_s,
                ComparisonColumn.ENERGY: flight.energy_J,
                ComparisonColumn.OWED_ENERGY: flight.owed_energy_J if arrived else nan,
                ComparisonColumn.HOVER_ENERGY: hover,
                ComparisonColumn.EXCESS_ENERGY: excess,
                ComparisonColumn.LOWER_BOUND: _number(certificate.lower_bound_J, is_bounded),
                ComparisonColumn.OPTIMALITY_GAP: _number(
                    certificate.gap_percent(settled), is_bounded
                ),
                ComparisonColumn.SAVING: _percent(saved, settled),
                ComparisonColumn.SAVING_OF_EXCESS: _percent(saved_of_excess, excess),
                ComparisonColumn.TERMINAL_MISS: flight.terminal_miss_m,
                ComparisonColumn.ARRIVED: arrived,
                ComparisonColumn.LIMITS_KEPT: not flight.broken_limits,
                ComparisonColumn.BROKEN_LIMITS: "; ".join(flight.broken_limits) or "none",
                ComparisonColumn.VERIFIED: flight.is_verified,
                **_measured(scenario, flight.frame),
            }
        )
    compared = ComparisonColumn.of_rows(rows)
    if scenario.limits.reserve:
        compared[RESERVE] = [_reserve_percent(scenario, flight.frame) for flight in flights]
    return compared


def against_hovering(excess_J: float, digits: int = 2) -> str:
    """Return in words how much more or less energy than hovering a flight takes.

    An example is "3.20 J less than hovering". `excess_J` is the difference [J], and `digits` the
    number of decimals.
    """
    return f"{abs(excess_J):.{digits}f} J {'less' if excess_J < 0.0 else 'more'} than hovering"


def has_own_time(scenario: Scenario, duration_s: float) -> bool:
    """Return whether the duration of a flight [s] differs from the duration of the mission."""
    return not isclose(duration_s, scenario.mission.fixed_duration, rel_tol=SAME_TIME)


def _hover_energy(scenario: Scenario, flight: Flight, hover_energy_J: float) -> float:
    if not has_own_time(scenario, flight.duration_s):
        return hover_energy_J
    # Compare with hovering for the duration of the flight.
    return hover_energy_J * flight.duration_s / scenario.mission.fixed_duration


class LegColumn(TableColumn):
    """Columns of the table of a flight's legs, the parts from one waypoint to the next.

    Each row is a leg, or a hover at a waypoint, with the times of its start and end, its length and
    its energy.
    """

    LEG = "leg"
    BEGUN = "begun_s"
    ENDED = "ended_s"
    LENGTH = "length_m"
    ENERGY = "energy_J"


def leg_table(mission: Scenario, frame: "pd.DataFrame") -> "pd.DataFrame":
    """Return times, length and energy of each leg of a flight, and of each hover, as a table.

    `mission` is a scenario whose waypoints have the passing times of this flight, such as
    `Plan.mission_flown`. `frame` is the flight's table over time.
    """
    return LegColumn.of_rows(leg_rows(mission, frame))


def leg_rows(
    mission: Scenario, flown: "Mapping[str, FloatArray] | pd.DataFrame"
) -> list[dict[str, str | float]]:
    """Return times, length and energy of each leg of a flight, and of each hover at a waypoint.

    `mission` is a scenario whose waypoints have the passing times of this flight. `flown` has the
    columns of time, position and energy. Without waypoints, position or energy, the list is empty.
    """
    if not mission.mission.waypoints or not {ENERGY, *_PLACE}.issubset(flown):
        return []
    time, way = np.asarray(flown[TIME], dtype=float), way_flown(flown)
    rows: list[dict[str, str | float]] = []
    for name, begun, ended in _legs(mission, float(time[-1])):
        lengths, energies = (
            np.interp((begun, ended), time, held)
            for held in (way, np.asarray(flown[ENERGY], dtype=float))
        )
        row: dict[str, str | float] = {
            LegColumn.LEG.value: name,
            LegColumn.BEGUN.value: begun,
            LegColumn.ENDED.value: ended,
            LegColumn.LENGTH.value: float(np.ptp(lengths)),
            LegColumn.ENERGY.value: float(energies[1] - energies[0]),
        }
        rows.append(row)
    return rows


def _legs(mission: Scenario, duration_s: float) -> Iterator[tuple[str, float, float]]:
    """Yield name, begin [s] and end [s] of each part of a mission of duration `duration_s`.

    The parts are the legs from waypoint to waypoint and the hovers at waypoints.
    """
    left, place = 0.0, "start"
    for number, waypoint in enumerate(mission.mission.waypoints, start=1):
        reached = duration_s if waypoint.at is None else waypoint.at
        yield f"{place} to {number}", left, reached
        left, place = reached + waypoint.hold, str(number)
        if waypoint.hold:
            yield f"held at {number}", reached, left
    yield f"{place} to goal", left, duration_s


def way_flown(flown: "Mapping[str, FloatArray] | pd.DataFrame") -> FloatArray:
    """Return the length of the path from the start to each row of a flight's table [m].

    Coordinates x, y and z that a user's Pyomo model lacks are left out of the length.
    """
    held = [np.asarray(flown[name], dtype=float) for name in _PLACE if name in flown]
    places = np.reshape(held, (-1, len(flown[TIME]))).T
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


class ReplanningColumn(TableColumn):
    """Columns of the table of flights whose plan is solved again during the flight.

    `LATE` counts the solves that took longer than the time allowed, `BEYOND_INTERVAL` those that
    took longer than the interval to the next solve.
    """

    FLIGHT = "flight"
    SETTLED_ENERGY = "settled_energy_J"
    TERMINAL_MISS = "terminal_miss_m"
    ARRIVED = "arrived"
    SOLVES = "solves"
    FAILED = "failed"
    LATE = "late"
    BEYOND_INTERVAL = "beyond_interval"
    MEDIAN_SOLVE = "solve_median_s"
    SLOW_SOLVE = "solve_95_percent_s"
    LONGEST_SOLVE = "solve_longest_s"


def replanning_table(flights: Sequence[Flight], settings: Replanning) -> "pd.DataFrame":
    """Return results and solve times of all flights whose plan is solved again during the flight.

    The table has measured solve times. If ``settings.clock`` is "stated", they do not affect the
    simulated flight, which assumes that each solve takes ``settings.solve_time``.
    """
    rows = []
    for flight in flights:
        if not flight.resolves:
            continue
        took = np.array([resolve.solve_s for resolve in flight.resolves])
        times = np.percentile(took, (50, 95, 100))
        rows.append(
            {
                ReplanningColumn.FLIGHT: flight.name,
                ReplanningColumn.SETTLED_ENERGY: settled_energy(flight),
                ReplanningColumn.TERMINAL_MISS: flight.terminal_miss_m,
                ReplanningColumn.ARRIVED: has_arrived(flight),
                ReplanningColumn.SOLVES: len(flight.resolves),
                ReplanningColumn.FAILED: sum(not r.is_converged for r in flight.resolves),
                ReplanningColumn.LATE: int((took > settings.solve_time).sum()),
                ReplanningColumn.BEYOND_INTERVAL: int((took > settings.interval).sum()),
                ReplanningColumn.MEDIAN_SOLVE: float(times[0]),
                ReplanningColumn.SLOW_SOLVE: float(times[1]),
                ReplanningColumn.LONGEST_SOLVE: float(times[2]),
            }
        )
    return ReplanningColumn.of_rows(rows)


def is_comparable(flight: Flight) -> bool:
    """Return whether the energy of a flight can be compared with those of other flights.

    The flight must arrive and keep all limits. Its owed energy, from its end to the exact goal
    state, must be known.
    """
    is_priced = isfinite(flight.owed_energy_J)
    return has_arrived(flight) and not flight.broken_limits and is_priced


def settled_energy(flight: Flight) -> float:
    """Return the energy of a flight, plus its owed energy to the exact goal state [J].

    The owed energy is the estimated energy from the flight's final state to the goal state. It is
    left out if it is unknown (NaN). It is also left out if the flight ends too far from the goal or
    too fast (`has_arrived`).
    """
    is_priced = has_arrived(flight) and isfinite(flight.owed_energy_J)
    return flight.energy_J + (flight.owed_energy_J if is_priced else 0.0)


def combine(frames: "Sequence[pd.DataFrame]") -> "pd.DataFrame":
    """Return the comparison tables of many scenarios as one table, one below the other.

    Each table has the columns of `ComparisonColumn`. The rows are numbered anew.
    """
    import pandas as pd  # noqa: PLC0415  0.3 s that a solve has no use for

    if not frames:
        return ComparisonColumn.of_rows(())
    return pd.concat(frames, ignore_index=True)


def _number(value: float | None, is_meaningful: bool) -> float:
    return value if value is not None and is_meaningful else nan


def _percent(part: float, whole: float) -> float:
    """Return ``part`` in per cent of ``whole``; NaN if the whole is not positive."""
    return 100.0 * part / whole if whole > 0.0 else nan


def _measured(scenario: Scenario, frame: "pd.DataFrame") -> dict[ComparisonColumn, float]:
    """Return the values of a comparison row that are computed from a flight's table over time."""
    alpha = _rotor_values(frame, "rotors.alpha")
    tilt = np.cos(_values(frame, "rigid_body.phi")) * np.cos(_values(frame, "rigid_body.theta"))
    charge = _values(frame, "battery.state_of_charge")
    return {
        ComparisonColumn.PEAK_POWER: float(_values(frame, "power.total").max()),
        ComparisonColumn.PEAK_TILT: float(np.arccos(np.clip(tilt.min(), -1.0, 1.0))),
        ComparisonColumn.PEAK_ROTOR_ACCELERATION: float(np.abs(alpha).max()),
        ComparisonColumn.TIME_INSIDE: _time_inside(scenario, frame),
        ComparisonColumn.BATTERY_USED: float(charge[0] - charge[-1]),
    }


def _reserve_percent(scenario: Scenario, frame: "pd.DataFrame") -> float:
    limits = scenario.limits
    speeds = _rotor_values(frame, "rotors.omega")
    thrust = _values(frame, "rotors.total_thrust")
    used = max(speeds.max() / limits.rotor_speed_max, thrust.max() / limits.thrust_max)
    return float(100.0 * (1.0 - used))


def _time_inside(scenario: Scenario, frame: "pd.DataFrame") -> float:
    """Return the time that a flight spends within `INSIDE_DISTANCE_M` of the goal [s].

    The result is NaN if `frame` lacks a coordinate.
    """
    position = np.column_stack([_values(frame, name) for name in POSITION_STATES])
    distance = np.linalg.norm(position - scenario.mission.goal.position, axis=1)
    if np.isnan(distance).any():
        return nan
    is_near = (distance <= INSIDE_DISTANCE_M).astype(float)
    # An interval counts fully if both its ends are near the goal, and half if one end is.
    return float(np.trapezoid(is_near, frame[TIME].to_numpy(dtype=float)))


def _rotor_values(frame: "pd.DataFrame", component: str) -> FloatArray:
    """Return the values of a rotor variable, such as "rotors.omega", from the table of a flight.

    The columns are the rotors, at least four. Rotors that a user's model lacks are NaN.
    """
    shown = [one for one in ALL_COLUMNS if one.component == component]
    return np.column_stack(
        [_values(frame, one.variable) for one in shown if one.index in ROTORS or one.name in frame]
    )


def _values(frame: "pd.DataFrame", variable: str) -> FloatArray:
    """Return the values of a model variable in a flight's table, one for each row.

    All values are NaN if the table `frame` has no column for the variable.
    """
    name = column_of(variable).name
    if name not in frame:
        return np.full(len(frame), nan)
    return frame[name].to_numpy(dtype=float)
