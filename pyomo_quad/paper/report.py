"""The report on the paper: what is reproduced, what is not, and why, in the run's own numbers."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from pyomo_quad.model import build_model
from pyomo_quad.model.typeset import EQUATION_TABLE, TypesetEquation, typeset_equations
from pyomo_quad.paper.claims import (
    ADAPTIVE_ENERGY,
    OPTIMAL_ENERGY,
    SAVING,
    corrections,
    implied_wind_optimum,
)
from pyomo_quad.paper.examination import conclusion_blocks, examination_blocks
from pyomo_quad.paper.experiments import BaselineFlight, Experiment, PaperFlight, paper_scenario
from pyomo_quad.paper.figures import floor_drawing, paper_drawings
from pyomo_quad.paper.study import PaperStudy
from pyomo_quad.paper.tables import (
    TABLES,
    baseline_saving,
    find_flight,
    kilojoules,
    metres,
    paper_tables,
)
from pyomo_quad.report.gallery import save_drawings
from pyomo_quad.report.render import (
    FIGURE_FOLDER,
    POWER_WORDS,
    Block,
    Bullets,
    Code,
    Document,
    Heading,
    Paragraph,
    Piece,
    Table,
    escape_markdown,
    fixed,
    render_markdown,
    yes_no,
)
from pyomo_quad.report.report import REPORT_NAME
from pyomo_quad.report.style import BATTERY, POWER
from pyomo_quad.report.tables import write_table
from pyomo_quad.scenario import PowerModel, WindCoupling
from pyomo_quad.study.comparison import settled_energy

_OTHER_POWERS = tuple(model for model in PowerModel if model is not PowerModel.MOTOR)


def equation_table() -> Table:
    """Return the table from the paper's equation numbers to the functions that declare them.

    Returns
    -------
    Table
        One row for each equation.
    """
    rows: list[list[Piece]] = [
        [f"({number})", Code(function)]
        for number, functions in EQUATION_TABLE.items()
        for function in functions
    ]
    return Table(
        caption="Where each equation of the paper is declared",
        header=("equation", "declared by"),
        rows=rows,
    )


def equations_markdown() -> str:
    """Return the declared equations, each written by the program from its Pyomo declaration.

    Returns
    -------
    str
        Markdown with formulas between double dollar signs.
    """
    parts = [
        "## Declared equations",
        (
            "Every formula below is written by the program from the Pyomo declaration that "
            "optimiser and simulator read; a text beside a formula is that declaration's own."
        ),
    ]
    seen: set[str] = set()
    for title, equations in _groups():
        fresh = [equation for equation in equations if equation.latex not in seen]
        seen.update(equation.latex for equation in fresh)
        parts.append(f"### {escape_markdown(title)}")
        parts += [_equation(equation) for equation in fresh]
    return "\n\n".join(parts) + "\n"


def _groups() -> Iterator[tuple[str, tuple[TypesetEquation, ...]]]:
    yield (
        "The second experiment, under the electrical power of the motors",
        typeset_equations(build_model(paper_scenario(Experiment.WIND))),
    )
    for power in _OTHER_POWERS:
        scenario = paper_scenario(Experiment.WIND, {"power.model": power})
        equations = typeset_equations(build_model(scenario))
        of_power = tuple(equation for equation in equations if equation.name.startswith("power."))
        yield f"Power: {POWER_WORDS[power]}", of_power
    drag = paper_scenario(Experiment.WIND, {"wind.coupling": WindCoupling.DRAG})
    yield "Wind through drag on the relative airspeed", typeset_equations(build_model(drag))


def _equation(equation: TypesetEquation) -> str:
    description = escape_markdown(equation.description or equation.name)
    return f"{description} (`{equation.name}`)\n\n$$\n{equation.latex}\n$$"


_FLIGHT_HEADER = (
    "energy J",
    "hover floor J",
    "above it J",
    "peak power W",
    "battery %",
    "solve",
    "flown as planned",
)


def experiment_blocks(study: PaperStudy) -> tuple[Block, ...]:
    """Return both experiments under every power model.

    Parameters
    ----------
    study : PaperStudy
        The results.

    Returns
    -------
    tuple of Block
        Heading, text and one table for each experiment.
    """
    optimum = find_flight(study.flights, Experiment.CALM, PowerModel.MOTOR)
    climb = _potential_energy(optimum)
    tables = tuple(_experiment_table(study, experiment) for experiment in Experiment)
    excess = optimum.flight.energy_J - optimum.hover_energy_J
    return (
        Heading("Both experiments under every power model"),
        Paragraph(
            (
                (
                    "Energy, hover floor (hovering for the same time under the same power model) "
                    "and what is spent above it. "
                ),
                (
                    f"The mission climbs, which adds {climb:.1f} J of potential energy, yet the "
                    f"optimum spends only {excess:.2f} J above hovering under the motors' power: "
                    "the paper's thrust and drag torque do not depend on the airspeed, so climbing "
                    "is free in its model."
                ),
            )
        ),
        *tables,
        Paragraph(
            (
                (
                    "Where a solve did not converge, the row is the best flight found from the "
                    "optimum of the motors' power; under f_r none can prove an optimum (see "
                    "below). A flight counts as flown as planned when its controls, integrated "
                    "by another method, end where planned, keep the limits and spend the energy "
                    "stated."
                ),
            )
        ),
    )


def wind_blocks(study: PaperStudy) -> tuple[Block, ...]:
    """Return the second experiment in every reading of the wind.

    Parameters
    ----------
    study : PaperStudy
        The results.

    Returns
    -------
    tuple of Block
        Heading and table.
    """
    rows = [
        [flown.case.coupling.value, flown.case.frequency_unit.value, *_cells(flown)]
        for flown in study.wind_flights
    ]
    table = Table(
        caption="Experiment 2 under the motors' electrical power",
        header=("coupling", "frequencies in", *_FLIGHT_HEADER),
        rows=rows,
        numeric=frozenset(range(2, 7)),
    )
    return (
        Heading("The wind in every reading"),
        Paragraph(
            (
                (
                    "Eq. (9) adds the wind's velocity to an acceleration, and Table 2 gives in Hz "
                    "what eq. (11) uses in rad/s. Each row is one way to read this."
                ),
            )
        ),
        table,
    )


def baseline_blocks(study: PaperStudy) -> tuple[Block, ...]:
    """Return the controlled flights beside the paper's percentages.

    Parameters
    ----------
    study : PaperStudy
        The results.

    Returns
    -------
    tuple of Block
        Heading, text and table.
    """
    rows = [_baseline_row(study, flown) for flown in study.baselines]
    header = ("experiment", "power", "flight", "energy J", "optimum J", "hover floor J")
    savings = ("saving %", "of what is above hover %", "paper: adaptive kJ", "paper: saving %")
    return (
        Heading("The adaptive controller beside the optimum"),
        Paragraph(
            (
                (
                    "The paper's controller is cited without gains or reference. The stand-in is "
                    "an adaptive backstepping law; it follows a smooth reference ("
                ),
                Code("quintic"),
                ") or a jump to the goal (",
                Code("step"),
                (
                    "), and is not told the wind. A controlled flight is charged what its end "
                    "state still owes, where an optimum prices it, which f_r has not; a saving is "
                    "the part of that sum which the optimum does not spend."
                ),
            )
        ),
        Table(
            caption="Controlled flights and what the optimum saves",
            header=(*header, *savings),
            rows=rows,
            numeric=frozenset(range(3, 10)),
        ),
    )


def _baseline_row(study: PaperStudy, flown: BaselineFlight) -> list[Piece]:
    case = flown.case
    optimum = find_flight(study.flights, case.experiment, case.power_model)
    spent = settled_energy(flown.priced_by(optimum))
    saving, of_excess = baseline_saving(study, flown)
    return [
        str(case.experiment.value),
        Code(case.power_model.value),
        Code(flown.flight.name),
        fixed(spent),
        fixed(optimum.flight.energy_J),
        fixed(optimum.hover_energy_J),
        fixed(saving),
        fixed(of_excess, 1),
        kilojoules(ADAPTIVE_ENERGY[case.experiment.value].value, 2),
        f"{SAVING[case.experiment.value].value:.2f}",
    ]


def battery_blocks(study: PaperStudy) -> tuple[Block, ...]:
    """Return what the packs hold, and what they lack.

    Parameters
    ----------
    study : PaperStudy
        The results.

    Returns
    -------
    tuple of Block
        Heading, table, warnings.
    """
    rows: list[list[Piece]] = [
        [
            Code(pack.battery),
            f"{pack.cells_series} x {pack.cells_parallel}",
            Code(pack.power_model.value),
            kilojoules(pack.stored_energy_J, 1),
            kilojoules(pack.hover_energy_J, 2),
            f"{pack.hover_power_W:.1f}",
            f"{pack.greatest_power_W:.1f}",
            yes_no(not pack.shortfalls),
        ]
        for pack in study.packs
    ]
    header = ("battery", "cells", "power", "stored kJ", "hovering 10 s kJ")
    warnings = [[f"Warning: {line}"] for pack in study.packs for line in pack.shortfalls]
    return (
        Heading("The battery, both sets"),
        Table(
            caption="Packs and the hover they are asked for",
            header=(*header, "hover power W", "greatest power W", "suffices"),
            rows=rows,
            numeric=frozenset(range(3, 7)),
        ),
        Bullets(warnings),
    )


def _experiment_table(study: PaperStudy, experiment: Experiment) -> Table:
    printed = OPTIMAL_ENERGY[1].value if experiment is Experiment.CALM else implied_wind_optimum()
    origin = "printed" if experiment is Experiment.CALM else f"implied by its {SAVING[2].value} %"
    flights = [flown for flown in study.flights if flown.case.experiment is experiment]
    rows: list[list[Piece]] = [
        [Code(flown.case.power_model.value), POWER_WORDS[flown.case.power_model], *_cells(flown)]
        for flown in flights
    ]
    return Table(
        caption=f"Experiment {experiment.value}; the paper's optimum is "
        f"{kilojoules(printed, 2)} kJ ({origin}), its adaptive flight "
        f"{kilojoules(ADAPTIVE_ENERGY[experiment.value].value, 2)} kJ",
        header=("model", "power", *_FLIGHT_HEADER),
        rows=rows,
        numeric=frozenset(range(2, 7)),
    )


def _cells(flown: PaperFlight) -> list[str]:
    frame = flown.flight.frame
    charge = BATTERY[-1].of(frame)
    energy = flown.flight.energy_J
    return [
        fixed(energy),
        fixed(flown.hover_energy_J),
        fixed(energy - flown.hover_energy_J),
        f"{POWER.of(frame).max():.1f}",
        f"{charge[0] - charge[-1]:.3f}",
        flown.status.value.replace("_", " "),
        f"yes, within {metres(flown.flight.terminal_miss_m)} m"
        if flown.flight.is_verified
        else "no",
    ]


def _potential_energy(flown: PaperFlight) -> float:
    scenario = flown.case.scenario
    mission = scenario.mission
    climb = mission.goal.position[2] - mission.start.position[2]
    return scenario.vehicle.total_mass * scenario.gravity * climb


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


def write_paper_report(folder: Path, study: PaperStudy) -> None:
    """Write `report.md`, tables and figures of the paper's study.

    Parameters
    ----------
    folder : Path
        An existing folder, empty of reports.
    study : PaperStudy
        The results.

    Notes
    -----
    Two runs write the same bytes, but for the times, which have a file of their own.
    """
    tables = paper_tables(study)
    for name, frame in tables.items():
        write_table(frame, folder / f"{name}.csv")
    drawings, floors = paper_drawings(study), floor_drawing(study)
    save_drawings((*drawings, floors), folder)
    document = Document(
        title="The paper reproduced and examined",
        blocks=(
            *_opening(),
            *conclusion_blocks(study),
            *experiment_blocks(study),
            *wind_blocks(study),
            *baseline_blocks(study),
            *examination_blocks(study),
            floors.picture,
            Heading("The paper's figures"),
            *(drawing.picture for drawing in drawings),
            *battery_blocks(study),
            *_parameter_blocks(tables["parameters"]),
            *_correction_blocks(study),
            Heading("The paper's equations"),
            equation_table(),
            *_closing(),
        ),
    )
    text = f"{render_markdown(document)}\n{equations_markdown()}"
    (folder / REPORT_NAME).write_text(text, encoding="utf-8")
    seconds = {name: round(taken, 3) for name, taken in study.seconds.items()}
    (folder / TIMES_NAME).write_text(json.dumps(seconds, indent=2) + "\n", encoding="utf-8")


def _opening() -> tuple[Block, ...]:
    return (
        Paragraph(
            (
                (
                    "The paper is F. Yacef, N. Rizoug and L. Degaa, Energy-Efficiency Path "
                    "Planning for Quadrotor UAV Under Wind Conditions. Every number below that "
                    "is not marked as the paper's comes from live solves by "
                ),
                Code("pyomo-quad paper"),
                ".",
            )
        ),
    )


def _parameter_blocks(frame: pd.DataFrame) -> tuple[Block, ...]:
    rows: list[list[Piece]] = [
        [str(symbol), f"{printed:g}", f"{used:g}", str(unit), Code(str(field))]
        for symbol, printed, used, unit, field in zip(
            *(frame[name] for name in ("symbol", "printed", "used", "unit", "field")), strict=True
        )
    ]
    blocks: list[Block] = [Heading("The paper's numbers as used")]
    for place in dict.fromkeys(frame["place"]):
        chosen = [row for row, at in zip(rows, frame["place"], strict=True) if at == place]
        blocks.append(
            Table(
                caption=place,
                header=("symbol", "printed", "used", "unit as printed", "field"),
                rows=chosen,
                numeric=frozenset({1, 2}),
            )
        )
    return tuple(blocks)


def _correction_blocks(study: PaperStudy) -> tuple[Block, ...]:
    rows = [[row.paper, row.matter, row.here] for row in corrections(study)]
    return (
        Heading("Corrections"),
        Table(
            caption="Where the paper is wrong or silent",
            header=("the paper", "what is the matter", "what is done here"),
            rows=rows,
        ),
    )


def _closing() -> tuple[Block, ...]:
    rows: list[list[Piece]] = [
        [Code(f"{held.table}.csv"), ", ".join(held.columns), f"{held.relative:g}", held.scope]
        for held in TOLERANCES
    ]
    files: list[list[Piece]] = [[Code(f"{name}.csv"), f": {text}"] for name, text in TABLES.items()]
    files.append([Code(f"{FIGURE_FOLDER}/"), ": the figures as PNG and SVG"])
    files.append([Code(TIMES_NAME), ": what took how long; it alone changes from run to run"])
    return (
        Heading("How far these numbers are held"),
        Paragraph(
            (
                (
                    "A test computes the report anew at reduced cost and fails when a number "
                    "differs from the committed one by more than this. Solves that prove no "
                    "optimum, those of the mesh study, are shown and not held."
                ),
            )
        ),
        Table(
            caption="Largest relative drift",
            header=("table", "columns", "drift", "of"),
            rows=rows,
            numeric=frozenset({2}),
        ),
        Heading("Files"),
        Bullets(files),
    )
