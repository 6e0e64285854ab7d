"""The columns of a case: what is read off its flights.

This is the one home of their names: task, tables and figures take them from here.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from pyomo_quad.flight import Flight, Plan
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.baseline import Reference
from pyomo_quad.study.comparison import is_comparable, settled_energy
from pyomo_quad.study.sweep.task import StudyTask

__all__ = [
    "DURATION_FIELD",
    "ENERGY",
    "EXCESS_ENERGY",
    "HOVER_ENERGY",
    "MEAN_POWER",
    "TERMINAL_MISS",
    "baseline_outputs",
    "flown_outputs",
    "output_columns",
    "plan_outputs",
    "unknown_column",
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


@dataclass(frozen=True, kw_only=True)
class _Flown:
    """What the columns are read off: a flight, the plan beside it, and the world flown in."""

    flight: Flight
    plan: Plan
    scenario: Scenario

    @property
    def charge_used(self) -> float:
        """What the flight takes of the charge, in percent."""
        charge = self.flight.frame["state_of_charge_percent"]
        return float(charge.iloc[0] - charge.iloc[-1])

    @property
    def repeats(self) -> float:
        """How often the mission can be flown on one charge.

        At the voltage of the first time: a battery that sags makes it a little less often.
        """
        least = self.scenario.limits.state_of_charge_min or _EMPTY
        usable = self.scenario.battery.initial_state_of_charge - least
        return usable / self.charge_used if self.charge_used > 0.0 else np.nan

    @property
    def peak_tilt(self) -> float:
        """Greatest angle between thrust and vertical, in rad."""
        frame = self.flight.frame
        return float(np.arccos(np.cos(frame["phi_rad"]) * np.cos(frame["theta_rad"])).max())

    @property
    def saved(self) -> float:
        """Share of the flight's energy that the plan saves, where they can be compared."""
        if not is_comparable(self.flight):
            return np.nan
        return 1.0 - self.plan.energy / settled_energy(self.flight)

    @property
    def distance(self) -> float:
        """From start to goal, in m."""
        mission = self.scenario.mission
        return math.dist(mission.start.position, mission.goal.position)


_Columns = Mapping[str, Callable[[_Flown], float]]

_OF_A_FLIGHT: _Columns = {
    MEAN_POWER: lambda one: one.flight.energy_J / one.flight.duration_s,
    "peak_power_W": lambda one: float(one.flight.frame["power_W"].max()),
    "peak_tilt_rad": lambda one: one.peak_tilt,
    "battery_used_percent": lambda one: one.charge_used,
    "lowest_voltage_V": lambda one: float(one.flight.frame["battery_voltage_V"].min()),
    "range_m": lambda one: one.repeats * one.distance,
    "endurance_s": lambda one: one.repeats * one.flight.duration_s,
    "max_violation": lambda one: one.flight.max_violation,
    TERMINAL_MISS: lambda one: one.flight.terminal_miss_m,
}
_OF_A_PLAN: _Columns = {
    ENERGY: lambda one: one.plan.energy,
    HOVER_ENERGY: lambda one: one.plan.hover_energy_J,
    EXCESS_ENERGY: lambda one: one.plan.energy - one.plan.hover_energy_J,
    **_OF_A_FLIGHT,
    _ERROR_ESTIMATE: lambda one: one.plan.error_estimate,
}
_OF_A_PLAN_FLOWN: _Columns = {
    ENERGY: lambda one: one.flight.energy_J,
    "planned_energy_J": lambda one: one.plan.energy,
    "energy_above_plan_J": lambda one: one.flight.energy_J - one.plan.energy,
    **_OF_A_FLIGHT,
}


def _of_a_baseline(reference: Reference) -> _Columns:
    name = reference.value
    return {
        f"{name}_energy_J": lambda one: one.flight.energy_J,
        f"{name}_owed_energy_J": lambda one: one.flight.owed_energy_J,
        f"{name}_{TERMINAL_MISS}": lambda one: one.flight.terminal_miss_m,
        f"saving_over_{name}_percent": lambda one: 100.0 * one.saved,
    }


def output_columns(task: StudyTask, baselines: Iterable[Reference]) -> tuple[str, ...]:
    """Return the columns of a case's row, in their order, before any case is solved."""
    if task is StudyTask.FLY_PLAN:
        return tuple(_OF_A_PLAN_FLOWN)
    flown = [name for reference in baselines for name in _of_a_baseline(reference)]
    return (*_OF_A_PLAN, *flown)


def unknown_column(
    names: Iterable[str], task: StudyTask, baselines: Iterable[Reference]
) -> str | None:
    """Return the first name that is none of a study's columns."""
    known = output_columns(task, baselines)
    return next((name for name in names if name not in known), None)


def plan_outputs(plan: Plan) -> dict[str, float]:
    """Return the numbers of a case's plan, verified or not; not finite where it has none."""
    flight = plan.flight(samples=_SAMPLES)
    return _read(_OF_A_PLAN, _Flown(flight=flight, plan=plan, scenario=plan.scenario))


def baseline_outputs(reference: Reference, flight: Flight, plan: Plan) -> dict[str, float]:
    """Return the numbers of a controlled flight beside the plan of the same case."""
    flown = _Flown(flight=flight, plan=plan, scenario=plan.scenario)
    return _read(_of_a_baseline(reference), flown)


def flown_outputs(flight: Flight, plan: Plan, scenario: Scenario) -> dict[str, float]:
    """Return the numbers of a plan flown by the controller in another world than planned."""
    return _read(_OF_A_PLAN_FLOWN, _Flown(flight=flight, plan=plan, scenario=scenario))


def _read(columns: _Columns, flown: _Flown) -> dict[str, float]:
    return {name: _meaningful(name, read(flown)) for name, read in columns.items()}


def _meaningful(name: str, value: float) -> float:
    if name.endswith(_RESIDUALS) and math.isfinite(value):
        return float(f"{round(value / _SMALLEST_RESIDUAL) * _SMALLEST_RESIDUAL:.{_DIGITS}g}")
    digits = _ERROR_DIGITS if name == _ERROR_ESTIMATE else _DIGITS
    return float(f"{value:.{digits}g}")
