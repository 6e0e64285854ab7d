"""Tables of the study of Yacef et al., with the numbers that their paper prints.

Column names contain SI units. The file `printed.csv` lists the paper's parameters and the scenario
field of each parameter.
"""

from collections.abc import Iterable
from dataclasses import asdict
from math import isfinite
from pathlib import Path
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
from pyomo_quad.paper.study import PackFacts, PaperStudy
from pyomo_quad.report.render import NOTHING, fixed, rough
from pyomo_quad.report.signals import BATTERY, POWER
from pyomo_quad.scenario import PowerModel, Reference, describe_fields
from pyomo_quad.study.comparison import settled_energy

# Results that the paper prints in section IV, by number of the experiment.
#: Energy of the optimal flight [J], which the paper prints for the first experiment only.
OPTIMAL_ENERGY = {1: 1890.0}
#: Energy of the flight under the adaptive controller [J].
ADAPTIVE_ENERGY = {1: 5770.0, 2: 9740.0}
#: Saving of the optimal flight over the adaptive flight [percent]; the paper calls it an increase.
SAVING = {1: 67.24, 2: 78.85}
_PRINTED_HOVER_SPEED = 912.0  # rad/s, section IV


def implied_wind_optimum() -> float:
    """Return the energy [J] of the optimal flight in wind, as implied by the paper's saving.

    Yacef et al. print the energy under the adaptive controller, and the relative saving of the
    optimal flight. The result is energy * (1 - saving).
    """
    return ADAPTIVE_ENERGY[2] * (1 - SAVING[2] / 100)


def paper_parameters() -> pd.DataFrame:
    """Return a table of the parameters that Yacef et al. print, and of the package's own values.

    The package's values are those of its scenario of the experiment in wind.
    """
    table = pd.read_csv(Path(__file__).with_name("printed.csv"), converters={"printed": float})
    scenario = paper_scenario(Experiment.WIND, {"battery.use": PAPER_CELL})
    used = {field.path: field.value for field in describe_fields(scenario)}
    table.insert(3, "used", [_used(used, field) for field in table["field"]])
    return table


def _used(values: dict[str, object], field: str) -> float:
    path, _, position = field.removesuffix("]").partition("[")
    held = values[path]
    if position and isinstance(held, tuple):
        held = held[int(position)]
    return float(held)  # type: ignore[arg-type]


def corrections(study: PaperStudy) -> dict[str, Any]:
    """Return the numbers with which the report shows errors and gaps in the paper of Yacef et al.

    An example is the lack of thrust at the rotor speed that the paper prints for hover. The
    template of the report inserts the numbers by name.
    """
    printed = paper_parameters().set_index("field")["printed"]["vehicle.torque_constant"]
    scenario = paper_scenario(Experiment.CALM)
    steady = Planner().steady_flight(scenario.with_values({"power.model": PowerModel.SHAFT}))
    at_hover = steady.hover
    weight = scenario.vehicle.total_mass * scenario.gravity
    with_credit = [
        model.value
        for model in POWER_MODELS
        if paper_scenario(Experiment.CALM, {"power.model": model}).power.regeneration
    ]
    return {
        "vehicle": scenario.vehicle,
        "printed_torque_constant": printed,
        "printed_current_A": at_hover.power_W / 4 / at_hover.rotor_speed_rad_per_s / printed,
        "printed_hover_speed": _PRINTED_HOVER_SPEED,
        "hover_speed": at_hover.rotor_speed_rad_per_s,
        "lack_percent": 100 * (1 - float(steady.thrust(_PRINTED_HOVER_SPEED)) / weight),
        "critical_acceleration": study.critical_acceleration,
        "greatest_speed": study.efficiency_map.speed[-1],
        "without_credit": [m.value for m in POWER_MODELS if m.value not in with_credit],
        "with_credit": with_credit,
        "cell": study.packs[0],
        "optimum_J": OPTIMAL_ENERGY[1],
        "adaptive_J": ADAPTIVE_ENERGY,
        "saving_percent": SAVING,
        "implied_wind_optimum_J": implied_wind_optimum(),
    }


_KILO = 1e3
# Largest energy [J] and smallest distance [m] that are printed with a fixed number of decimals;
# others are printed with significant digits.
_LARGEST_PLAIN, _SMALLEST_PLAIN = 1e6, 1e-2


def kilojoules(energy: float, digits: int = 3) -> str:
    """Format an energy [J] as text in kJ, with `digits` decimals.

    Energies of 1 MJ or more have two significant digits instead, such as "1.2e+03". Minus infinity
    becomes "no minimum", NaN and plus infinity become "n/a".
    """
    if energy == -float("inf"):
        return "no minimum"
    if not isfinite(energy):
        return NOTHING
    return fixed(energy / _KILO, digits) if abs(energy) < _LARGEST_PLAIN else rough(energy / _KILO)


def metres(distance: float) -> str:
    """Format a distance from the goal [m] as text in m.

    Distances of 0.01 m or more have two decimals. Smaller distances have two significant digits.
    """
    return fixed(distance) if distance >= _SMALLEST_PLAIN else rough(distance)


#: Content of each table in words, by file name without suffix.
TABLES = {
    "parameters": "the numbers of Tables 1 and 2 and of section IV, printed and used",
    "experiments": "both experiments under every power model",
    "wind": "the second experiment in every reading of the wind",
    "baselines": "the controlled flights, and the saving of the optimum against them",
    "batteries": "stored energy and greatest power of the packs",
    "floors": "the least energy of any flight under f_r against the bound on alpha",
    "meshes": "the optimum under f_r against the bound on alpha and the mesh",
}


def paper_tables(study: PaperStudy) -> dict[str, pd.DataFrame]:
    """Return every table of the report on Yacef et al., by name.

    The name of a table is the name of its file without suffix. `TABLES` describes each table in
    words.
    """
    rows = {
        "experiments": map(_experiment_row, study.flights),
        "wind": map(_wind_row, study.wind_flights),
        "baselines": (baseline_row(study, flown) for flown in study.baselines),
        "batteries": map(_battery_row, study.packs),
        "floors": _floor_rows(study),
        "meshes": _mesh_rows(study),
    }
    return {
        "parameters": paper_parameters(),
        **{name: pd.DataFrame(list(held)) for name, held in rows.items()},
    }


def find_flight(
    flights: Iterable[PaperFlight], experiment: Experiment, model: PowerModel
) -> PaperFlight:
    """Return the optimal flight of an experiment under a power model.

    If there is no such flight, StopIteration is raised.
    """
    return next(
        flown
        for flown in flights
        if (flown.case.experiment, flown.case.power_model) == (experiment, model)
    )


def find_baseline(
    study: PaperStudy, experiment: Experiment, model: PowerModel, reference: Reference
) -> BaselineFlight:
    """Return the adaptive controller's flight of an experiment along a reference trajectory.

    `model` is the power model with which the energy of the flight was computed. If there is no such
    flight, StopIteration is raised.
    """
    return next(
        flown
        for flown in study.baselines
        if (flown.case.experiment, flown.case.power_model, flown.case.reference)
        == (experiment, model, reference)
    )


def _common(flown: PaperFlight) -> dict[str, object]:
    frame = flown.flight.frame
    charge = BATTERY[-1].of(frame)
    return {
        "energy_J": flown.flight.energy_J,
        "hover_energy_J": flown.hover_energy_J,
        "excess_energy_J": flown.flight.energy_J - flown.hover_energy_J,
        "peak_power_W": POWER.of(frame).max(),
        "battery_used_percent": charge[0] - charge[-1],
        "terminal_miss_m": flown.flight.terminal_miss_m,
        "status": flown.status.value,
        "flight_verified": flown.flight.is_verified,
    }


def _experiment_row(flown: PaperFlight) -> dict[str, object]:
    experiment = flown.case.experiment.value
    return {
        "experiment": experiment,
        "power_model": flown.case.power_model.value,
        **_common(flown),
        "paper_optimum_J": OPTIMAL_ENERGY.get(experiment, implied_wind_optimum()),
    }


def _wind_row(flown: PaperFlight) -> dict[str, object]:
    return {
        "coupling": flown.case.coupling.value,
        "frequency_unit": flown.case.frequency_unit.value,
        "power_model": flown.case.power_model.value,
        **_common(flown),
    }


def baseline_row(study: PaperStudy, flown: BaselineFlight) -> dict[str, Any]:
    """Return the table row that compares an adaptive controller's flight with the optimum.

    `saving_percent` is 100 (E - E_min) / E, and `saving_of_excess_percent` is
    100 (E - E_min) / (E - E_hover). E is the flight's `settled_energy`, E_min the energy of the
    optimal plan, E_hover that of hovering.
    """
    case = flown.case
    optimum = find_flight(study.flights, case.experiment, case.power_model)
    # The flight misses the goal state. The costates of the plan give an estimate of the energy that
    # is still needed to reach it. There is no estimate if the solve of the plan did not converge.
    priced = flown.flight.priced(optimum.end_prices)
    least, spent = optimum.flight.energy_J, settled_energy(priced)
    excess = spent - optimum.hover_energy_J
    return {
        "experiment": case.experiment.value,
        "power_model": case.power_model.value,
        "flight": flown.flight.name,
        ENERGY: flown.flight.energy_J,
        "owed_energy_J": priced.owed_energy_J,
        "hover_energy_J": optimum.hover_energy_J,
        "excess_energy_J": excess,
        "optimum_J": least,
        "saving_percent": 100 * (1 - least / spent),
        "saving_of_excess_percent": 100 * (spent - least) / excess,
        "terminal_miss_m": flown.flight.terminal_miss_m,
        "flight_verified": flown.flight.is_verified,
        "paper_adaptive_J": ADAPTIVE_ENERGY[case.experiment.value],
        "paper_saving_percent": SAVING[case.experiment.value],
    }


def _battery_row(pack: PackFacts) -> dict[str, object]:
    row = asdict(pack)
    shortfalls = row.pop("shortfalls")
    return row | {"power_model": pack.power_model.value, "warning": " ".join(shortfalls)}


def _floor_rows(study: PaperStudy) -> list[dict[str, object]]:
    return [
        {"reading": reading.value, "rotor_acceleration_max_rad_per_s2": bound, "floor_J": floor}
        for reading, floors in study.floors.items()
        for bound, floor in floors
    ]


def _mesh_rows(study: PaperStudy) -> list[dict[str, object]]:
    floors = {
        (reading, bound): floor for reading, pairs in study.floors.items() for bound, floor in pairs
    }
    return [
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
