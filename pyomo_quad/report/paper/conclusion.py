"""What is reproduced, what is not, and why, in the run's own numbers."""

from pyomo_quad.report.document import Block, Bullets, Heading, Piece, Strong
from pyomo_quad.report.paper.examination import bound_of_printed_optimum, least_regularised_floor
from pyomo_quad.report.paper.numbers import kilojoules
from pyomo_quad.report.paper.tables import baseline_saving, find_baseline, find_flight
from pyomo_quad.scenario import PowerModel, Reference
from pyomo_quad.study.paper.baseline_flights import full_speed_energy
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
                _adaptive(study, Experiment.CALM),
                _adaptive(study, Experiment.WIND),
                _saving(study, Experiment.CALM),
                _saving(study, Experiment.WIND),
                _battery(study),
            )
        ),
    )


def _problem(study: PaperStudy) -> tuple[Piece, ...]:
    # One case may stand in two tables.
    flown = {flight.case: flight for flight in (*study.flights, *study.wind_flights)}.values()
    good = sum(flight.flight.is_verified for flight in flown)
    return (
        Strong("Reproduced: the problem."),
        " ",
        (
            f"Model, wind, limits and both experiments are declared and solved; {good} of "
            f"{len(flown)} distinct planned flights are confirmed: flown by another integrator "
            "they arrive as planned, on a battery that can feed them."
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


def _adaptive(study: PaperStudy, experiment: Experiment) -> tuple[Piece, ...]:
    """Judge a printed adaptive flight by what the rotors can draw and what a pack can give."""
    printed = ADAPTIVE_ENERGY[experiment.value].value
    smooth, jump = (
        find_baseline(study, experiment, PowerModel.EFFICIENCY, reference).flight.energy_J
        for reference in _references(study)
    )
    optimum = find_flight(study.flights, experiment, PowerModel.EFFICIENCY)
    hovering, fastest = optimum.hover_energy_J, full_speed_energy(experiment)
    mean_power = printed / optimum.case.scenario.mission.duration
    pack = max(study.packs, key=lambda facts: facts.greatest_power_W)
    word, side = ("Plausible", "more") if printed <= fastest else ("Not plausible", "less")
    return (
        Strong(f"{word}: the adaptive flight of {kilojoules(printed, 2)} kJ."),
        " ",
        (
            f"It is the base of the {SAVING[experiment.value].value} % and "
            f"{100 * (printed / hovering - 1):.0f} % above hovering under f_r; the stand-in "
            f"takes {kilojoules(smooth)} kJ along a smooth reference and {kilojoules(jump)} kJ "
            f"after a jump. All rotors steady at their greatest speed would take "
            f"{kilojoules(fastest)} kJ, {side} than is printed, whose mean of {mean_power:.0f} W "
            f"compares with the {pack.greatest_power_W:.0f} W that the strongest pack here gives. "
            "The controller's gains are not published."
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
