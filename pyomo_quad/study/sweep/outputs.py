"""The columns of a case: what is read off its flights.

This is the one home of their names: task, tables and figures take them from here.
"""

import math

import numpy as np

from pyomo_quad.flight import Flight, Plan
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.baseline import Reference
from pyomo_quad.study.comparison import is_comparable, settled_energy

__all__ = [
    "DURATION_FIELD",
    "ENERGY",
    "EXCESS_ENERGY",
    "HOVER_ENERGY",
    "MEAN_POWER",
    "TERMINAL_MISS",
    "baseline_outputs",
    "flown_outputs",
    "plan_outputs",
]

ENERGY = "energy_J"
HOVER_ENERGY = "hover_energy_J"
EXCESS_ENERGY = "excess_energy_J"
MEAN_POWER = "mean_power_W"
# Of the case's own flight; those of the controller's end in it.
TERMINAL_MISS = "terminal_miss_m"
# The scenario's field that the figures over time look for.
DURATION_FIELD = "mission.duration"

_EMPTY = 0.0
_SAMPLES = 501
# A solve is good to six digits, and rounding differs between machines: what is stored has the
# digits that mean something, and is the same wherever it was solved.
_DIGITS = 9
_SMALLEST_RESIDUAL = 1e-7
_RESIDUALS = ("max_violation", TERMINAL_MISS)
_ERROR_ESTIMATE = "error_estimate"
_ERROR_DIGITS = 2


def plan_outputs(plan: Plan) -> dict[str, float]:
    """Return the numbers of a case's plan.

    Parameters
    ----------
    plan : Plan
        Verified or not.

    Returns
    -------
    dict of str to float
        Column -> number; not finite where the plan has none.
    """
    flight = plan.flight(samples=_SAMPLES)
    return _rounded(
        {
            ENERGY: plan.energy,
            HOVER_ENERGY: plan.hover_energy_J,
            EXCESS_ENERGY: plan.energy - plan.hover_energy_J,
            **_flight_outputs(flight, plan.scenario),
            _ERROR_ESTIMATE: plan.error_estimate,
        }
    )


def baseline_outputs(reference: Reference, flight: Flight, plan: Plan) -> dict[str, float]:
    """Return the numbers of a controlled flight beside a plan.

    Parameters
    ----------
    reference : Reference
        What the controller followed; it starts the columns' names.
    flight : Flight
        The controlled flight.
    plan : Plan
        Of the same case.

    Returns
    -------
    dict of str to float
        Column -> number.
    """
    name = reference.value
    saved = 1.0 - plan.energy / settled_energy(flight) if is_comparable(flight) else np.nan
    return _rounded(
        {
            f"{name}_energy_J": flight.energy_J,
            f"{name}_owed_energy_J": flight.owed_energy_J,
            f"{name}_{TERMINAL_MISS}": flight.terminal_miss_m,
            f"saving_over_{name}_percent": 100.0 * saved,
        }
    )


def flown_outputs(flight: Flight, plan: Plan, scenario: Scenario) -> dict[str, float]:
    """Return the numbers of a plan flown by the controller in another world than planned.

    Parameters
    ----------
    flight : Flight
        What became of it.
    plan : Plan
        What was planned.
    scenario : Scenario
        The world flown in.

    Returns
    -------
    dict of str to float
        Column -> number.
    """
    return _rounded(
        {
            ENERGY: flight.energy_J,
            "planned_energy_J": plan.energy,
            "energy_above_plan_J": flight.energy_J - plan.energy,
            **_flight_outputs(flight, scenario),
        }
    )


def _rounded(outputs: dict[str, float]) -> dict[str, float]:
    return {name: _meaningful(name, value) for name, value in outputs.items()}


def _meaningful(name: str, value: float) -> float:
    if name.endswith(_RESIDUALS) and math.isfinite(value):
        return float(f"{round(value / _SMALLEST_RESIDUAL) * _SMALLEST_RESIDUAL:.{_DIGITS}g}")
    digits = _ERROR_DIGITS if name == _ERROR_ESTIMATE else _DIGITS
    return float(f"{value:.{digits}g}")


def _flight_outputs(flight: Flight, scenario: Scenario) -> dict[str, float]:
    frame = flight.frame
    tilt = np.arccos(np.cos(frame["phi_rad"]) * np.cos(frame["theta_rad"]))
    return {
        MEAN_POWER: flight.energy_J / flight.duration_s,
        "peak_power_W": float(frame["power_W"].max()),
        "peak_tilt_rad": float(tilt.max()),
        **_battery_outputs(flight, scenario),
        "max_violation": flight.max_violation,
        TERMINAL_MISS: flight.terminal_miss_m,
    }


def _battery_outputs(flight: Flight, scenario: Scenario) -> dict[str, float]:
    """Return what the flight takes of the charge, and how far the charge takes the vehicle.

    Range and endurance are those of the mission flown again and again at the voltage of the first
    time: a battery that sags makes them a little shorter.
    """
    frame = flight.frame
    charge = frame["state_of_charge_percent"]
    used = float(charge.iloc[0] - charge.iloc[-1])
    usable = scenario.battery.initial_state_of_charge - (
        scenario.limits.state_of_charge_min or _EMPTY
    )
    repeats = usable / used if used > 0.0 else np.nan
    mission = scenario.mission
    return {
        "battery_used_percent": used,
        "lowest_voltage_V": float(frame["battery_voltage_V"].min()),
        "range_m": repeats * math.dist(mission.start.position, mission.goal.position),
        "endurance_s": repeats * flight.duration_s,
    }
