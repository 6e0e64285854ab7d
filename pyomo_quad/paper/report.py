"""The report on the paper: what is reproduced, what is not, and why, in the run's own numbers."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pyomo_quad.model import build_model
from pyomo_quad.model.typeset import EQUATION_TABLE, TypesetEquation, typeset_equations
from pyomo_quad.paper.experiments import (
    POWER_MODELS,
    BaselineFlight,
    Experiment,
    PaperFlight,
    Reading,
    full_speed_energy,
    paper_scenario,
)
from pyomo_quad.paper.figures import floor_drawing, paper_drawings
from pyomo_quad.paper.study import PaperStudy
from pyomo_quad.paper.tables import (
    ADAPTIVE_ENERGY,
    OPTIMAL_ENERGY,
    SAVING,
    TABLES,
    baseline_saving,
    corrections,
    find_baseline,
    find_flight,
    implied_wind_optimum,
    kilojoules,
    metres,
    paper_tables,
)
from pyomo_quad.report import Figures
from pyomo_quad.report.document import REPORT_NAME, save_drawings, wanted_drawings
from pyomo_quad.report.render import render_markdown
from pyomo_quad.report.report import climb_of
from pyomo_quad.report.style import BATTERY, POWER
from pyomo_quad.report.tables import write_table
from pyomo_quad.scenario import PowerModel, Reference, WindCoupling
from pyomo_quad.study.comparison import settled_energy

_OTHER_POWERS = tuple(model for model in POWER_MODELS if model is not PowerModel.MOTOR)


@dataclass(frozen=True, kw_only=True)
class Tolerance:
    """Largest relative difference between a committed and a regenerated number.

    ``scope`` says to whom it applies, ``columns`` names the columns of the table.
    """

    table: str
    columns: tuple[str, ...]
    relative: float
    scope: str


TOLERANCES = (
    Tolerance(
        table="experiments",
        columns=("energy_J", "hover_energy_J"),
        relative=1e-4,
        scope="every flight whose solve converged, also on a coarse mesh",
    ),
    Tolerance(
        table="wind",
        columns=("energy_J", "hover_energy_J"),
        relative=1e-4,
        scope="every flight whose solve converged, also on a coarse mesh",
    ),
    Tolerance(
        table="baselines",
        columns=("energy_J", "optimum_J"),
        relative=1e-4,
        scope="every flight",
    ),
    Tolerance(
        table="batteries",
        columns=("stored_energy_J", "hover_power_W", "greatest_power_W"),
        relative=1e-6,
        scope="every pack",
    ),
    Tolerance(table="floors", columns=("floor_J",), relative=1e-3, scope="every finite floor"),
)


TIMES_NAME = "timings.json"


def write_paper_report(folder: Path, study: PaperStudy, figures: Figures = Figures.SVG) -> None:
    """Write `report.md`, tables and figures of the paper's study.

    Parameters
    ----------
    folder : Path
        An existing folder, empty of reports.
    study : PaperStudy
        The results.
    figures : Figures, optional
        What is drawn.

    Notes
    -----
    Two runs write the same bytes, but for the times, which have a file of their own.
    """
    tables = paper_tables(study)
    for name, frame in tables.items():
        write_table(frame, folder / f"{name}.csv")
    drawings = wanted_drawings(paper_drawings(study), figures)
    floors = wanted_drawings([floor_drawing(study)], figures)
    save_drawings((*drawings, *floors), folder)
    text = render_markdown(
        "paper/report.md.j2",
        **{**examination(study), **corrections(study), **_flights(study)},
        floor_drawings=floors,
        drawings=drawings,
        parameters=_by_place(tables["parameters"]),
        equations=list(_equations()),
        EQUATION_TABLE=EQUATION_TABLE,
        TOLERANCES=TOLERANCES,
        TABLES=TABLES,
        TIMES_NAME=TIMES_NAME,
    )
    (folder / REPORT_NAME).write_text(text, encoding="utf-8")
    seconds = {name: round(taken, 3) for name, taken in study.seconds.items()}
    (folder / TIMES_NAME).write_text(json.dumps(seconds, indent=2) + "\n", encoding="utf-8")


def _flights(study: PaperStudy) -> dict[str, Any]:
    """Return the flights of the experiments, in every wind, and under control."""
    optimum = find_flight(study.flights, Experiment.CALM, PowerModel.MOTOR)
    _, climb_J = climb_of(optimum.case.scenario)
    return {
        "optimum": optimum,
        "climb_J": climb_J,
        "experiments": [_experiment(study, experiment) for experiment in Experiment],
        "wind_flights": [_planned(flown) for flown in study.wind_flights],
        "baselines": [_controlled(study, flown) for flown in study.baselines],
    }


def _experiment(study: PaperStudy, experiment: Experiment) -> dict[str, Any]:
    is_printed = experiment.value in OPTIMAL_ENERGY
    return {
        "number": experiment.value,
        "is_printed": is_printed,
        "optimum_J": OPTIMAL_ENERGY[experiment.value].value
        if is_printed
        else implied_wind_optimum(),
        "saving_percent": SAVING[experiment.value].value,
        "adaptive_J": ADAPTIVE_ENERGY[experiment.value].value,
        "flights": [_planned(one) for one in study.flights if one.case.experiment is experiment],
    }


def _planned(flown: PaperFlight) -> dict[str, Any]:
    charge = BATTERY[-1].of(flown.flight.frame)
    return {
        "case": flown.case,
        "energy_J": flown.flight.energy_J,
        "hover_energy_J": flown.hover_energy_J,
        "peak_power_W": POWER.of(flown.flight.frame).max(),
        "battery_percent": charge[0] - charge[-1],
        "status": flown.status.value,
        "is_verified": flown.flight.is_verified,
        "miss_m": flown.flight.terminal_miss_m,
    }


def _controlled(study: PaperStudy, flown: BaselineFlight) -> dict[str, Any]:
    case = flown.case
    optimum = find_flight(study.flights, case.experiment, case.power_model)
    saving, of_excess = baseline_saving(study, flown)
    return {
        "case": case,
        "name": flown.flight.name,
        "spent_J": settled_energy(flown.priced_by(optimum)),
        "optimum_J": optimum.flight.energy_J,
        "hover_J": optimum.hover_energy_J,
        "saving_percent": saving,
        "of_excess_percent": of_excess,
        "printed_J": ADAPTIVE_ENERGY[case.experiment.value].value,
        "printed_percent": SAVING[case.experiment.value].value,
    }


def _by_place(parameters: pd.DataFrame) -> list[tuple[str, list[dict[Any, Any]]]]:
    """Return the paper's numbers by the place where it prints them."""
    places = parameters.groupby("place", sort=False)
    return [(str(place), numbers.to_dict("records")) for place, numbers in places]


def _equations() -> Iterator[dict[str, Any]]:
    """Yield the declared equations in groups, each equation once."""
    seen: set[str] = set()
    for group in _groups():
        fresh = [equation for equation in group["equations"] if equation.latex not in seen]
        seen.update(equation.latex for equation in fresh)
        yield group | {"equations": fresh}


def _groups() -> Iterator[dict[str, Any]]:
    yield {
        "title": "The second experiment, under the electrical power of the motors",
        "power": None,
        "equations": _typeset(),
    }
    for power in _OTHER_POWERS:
        equations = [one for one in _typeset("power.model", power) if one.name.startswith("power.")]
        yield {"power": power, "equations": equations}
    yield {
        "title": "Wind through drag on the relative airspeed",
        "power": None,
        "equations": _typeset("wind.coupling", WindCoupling.DRAG),
    }


def _typeset(field: str = "", value: object = None) -> tuple[TypesetEquation, ...]:
    """Return the equations of the second experiment, with the named field of it changed."""
    return typeset_equations(
        build_model(paper_scenario(Experiment.WIND, {field: value} if field else {}))
    )


def examination(study: PaperStudy) -> dict[str, Any]:
    """Return the numbers of the templates of the conclusion and of the examination."""
    bound, least = map(float, study.floors[Reading.REGULARISED][-1])
    regularised, literal = study.floors[Reading.REGULARISED], study.floors[Reading.LITERAL]
    trials = [outcome for outcome in study.trials if outcome.trial.reading is Reading.LITERAL]
    lowest = min(trials, key=lambda outcome: outcome.energy_J)
    believed = [outcome for outcome in trials if outcome.has_converged]
    # One case may stand in two tables.
    flown = {flight.case: flight for flight in (*study.flights, *study.wind_flights)}.values()
    return {
        "flown": len(flown),
        "confirmed": sum(flight.flight.is_verified for flight in flown),
        "best": find_flight(study.flights, Experiment.CALM, PowerModel.EFFICIENCY),
        "printed_J": OPTIMAL_ENERGY[1].value,
        "printed_bound": _bound_of_printed_optimum(study),
        "largest_bound": bound,
        "least_J": least,
        "critical_acceleration": study.critical_acceleration,
        "critical_speed": study.critical_speed,
        "floors": np.column_stack([regularised, literal[:, 1]]).tolist(),
        "trials": study.trials,
        "lowest": lowest,
        "cheapest": min(believed, key=lambda outcome: outcome.energy_J, default=lowest),
        "adaptive": [_adaptive(study, experiment) for experiment in Experiment],
        "savings": [_saving(study, experiment) for experiment in Experiment],
        "packs": study.packs,
        "kilojoules": kilojoules,
        "metres": metres,
    }


def _bound_of_printed_optimum(study: PaperStudy) -> float:
    """Return the rotor acceleration, rad/s², up to which the literal f_r has the printed floor."""
    bounds, energies = study.floors[Reading.LITERAL].T
    finite = np.isfinite(energies)
    return float(np.interp(-OPTIMAL_ENERGY[1].value, -energies[finite], bounds[finite]))


def _adaptive(study: PaperStudy, experiment: Experiment) -> dict[str, Any]:
    """Return what a printed adaptive flight is judged by."""
    printed = ADAPTIVE_ENERGY[experiment.value].value
    smooth, jump = (
        find_baseline(study, experiment, PowerModel.EFFICIENCY, reference).flight.energy_J
        for reference in _references(study)
    )
    optimum = find_flight(study.flights, experiment, PowerModel.EFFICIENCY)
    return {
        "printed_J": printed,
        "saving_percent": SAVING[experiment.value].value,
        "hover_J": optimum.hover_energy_J,
        "smooth_J": smooth,
        "jump_J": jump,
        "fastest_J": full_speed_energy(experiment),
        "mean_power_W": printed / optimum.case.scenario.mission.fixed_duration,
        "pack_power_W": max(pack.greatest_power_W for pack in study.packs),
    }


def _references(study: PaperStudy) -> tuple[Reference, Reference]:
    has_jump = any(flown.case.reference is Reference.STEP for flown in study.baselines)
    return Reference.QUINTIC, Reference.STEP if has_jump else Reference.QUINTIC


def _saving(study: PaperStudy, experiment: Experiment) -> dict[str, Any]:
    """Return what the optimum saves against the stand-in on a smooth reference."""
    motor, efficiency = (
        find_baseline(study, experiment, model, Reference.QUINTIC)
        for model in (PowerModel.MOTOR, PowerModel.EFFICIENCY)
    )
    by_motor, of_excess = baseline_saving(study, motor)
    by_efficiency, _ = baseline_saving(study, efficiency)
    optimum = find_flight(study.flights, experiment, PowerModel.MOTOR)
    return {
        "experiment": experiment.value,
        "printed_percent": SAVING[experiment.value].value,
        "by_motor_percent": by_motor,
        "of_excess_percent": of_excess,
        "by_efficiency_percent": by_efficiency,
        "spent_J": settled_energy(motor.priced_by(optimum)),
        "optimum_J": optimum.flight.energy_J,
        "hover_J": optimum.hover_energy_J,
    }
