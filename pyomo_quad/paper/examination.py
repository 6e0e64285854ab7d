"""Why the paper's numbers cannot be those of any flight: the numbers behind the argument."""

from typing import Any

import numpy as np

from pyomo_quad.paper.claims import ADAPTIVE_ENERGY, OPTIMAL_ENERGY, SAVING
from pyomo_quad.paper.experiments import Experiment, Reading, full_speed_energy
from pyomo_quad.paper.study import PaperStudy
from pyomo_quad.paper.tables import baseline_saving, find_baseline, find_flight, kilojoules, metres
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


def examination(study: PaperStudy) -> dict[str, Any]:
    """Return the numbers of the templates of the conclusion and of the examination."""
    bound, least = least_regularised_floor(study)
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
        "printed_bound": bound_of_printed_optimum(study),
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
