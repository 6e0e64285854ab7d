"""What is reproduced, what is not, and why, in the run's own numbers."""

from pyomo_quad.report.document import Block, Bullets, Heading, Piece, Strong
from pyomo_quad.report.paper.examination import bound_of_printed_optimum, least_regularised_floor
from pyomo_quad.report.paper.numbers import kilojoules
from pyomo_quad.report.paper.tables import baseline_saving, find_baseline, find_flight
from pyomo_quad.scenario import PowerModel, Reference
from pyomo_quad.study.paper.claims import ADAPTIVE_ENERGY, OPTIMAL_ENERGY, SAVING
from pyomo_quad.study.paper.missions import Experiment
from pyomo_quad.study.paper.study import PaperStudy

__all__ = ["conclusion_blocks"]


def conclusion_blocks(study: PaperStudy) -> tuple[Block, ...]:
    """Return the conclusion.

    Parameters
    ----------
    study : PaperStudy
        The results.

    Returns
    -------
    tuple of Block
        Heading and list.
    """
    return (
        Heading("Conclusion"),
        Bullets(
            (
                _problem(study),
                _optimum(study),
                _adaptive(study),
                _saving(study, Experiment.CALM),
                _saving(study, Experiment.WIND),
                _battery(study),
            )
        ),
    )


def _problem(study: PaperStudy) -> tuple[Piece, ...]:
    flown = (*study.flights, *study.wind_flights)
    good = sum(flight.flight.is_verified for flight in flown)
    return (
        Strong("Reproduced: the problem."),
        " ",
        (
            f"Model, wind, limits and both experiments are declared and solved; {good} of "
            f"{len(flown)} planned flights arrive as planned when flown by another integrator."
        ),
    )


def _optimum(study: PaperStudy) -> tuple[Piece, ...]:
    best = find_flight(study.flights, Experiment.CALM, PowerModel.EFFICIENCY)
    bound, floor = least_regularised_floor(study)
    printed = kilojoules(OPTIMAL_ENERGY[1].value, 2)
    return (
        Strong(f"Not reproduced: the optimum of {printed} kJ."),
        " ",
        (
            f"The best flight found under f_r takes {kilojoules(best.flight.energy_J)} kJ, "
            f"hovering {kilojoules(best.hover_energy_J)} kJ, and no flight whatever less than "
            f"{kilojoules(floor)} kJ with |alpha| up to {bound:.0f} rad/s² under regularised f_r. "
            f"With literal f_r {printed} kJ is the floor near "
            f"{bound_of_printed_optimum(study):.0f} rad/s², and above "
            f"{study.critical_acceleration:.0f} rad/s² there is no minimum."
        ),
    )


def _adaptive(study: PaperStudy) -> tuple[Piece, ...]:
    printed = ADAPTIVE_ENERGY[1].value
    smooth, jump = (
        find_baseline(study, Experiment.CALM, PowerModel.EFFICIENCY, reference).flight.energy_J
        for reference in _references(study)
    )
    hovering = find_flight(study.flights, Experiment.CALM, PowerModel.EFFICIENCY).hover_energy_J
    return (
        Strong(f"Plausible: the adaptive flight of {kilojoules(printed, 2)} kJ."),
        " ",
        (
            f"It is {100 * (printed / hovering - 1):.0f} % above hovering under f_r; the stand-in "
            f"takes {kilojoules(smooth)} kJ along a smooth reference and {kilojoules(jump)} kJ "
            "after a jump. Its gains are not published."
        ),
    )


def _references(study: PaperStudy) -> tuple[Reference, Reference]:
    has_jump = any(flown.case.reference is Reference.STEP for flown in study.baselines)
    return Reference.QUINTIC, Reference.STEP if has_jump else Reference.QUINTIC


def _saving(study: PaperStudy, experiment: Experiment) -> tuple[Piece, ...]:
    printed = SAVING[experiment.value].value
    motor, efficiency = (
        find_baseline(study, experiment, model, Reference.QUINTIC)
        for model in (PowerModel.MOTOR, PowerModel.EFFICIENCY)
    )
    by_motor, of_excess = baseline_saving(study, motor)
    by_efficiency, _ = baseline_saving(study, efficiency)
    optimum = find_flight(study.flights, experiment, PowerModel.MOTOR)
    return (
        Strong(f"Not reproduced: the saving of {printed} % in experiment {experiment.value}."),
        " ",
        (
            f"Against the stand-in on a smooth reference the optimum saves {by_motor:.2f} % under "
            f"the motors' power ({motor.flight.energy_J:.2f} to {optimum.flight.energy_J:.2f} J, "
            f"hovering {optimum.hover_energy_J:.2f} J), which is {of_excess:.0f} % of what is "
            f"spent above hovering, and {by_efficiency:.2f} % under f_r. Both flights pay for "
            "hovering, which no path can save."
        ),
    )


def _battery(study: PaperStudy) -> tuple[Piece, ...]:
    cell = study.packs[0]
    return (
        Strong("Not possible: the paper's cell."),
        " ",
        (
            f"One cell as printed delivers at most {cell.greatest_power_W:.1f} W and hovering "
            f"takes {cell.hover_power_W:.1f} W; with {study.packs[1].cells_series} in series, or "
            "the vehicle's own pack, the flight is possible under the motors' power."
        ),
    )
