"""Report on the paper of Yacef et al.: which results are reproduced, and why others are not."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pyomo_quad.model import build_model
from pyomo_quad.model.typeset import EQUATION_TABLE, typeset_equations
from pyomo_quad.paper import tables as paper
from pyomo_quad.paper.experiments import (
    POWER_MODELS,
    Experiment,
    full_speed_energy,
    paper_scenario,
)
from pyomo_quad.paper.figures import floor_drawing, paper_drawings
from pyomo_quad.paper.readings import Reading
from pyomo_quad.paper.study import PaperStudy
from pyomo_quad.report import Figures
from pyomo_quad.report.document import write_study
from pyomo_quad.report.report import climb_of
from pyomo_quad.scenario import PowerModel, Reference, WindCoupling

_OTHER_POWERS = tuple(model for model in POWER_MODELS if model is not PowerModel.MOTOR)
_THROUGH_DRAG = {"wind.coupling": WindCoupling.DRAG}


class Tolerance(NamedTuple):
    """Largest relative difference permitted between a recomputed table and the original table.

    When the study is repeated, for example on another machine, its tables are compared with the
    tables in the repository.

    Attributes
    ----------
    table : str
        Name of the table.
    columns : tuple of str
        Columns to which the tolerance applies.
    relative : float
        The tolerance.
    scope : str
        Rows to which the tolerance applies, in words.
    """

    table: str
    columns: tuple[str, ...]
    relative: float
    scope: str


_CONVERGED = "every flight whose solve converged, also on a coarse mesh"
_PACK_COLUMNS = ("stored_energy_J", "hover_power_W", "greatest_power_W")
TOLERANCES = (
    Tolerance("experiments", ("energy_J", "hover_energy_J"), 1e-4, _CONVERGED),
    Tolerance("wind", ("energy_J", "hover_energy_J"), 1e-4, _CONVERGED),
    Tolerance("baselines", ("energy_J",), 1e-4, "every flight"),
    Tolerance("baselines", ("optimum_J",), 1e-4, _CONVERGED),
    Tolerance("batteries", _PACK_COLUMNS, 1e-6, "every pack"),
    Tolerance("floors", ("floor_J",), 1e-3, "every finite floor"),
)


TIMES_NAME = "timings.json"


def write_paper_report(folder: Path, study: PaperStudy, figures: Figures = Figures.SVG) -> None:
    """Write the report on the paper of Yacef et al.: `report.md`, tables and figures.

    `folder` exists and holds no report. Equal results give identical files, except for the wall
    times, which have a separate file.
    """
    tables = paper.paper_tables(study)
    optimum = paper.find_flight(study.flights, Experiment.CALM, PowerModel.MOTOR)
    write_study(
        folder,
        "paper/report.md.j2",
        tables={f"{name}.csv": frame for name, frame in tables.items()},
        drawings=(*paper_drawings(study), floor_drawing(study)),
        figures=figures,
        **{**examination(study), **paper.corrections(study)},
        rows={name: frame.to_dict("records") for name, frame in tables.items()},
        optimum=optimum,
        climb_J=climb_of(optimum.case.scenario)[1],
        equations=list(_equations()),
        EQUATION_TABLE=EQUATION_TABLE,
        paper=paper,
        TOLERANCES=TOLERANCES,
        TIMES_NAME=TIMES_NAME,
    )
    seconds = {name: round(taken, 3) for name, taken in study.seconds.items()}
    (folder / TIMES_NAME).write_text(json.dumps(seconds, indent=2) + "\n", encoding="utf-8")


def _equations() -> Iterator[dict[str, Any]]:
    """Yield the model's equations for the flight in wind, typeset in groups for the report.

    A group has the items `title` (heading or None), `power` (power model or None) and `equations`.
    """
    seen: set[str] = set()
    groups: tuple[tuple[str | None, PowerModel | None, dict[str, Any]], ...] = (
        ("The second experiment, under the electrical power of the motors", None, {}),
        *((None, power, {"power.model": power}) for power in _OTHER_POWERS),
        ("Wind through drag on the relative airspeed", None, _THROUGH_DRAG),
    )
    for title, power, values in groups:
        equations = [
            equation
            for equation in typeset_equations(build_model(paper_scenario(Experiment.WIND, values)))
            # Each equation is listed once, in the first group to which it belongs.
            if equation.latex not in seen and (power is None or equation.name.startswith("power."))
        ]
        seen.update(equation.latex for equation in equations)
        yield {"title": title, "power": power, "equations": equations}


def examination(study: PaperStudy) -> dict[str, Any]:
    """Compare the study's results with the claims of Yacef et al., for the report.

    Parameters
    ----------
    study : PaperStudy
        Results of the study.

    Returns
    -------
    dict
        Numbers and results by name. The template of the report's text inserts them by these names.
    """
    bound, least = map(float, study.floors[Reading.REGULARISED][-1])
    regularised, literal = study.floors[Reading.REGULARISED], study.floors[Reading.LITERAL]
    trials = [outcome for outcome in study.trials if outcome.trial.reading is Reading.LITERAL]
    lowest = min(trials, key=lambda outcome: outcome.energy_J)
    believed = [outcome for outcome in trials if outcome.has_converged]
    # The same case may appear in two tables.
    flown = {flight.case: flight for flight in (*study.flights, *study.wind_flights)}.values()
    return {
        "flown": len(flown),
        "confirmed": sum(flight.flight.is_verified for flight in flown),
        "best": paper.find_flight(study.flights, Experiment.CALM, PowerModel.EFFICIENCY),
        "printed_J": paper.OPTIMAL_ENERGY[1],
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
        "kilojoules": paper.kilojoules,
        "metres": paper.metres,
    }


def _bound_of_printed_optimum(study: PaperStudy) -> float:
    """Return the rotor-acceleration bound that yields the energy printed by Yacef et al. [rad/s²].

    Within this bound, the least energy of any flight under `Reading.LITERAL` is the printed energy
    of the optimal flight.
    """
    bounds, energies = study.floors[Reading.LITERAL].T
    finite = np.isfinite(energies)
    # Least energies decrease with the bound; `interp` needs increasing values.
    return float(np.interp(-paper.OPTIMAL_ENERGY[1], -energies[finite], bounds[finite]))


def _adaptive(study: PaperStudy, experiment: Experiment) -> dict[str, Any]:
    """Return numbers to compare with the energy that Yacef et al. print for adaptive control.

    The template of the report's text inserts the numbers by their names.
    """
    has_jump = any(flown.case.reference is Reference.STEP for flown in study.baselines)
    # Reference trajectories: a smooth one, and one that jumps to the goal if the study has it.
    references = Reference.QUINTIC, Reference.STEP if has_jump else Reference.QUINTIC
    smooth, jump = (
        paper.find_baseline(study, experiment, PowerModel.EFFICIENCY, reference).flight.energy_J
        for reference in references
    )
    optimum = paper.find_flight(study.flights, experiment, PowerModel.EFFICIENCY)
    printed = paper.ADAPTIVE_ENERGY[experiment.value]
    return {
        "printed_J": printed,
        "saving_percent": paper.SAVING[experiment.value],
        "hover_J": optimum.hover_energy_J,
        "smooth_J": smooth,
        "jump_J": jump,
        "fastest_J": full_speed_energy(experiment),
        # The mean power that the printed energy implies, and the greatest power of any battery.
        "mean_power_W": printed / optimum.case.scenario.mission.fixed_duration,
        "pack_power_W": max(pack.greatest_power_W for pack in study.packs),
    }


def _saving(study: PaperStudy, experiment: Experiment) -> dict[str, Any]:
    """Return the report's row that compares optimal and controlled flight of an experiment.

    Energies are integrals of the motors' electrical power. Only the saving `by_efficiency_percent`
    uses the power model of Yacef et al.: shaft power divided by f_r, the efficiency of motor and
    rotor.
    """
    by_motor, by_efficiency = (
        paper.baseline_row(study, paper.find_baseline(study, experiment, model, Reference.QUINTIC))
        for model in (PowerModel.MOTOR, PowerModel.EFFICIENCY)
    )
    return by_motor | {"by_efficiency_percent": by_efficiency["saving_percent"]}
