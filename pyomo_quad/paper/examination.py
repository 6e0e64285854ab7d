"""Why the paper's numbers cannot be those of any flight: what is reproduced, what is not."""

import numpy as np

from pyomo_quad.paper.claims import ADAPTIVE_ENERGY, OPTIMAL_ENERGY, SAVING
from pyomo_quad.paper.experiments import Experiment, Reading, full_speed_energy
from pyomo_quad.paper.study import PaperStudy
from pyomo_quad.paper.tables import baseline_saving, find_baseline, find_flight, kilojoules, metres
from pyomo_quad.report.render import (
    Block,
    Bullets,
    Heading,
    Paragraph,
    Piece,
    Strong,
    Table,
    fixed,
    yes_no,
)
from pyomo_quad.scenario import PowerModel, Reference
from pyomo_quad.study.comparison import settled_energy


def bound_of_printed_optimum(study: PaperStudy) -> float:
    """Return the bound on the rotor acceleration at which the printed optimum is the least energy.

    Parameters
    ----------
    study : PaperStudy
        Has the floors under the literal f_r.

    Returns
    -------
    float
        rad/s², between the two bounds of the table that enclose it.
    """
    bounds, energies = study.floors[Reading.LITERAL].T
    finite = np.isfinite(energies)
    return float(np.interp(-OPTIMAL_ENERGY[1].value, -energies[finite], bounds[finite]))


def least_regularised_floor(study: PaperStudy) -> tuple[float, float]:
    """Return the largest bound of the table and the floor there, with regularised f_r.

    Parameters
    ----------
    study : PaperStudy
        Has the floors.

    Returns
    -------
    bound, energy : float
        rad/s² and J.
    """
    bound, energy = study.floors[Reading.REGULARISED][-1]
    return float(bound), float(energy)


def examination_blocks(study: PaperStudy) -> tuple[Block, ...]:
    """Return the study of the problem under f_r: bound, mesh, and no minimum.

    Parameters
    ----------
    study : PaperStudy
        The results.

    Returns
    -------
    tuple of Block
        Heading, text and two tables; the figure follows them.
    """
    return (
        Heading("Why 1.89 kJ is below the hover floor".replace("1.89", _printed())),
        *_argument(study),
        _floor_table(study),
        Paragraph(_mesh_text(study)),
        _mesh_table(study),
    )


def _printed() -> str:
    return kilojoules(OPTIMAL_ENERGY[1].value, 2)


def _argument(study: PaperStudy) -> tuple[Block, ...]:
    return (_hover_is_no_floor(study), _envelope_floor(), _literal_floor(study))


def _hover_is_no_floor(study: PaperStudy) -> Paragraph:
    hovering = find_flight(study.flights, Experiment.CALM, PowerModel.EFFICIENCY).hover_energy_J
    return Paragraph(
        (
            (
                f"Under the recovered f_r, hovering for the mission's time takes "
                f"{kilojoules(hovering)} kJ, so the printed {_printed()} kJ is "
                f"{100 * OPTIMAL_ENERGY[1].value / hovering:.0f} % of not moving at all. "
            ),
            (
                "Steady hover is no floor under f_r, though: f_r rises with the rotor speed, so "
                "turning fast and slowly in turn is cheaper than turning evenly, and below some "
                "speed so is accelerating and coasting in turn."
            ),
        )
    )


def _envelope_floor() -> Paragraph:
    return Paragraph(
        (
            Strong("A floor for every flight under one reading of f_r and one bound on |alpha|."),
            " ",
            (
                "From hover to hover each rotor passes every speed upward as much as "
                "downward, so at each speed its mean acceleration is zero, and its mean "
                "power there is at least the convex envelope of the power over the "
                "accelerations allowed, taken at zero. The mean vertical thrust is the "
                "weight, so the mean power is at least the convex envelope of that over the "
                "thrust, taken at the weight. Rotors come near this floor only by alternating "
                "ever faster, and no flight reaches it."
            ),
        )
    )


def _literal_floor(study: PaperStudy) -> Paragraph:
    largest, least = least_regularised_floor(study)
    critical = study.critical_acceleration
    side = "below" if OPTIMAL_ENERGY[1].value < least else "not below"
    return Paragraph(
        (
            (
                "With f_r regularised as declared (read at no torque below zero, floored, no "
                f"credit for braking) the floor falls with the bound on |alpha|, to "
                f"{kilojoules(least)} kJ at {largest:.0f} rad/s²: with f_r so regularised and "
                f"|alpha| at most {largest:.0f} rad/s² the printed energy is {side} what any "
                "flight can do. Of a larger bound or another reading of f_r this says nothing. "
            ),
            (
                "With f_r as it stands in eq. (8) it passes zero for braking torques: first "
                f"at |alpha| = {critical:.0f} rad/s², at a rotor speed of "
                f"{study.critical_speed:.0f} rad/s. There a braking rotor earns without "
                "limit, and from that bound on the literal problem has no minimum. The paper "
                f"states no bound. The literal floor passes the printed {_printed()} kJ near "
                f"|alpha| = {bound_of_printed_optimum(study):.0f} rad/s²: on the slope of "
                "that fall any number can come out, and which one is a matter of bound and "
                "mesh."
            ),
        )
    )


def _floor_table(study: PaperStudy) -> Table:
    regularised, literal = study.floors[Reading.REGULARISED], study.floors[Reading.LITERAL]
    rows = [
        [f"{bound:.0f}", kilojoules(lower), kilojoules(lowest)]
        for (bound, lower), (_, lowest) in zip(regularised, literal, strict=True)
    ]
    return Table(
        caption="Least energy of any flight of the mission against the bound on |alpha|",
        header=("bound rad/s²", "regularised f_r, kJ", "literal f_r, kJ"),
        rows=rows,
        numeric=frozenset(range(3)),
    )


def _mesh_text(study: PaperStudy) -> tuple[str, ...]:
    literal = [o for o in study.trials if o.trial.reading is Reading.LITERAL]
    lowest = min(literal, key=lambda outcome: outcome.energy_J)
    believed = [o for o in literal if o.has_converged]
    cheapest = min(believed, key=lambda outcome: outcome.energy_J, default=lowest)
    outcome = "converged" if cheapest.has_converged else "stopped"
    return (
        "The same problem given to the optimiser on fixed meshes, started at hover. ",
        (
            f"With literal f_r the solver {outcome} at {kilojoules(cheapest.energy_J)} kJ on "
            f"{cheapest.trial.elements} elements with |alpha| at most {cheapest.trial.bound:.0f} "
            f"rad/s², and its controls, flown, miss the goal by {metres(cheapest.miss_m)} m; the "
            f"lowest number it reached is {kilojoules(lowest.energy_J)} kJ. "
        ),
        (
            "Other meshes leave it near hover, where the cost is flat. An energy under literal f_r "
            "therefore tells of the mesh and of the first guess, not of the vehicle."
        ),
    )


def _mesh_table(study: PaperStudy) -> Table:
    rows = [
        [
            outcome.trial.reading.value,
            f"{outcome.trial.bound:.0f}",
            str(outcome.trial.elements),
            kilojoules(outcome.energy_J),
            yes_no(outcome.has_converged),
            kilojoules(outcome.flown_energy_J),
            metres(outcome.miss_m),
        ]
        for outcome in study.trials
    ]
    degree = study.trials[0].trial.degree
    return Table(
        caption=f"Experiment 1 under f_r on equal elements of degree {fixed(degree, 0)}; n/a: f_r "
        "passes zero on the way and the flown energy has no value",
        header=(
            "f_r",
            "bound rad/s²",
            "elements",
            "optimum kJ",
            "converged",
            "flown kJ",
            "misses goal by m",
        ),
        rows=rows,
        numeric=frozenset({1, 2, 3, 5, 6}),
    )


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
    spent = settled_energy(motor.priced_by(optimum))
    return (
        Strong(f"Not reproduced: the saving of {printed} % in experiment {experiment.value}."),
        " ",
        (
            f"Against the stand-in on a smooth reference the optimum saves {by_motor:.2f} % under "
            f"the motors' power ({spent:.2f} to {optimum.flight.energy_J:.2f} J, "
            f"hovering {optimum.hover_energy_J:.2f} J), which is {of_excess:.0f} % of what is "
            f"spent above hovering, and {by_efficiency:.2f} % under f_r, as flown. Both flights "
            "pay for hovering, which no path can save."
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
