"""The sections of results: experiments, winds, baselines, batteries."""

from pyomo_quad.report.document import Block, Bullets, Code, Heading, Paragraph, Piece, Table
from pyomo_quad.report.paper.numbers import kilojoules, metres
from pyomo_quad.report.paper.tables import baseline_saving, find_flight
from pyomo_quad.report.signals import BATTERY, POWER
from pyomo_quad.report.wording import POWER_WORDS, fixed, yes_no
from pyomo_quad.scenario import PowerModel
from pyomo_quad.study.paper.baseline_flights import BaselineFlight
from pyomo_quad.study.paper.claims import (
    ADAPTIVE_ENERGY,
    OPTIMAL_ENERGY,
    SAVING,
    implied_wind_optimum,
)
from pyomo_quad.study.paper.flights import PaperFlight
from pyomo_quad.study.paper.missions import Experiment
from pyomo_quad.study.paper.study import PaperStudy

__all__ = ["baseline_blocks", "battery_blocks", "experiment_blocks", "wind_blocks"]

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
                    "), and is not told the wind. A saving is the part of the controlled flight's "
                    "energy that the optimum does not spend."
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
    case, spent = flown.case, flown.flight.energy_J
    optimum = find_flight(study.flights, case.experiment, case.power_model)
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
