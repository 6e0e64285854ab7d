"""What the paper prints, and the results of its study as tables beside it.

Where it is wrong or silent is told too.  Columns are named with SI units.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
import pandas as pd

from pyomo_quad.flight import Planner
from pyomo_quad.flight.columns import ENERGY
from pyomo_quad.paper.experiments import (
    PAPER_CELL,
    POWER_MODELS,
    BaselineFlight,
    Experiment,
    PaperFlight,
    paper_scenario,
)
from pyomo_quad.paper.study import PaperStudy
from pyomo_quad.report.render import NOTHING, fixed, rough
from pyomo_quad.report.signals import BATTERY, POWER
from pyomo_quad.scenario import PowerModel, Reference, describe_fields
from pyomo_quad.study.comparison import settled_energy


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A result that the paper prints.

    ``value`` is in the unit of the name under which it is listed.
    """

    value: float
    place: str


@dataclass(frozen=True, kw_only=True)
class PrintedNumber:
    """A parameter that the paper prints, and the scenario's field that stands for it."""

    symbol: str
    printed: str
    unit: str
    field: str


#: By number of the experiment, J. The optimum of the second is not printed.
OPTIMAL_ENERGY = {1: Claim(value=1890.0, place="section IV, first test")}
ADAPTIVE_ENERGY = {
    1: Claim(value=5770.0, place="section IV, first test"),
    2: Claim(value=9740.0, place="section IV, second test"),
}
#: By number of the experiment, percent; the paper calls each an increase.
SAVING = {
    1: Claim(value=67.24, place="section IV, first test"),
    2: Claim(value=78.85, place="section IV, second test"),
}


def implied_wind_optimum() -> float:
    """Return the optimum of the second test that its adaptive energy and percentage imply.

    Returns
    -------
    float
        The percentages are reductions relative to the adaptive flight, J.
    """
    return ADAPTIVE_ENERGY[2].value * (1 - SAVING[2].value / 100)


TABLE_1 = (
    PrintedNumber(symbol="I_r", printed="4.1904e-5", unit="kg m²", field="vehicle.rotor_inertia"),
    PrintedNumber(symbol="k_t", printed="0.0104e-3", unit="N m/A", field="vehicle.torque_constant"),
    PrintedNumber(symbol="k_v", printed="96.342", unit="rad/s/V", field="vehicle.voltage_constant"),
    PrintedNumber(symbol="R", printed="0.2", unit="Ω", field="vehicle.motor_resistance"),
    PrintedNumber(symbol="Q_bat", printed="1.55", unit="Ah", field="battery.capacity"),
    PrintedNumber(symbol="R_bat", printed="0.02", unit="Ω", field="battery.cell_resistance"),
    PrintedNumber(symbol="e_0", printed="1.24", unit="V", field="battery.E0"),
    PrintedNumber(symbol="k", printed="2.92e-3", unit="V", field="battery.K"),
    PrintedNumber(symbol="c_1", printed="0.156", unit="V", field="battery.A"),
    PrintedNumber(symbol="c_2", printed="2.35", unit="1/Ah", field="battery.B"),
)

VEHICLE = (
    PrintedNumber(symbol="l", printed="0.175", unit="m", field="vehicle.arm_length"),
    PrintedNumber(symbol="m", printed="1.3", unit="kg", field="vehicle.mass"),
    PrintedNumber(symbol="I_x", printed="0.081", unit="kg m²", field="vehicle.Ix"),
    PrintedNumber(symbol="I_y", printed="0.081", unit="kg m²", field="vehicle.Iy"),
    PrintedNumber(symbol="I_z", printed="0.142", unit="kg m²", field="vehicle.Iz"),
    PrintedNumber(
        symbol="κ_b", printed="3.8305e-6", unit="N s²", field="vehicle.thrust_coefficient"
    ),
    PrintedNumber(
        symbol="κ", printed="2.2518e-8", unit="N m s²", field="vehicle.drag_torque_coefficient"
    ),
    PrintedNumber(symbol="g", printed="9.81", unit="m/s²", field="gravity"),
)


def _axis(axis: str, rows: tuple[tuple[str, str], ...]) -> tuple[PrintedNumber, ...]:
    harmonics = tuple(
        number
        for k, (frequency, amplitude) in enumerate(rows)
        for number in (
            PrintedNumber(
                symbol=f"Ω_{k + 1}, {axis}",
                printed=frequency,
                unit="Hz",
                field=f"wind.{axis}.frequencies[{k}]",
            ),
            PrintedNumber(
                symbol=f"A_{k + 1}, {axis}",
                printed=amplitude,
                unit="m/s",
                field=f"wind.{axis}.amplitudes[{k}]",
            ),
        )
    )
    return (
        *harmonics,
        PrintedNumber(
            symbol=f"v_gmax, {axis}",
            printed="0.20",
            unit="m/s",
            field=f"wind.{axis}.gust_amplitude",
        ),
        PrintedNumber(
            symbol=f"T_g, {axis}", printed="10", unit="s", field=f"wind.{axis}.gust_period"
        ),
    )


TABLE_2 = (
    PrintedNumber(symbol="v_0, x", printed="1.0", unit="m/s", field="wind.x.mean"),
    *_axis("x", (("0.5", "0.10"), ("0.7", "0.25"), ("1.0", "0.30"))),
    PrintedNumber(symbol="v_0, y", printed="0.5", unit="m/s", field="wind.y.mean"),
    *_axis("y", (("0.6", "-0.05"), ("1.0", "-0.10"), ("1.5", "-0.30"))),
)


_PRINTED_HOVER_SPEED = 912.0  # rad/s, section IV


def corrections(study: PaperStudy) -> dict[str, Any]:
    """Return the numbers of the template that says where the paper is wrong or silent."""
    printed = next(float(n.printed) for n in TABLE_1 if n.field == "vehicle.torque_constant")
    scenario = paper_scenario(Experiment.CALM)
    steady = Planner().steady_flight(scenario.with_values({"power.model": PowerModel.SHAFT}))
    at_hover = steady.hover
    weight = scenario.vehicle.total_mass * scenario.gravity
    # Whether braking earns, as the experiments are declared.
    earns = {
        model: paper_scenario(Experiment.CALM, {"power.model": model}).power.regeneration
        for model in POWER_MODELS
    }
    return {
        "vehicle": scenario.vehicle,
        "printed_torque_constant": printed,
        "printed_current_A": at_hover.power_W / 4 / at_hover.rotor_speed_rad_per_s / printed,
        "printed_hover_speed": _PRINTED_HOVER_SPEED,
        "hover_speed": at_hover.rotor_speed_rad_per_s,
        "lack_percent": 100 * (1 - float(steady.thrust(_PRINTED_HOVER_SPEED)) / weight),
        "critical_acceleration": study.critical_acceleration,
        "greatest_speed": study.efficiency_map.speed[-1],
        "without_credit": [model.value for model, credit in earns.items() if not credit],
        "with_credit": [model.value for model, credit in earns.items() if credit],
        "cell": study.packs[0],
        "optimum_J": OPTIMAL_ENERGY[1].value,
        "adaptive_J": {number: claim.value for number, claim in ADAPTIVE_ENERGY.items()},
        "saving_percent": {number: claim.value for number, claim in SAVING.items()},
        "implied_wind_optimum_J": implied_wind_optimum(),
    }


_KILO = 1e3
_LARGEST_PLAIN = 1e6  # J
_SMALLEST_PLAIN = 1e-2  # m


def kilojoules(energy: float, digits: int = 3) -> str:
    """Return an energy in kJ.

    Parameters
    ----------
    energy : float
        J.
    digits : int, default 3
        Decimals.
    """
    if energy == -float("inf"):
        return "no minimum"
    if not isfinite(energy):
        return NOTHING
    return fixed(energy / _KILO, digits) if abs(energy) < _LARGEST_PLAIN else rough(energy / _KILO)


def metres(distance: float) -> str:
    """Return a distance from the goal in m.

    Parameters
    ----------
    distance : float
        m, not negative.
    """
    return fixed(distance) if distance >= _SMALLEST_PLAIN else rough(distance)


BATTERY_USED = "battery_used_percent"
PEAK_POWER = "peak_power_W"

#: File name without suffix -> what the table shows.
TABLES = {
    "parameters": "the numbers of Tables 1 and 2 and of section IV, printed and used",
    "experiments": "both experiments under every power model",
    "wind": "the second experiment in every reading of the wind",
    "baselines": "the controlled flights, and what the optimum saves against them",
    "batteries": "what the packs hold and deliver",
    "floors": "the least energy of any flight under f_r against the bound on alpha",
    "meshes": "the optimum under f_r against the bound on alpha and the mesh",
}


def paper_tables(study: PaperStudy) -> dict[str, pd.DataFrame]:
    """Return every table of the report."""
    made = {
        "parameters": _parameters(),
        "experiments": _experiments(study),
        "wind": pd.DataFrame([_wind_row(flown) for flown in study.wind_flights]),
        "baselines": pd.DataFrame([_baseline_row(study, flown) for flown in study.baselines]),
        "batteries": _batteries(study),
        "floors": _floors(study),
        "meshes": _meshes(study),
    }
    return {name: made[name] for name in TABLES}


def find_flight(
    flights: Iterable[PaperFlight], experiment: Experiment, model: PowerModel
) -> PaperFlight:
    """Return the optimal flight of an experiment under a power model."""
    return next(
        flown
        for flown in flights
        if (flown.case.experiment, flown.case.power_model) == (experiment, model)
    )


def find_baseline(
    study: PaperStudy, experiment: Experiment, model: PowerModel, reference: Reference
) -> BaselineFlight:
    """Return a controlled flight."""
    return next(
        flown
        for flown in study.baselines
        if (flown.case.experiment, flown.case.power_model, flown.case.reference)
        == (experiment, model, reference)
    )


def baseline_saving(study: PaperStudy, flown: BaselineFlight) -> tuple[float, float]:
    """Return what the optimum saves against a controlled flight.

    Returns
    -------
    saving, saving_of_excess : float
        Percent of its energy, with what its end state owes, and of that above hovering.  A power
        without an optimum prices no end: its flights are taken as flown.
    """
    optimum = find_flight(study.flights, flown.case.experiment, flown.case.power_model)
    least = optimum.flight.energy_J
    spent = settled_energy(flown.priced_by(optimum))
    excess = spent - optimum.hover_energy_J
    return 100 * (1 - least / spent), 100 * (spent - least) / excess


def _parameters() -> pd.DataFrame:
    scenario = paper_scenario(Experiment.WIND, {"battery.use": PAPER_CELL})
    used = {field.path: field.value for field in describe_fields(scenario)}
    rows = [
        {
            "place": place,
            "symbol": number.symbol,
            "printed": float(number.printed),
            "used": _used(used, number),
            "unit": number.unit,
            "field": number.field,
        }
        for place, numbers in (
            ("Table 1", TABLE_1),
            ("Table 2", TABLE_2),
            ("section IV", VEHICLE),
        )
        for number in numbers
    ]
    return pd.DataFrame(rows)


def _used(values: dict[str, object], number: PrintedNumber) -> float:
    path, _, position = number.field.removesuffix("]").partition("[")
    held = values[path]
    if position and isinstance(held, tuple):
        held = held[int(position)]
    return float(held)  # type: ignore[arg-type]


def _common(flown: PaperFlight) -> dict[str, object]:
    frame = flown.flight.frame
    charge = BATTERY[-1].of(frame)
    return {
        "energy_J": flown.flight.energy_J,
        "hover_energy_J": flown.hover_energy_J,
        "excess_energy_J": flown.flight.energy_J - flown.hover_energy_J,
        PEAK_POWER: POWER.of(frame).max(),
        BATTERY_USED: charge[0] - charge[-1],
        "terminal_miss_m": flown.flight.terminal_miss_m,
        "status": flown.status.value,
        "flight_verified": flown.flight.is_verified,
    }


def _experiments(study: PaperStudy) -> pd.DataFrame:
    printed = {1: OPTIMAL_ENERGY[1].value, 2: implied_wind_optimum()}
    rows = [
        {
            "experiment": flown.case.experiment.value,
            "power_model": flown.case.power_model.value,
            **_common(flown),
            "paper_optimum_J": printed[flown.case.experiment.value],
        }
        for flown in study.flights
    ]
    return pd.DataFrame(rows)


def _wind_row(flown: PaperFlight) -> dict[str, object]:
    return {
        "coupling": flown.case.coupling.value,
        "frequency_unit": flown.case.frequency_unit.value,
        "power_model": flown.case.power_model.value,
        **_common(flown),
    }


def _baseline_row(study: PaperStudy, flown: BaselineFlight) -> dict[str, object]:
    case = flown.case
    saving, saving_of_excess = baseline_saving(study, flown)
    optimum = find_flight(study.flights, case.experiment, case.power_model)
    priced = flown.priced_by(optimum)
    return {
        "experiment": case.experiment.value,
        "power_model": case.power_model.value,
        "flight": flown.flight.name,
        ENERGY: flown.flight.energy_J,
        "owed_energy_J": priced.owed_energy_J,
        "hover_energy_J": optimum.hover_energy_J,
        "excess_energy_J": settled_energy(priced) - optimum.hover_energy_J,
        "optimum_J": optimum.flight.energy_J,
        "saving_percent": saving,
        "saving_of_excess_percent": saving_of_excess,
        "terminal_miss_m": flown.flight.terminal_miss_m,
        "flight_verified": flown.flight.is_verified,
        "paper_adaptive_J": ADAPTIVE_ENERGY[case.experiment.value].value,
        "paper_saving_percent": SAVING[case.experiment.value].value,
    }


def _batteries(study: PaperStudy) -> pd.DataFrame:
    rows = [
        {
            "battery": pack.battery,
            "cells_series": pack.cells_series,
            "cells_parallel": pack.cells_parallel,
            "power_model": pack.power_model.value,
            "stored_energy_J": pack.stored_energy_J,
            "hover_energy_J": pack.hover_energy_J,
            "hover_power_W": pack.hover_power_W,
            "greatest_power_W": pack.greatest_power_W,
            "warning": " ".join(pack.shortfalls),
        }
        for pack in study.packs
    ]
    return pd.DataFrame(rows)


def _floors(study: PaperStudy) -> pd.DataFrame:
    rows = [
        {"reading": reading.value, "rotor_acceleration_max_rad_per_s2": bound, "floor_J": floor}
        for reading, floors in study.floors.items()
        for bound, floor in floors
    ]
    return pd.DataFrame(rows)


def _meshes(study: PaperStudy) -> pd.DataFrame:
    floors = {
        (reading, bound): floor for reading, pairs in study.floors.items() for bound, floor in pairs
    }
    rows = [
        {
            "reading": outcome.trial.reading.value,
            "rotor_acceleration_max_rad_per_s2": outcome.trial.bound,
            "elements": outcome.trial.elements,
            "degree": outcome.trial.degree,
            "converged": outcome.has_converged,
            ENERGY: outcome.energy_J,
            "flown_energy_J": outcome.flown_energy_J,
            "terminal_miss_m": outcome.miss_m,
            "floor_J": floors.get((outcome.trial.reading, outcome.trial.bound), np.nan),
        }
        for outcome in study.trials
    ]
    return pd.DataFrame(rows)
