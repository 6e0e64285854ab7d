"""Where the paper is wrong or silent, and what is done about it, with the run's own numbers."""

from dataclasses import dataclass

from pyomo_quad.flight import Planner
from pyomo_quad.scenario import PowerModel
from pyomo_quad.study.paper.claims import (
    ADAPTIVE_ENERGY,
    OPTIMAL_ENERGY,
    SAVING,
    TABLE_1,
    implied_wind_optimum,
)
from pyomo_quad.study.paper.missions import Experiment, paper_scenario
from pyomo_quad.study.paper.study import PaperStudy

__all__ = ["Correction", "corrections"]

_PRINTED_HOVER_SPEED = 912.0  # rad/s, section IV


@dataclass(frozen=True, kw_only=True)
class Correction:
    """A statement of the paper, what is the matter with it, and what is done here."""

    paper: str
    matter: str
    here: str


def corrections(study: PaperStudy) -> tuple[Correction, ...]:
    """Return the corrections in the order of the paper's matters.

    Parameters
    ----------
    study : PaperStudy
        Gives the numbers.

    Returns
    -------
    tuple of Correction
        One row of a table each.
    """
    return (*_of_equations(), *_of_numbers(), *_of_the_problem(study), *_of_results())


def _of_equations() -> tuple[Correction, ...]:
    return (
        Correction(
            paper="eq. (9): G = I_f⁻¹ [ẋ10, ẋ8, 0]",
            matter="contradicts eq. (6) in the sign and in the order of the derivatives",
            here="eq. (6): I_r θ' ϖ in roll, minus I_r φ' ϖ in pitch",
        ),
        Correction(
            paper="cost: double sum over j and l",
            matter="pairs every rotor with every speed",
            here="one sum over the four rotors, as in eq. (8)",
        ),
        Correction(
            paper="eq. (9): + W, W a velocity",
            matter="m/s added to m/s²",
            here="acceleration (as printed, times a coefficient of 1 1/s) or drag (relative "
            "airspeed), selectable",
        ),
        Correction(
            paper="eq. (10): |u_k| ≤ u_max, k = 1, 2, 3",
            matter="u_1 has its own limit already",
            here="k = 2, 3, 4",
        ),
        Correction(
            paper="eq. (4): ∫ i dt against Q in Ah",
            matter="seconds against hours",
            here="ampere-seconds over 3600, by declared units",
        ),
    )


def _of_numbers() -> tuple[Correction, ...]:
    printed = next(float(n.printed) for n in TABLE_1 if n.field == "vehicle.torque_constant")
    scenario = paper_scenario(Experiment.CALM)
    torque_constant, per_volt = scenario.vehicle.torque_constant, scenario.vehicle.voltage_constant
    steady = Planner().steady_flight(scenario.with_values({"power.model": PowerModel.SHAFT}))
    at_hover = steady.hover
    current = at_hover.power_W / 4 / at_hover.rotor_speed_rad_per_s / printed
    weight = scenario.vehicle.total_mass * scenario.gravity
    lack = 100 * (1 - float(steady.thrust(_PRINTED_HOVER_SPEED)) / weight)
    return (
        Correction(
            paper=f"Table 1: k_t = {printed:g} N m/A",
            matter=f"{current:.0f} A per motor at hover; k_t must equal 1/k_v = {1 / per_volt:.5f}",
            here=f"k_t = {torque_constant:g} N m/A, the printed digits: k_t k_v = "
            f"{torque_constant * per_volt:.4f}, and Figure 1 shows what that leaves over",
        ),
        Correction(
            paper=f"ω_h = {_PRINTED_HOVER_SPEED:g} rad/s",
            matter=f"carries {lack:.2f} % less than the weight: not an equilibrium",
            here=f"sqrt(m g / 4 κ_b) = {at_hover.rotor_speed_rad_per_s:.3f} rad/s",
        ),
        Correction(
            paper="Table 2: Ω_k in Hz, eq. (11): sin(Ω_k t)",
            matter="unit and formula differ by 2π",
            here="the formula as printed (rad/s) by default, Hz selectable; both are rows of the "
            "table of readings",
        ),
    )


def _of_the_problem(study: PaperStudy) -> tuple[Correction, ...]:
    cell = study.packs[0]
    return (
        Correction(
            paper="f_r not given",
            matter="recovered from two public re-implementations; taken literally it passes zero",
            here="declared as recovered, with stated floors, and the motor's power beside it",
        ),
        Correction(
            paper="ω_max, u_max and a bound on α not given",
            matter=f"with |α| above {study.critical_acceleration:.0f} rad/s² the literal problem "
            "has no minimum",
            here=f"in the vehicle file with sources: ω_max = "
            f"{study.efficiency_map.speed[-1]:.1f} rad/s",
        ),
        Correction(
            paper="braking torque divided by an efficiency",
            matter="makes braking earn more than it gave",
            here=_braking_credit(),
        ),
        Correction(
            paper="e_0 = 1.24 V, Q = 1.55 Ah, 'Li-ion'",
            matter="a third of a Li-ion cell's voltage; one cell delivers at most "
            f"{cell.greatest_power_W:.0f} W and stores {cell.stored_energy_J / 1e3:.1f} kJ, less "
            f"than the paper's own {ADAPTIVE_ENERGY[2].value / 1e3:.2f} kJ",
            here="the paper's cell with the number of cells as a parameter, and a real pack",
        ),
    )


def _braking_credit() -> str:
    """Say which power models let braking earn, as the experiments are declared."""
    earns = {
        model: paper_scenario(Experiment.CALM, {"power.model": model}).power.regeneration
        for model in PowerModel
    }
    without, with_it = (
        ", ".join(model.value for model, credit in earns.items() if credit is wanted)
        for wanted in (False, True)
    )
    return (
        f"no credit for negative power under {without}, unless regeneration is asked for; what "
        f"braking gives back under {with_it} counts, for there it is divided by no efficiency"
    )


def _of_results() -> tuple[Correction, ...]:
    optimum, adaptive = OPTIMAL_ENERGY[1].value, ADAPTIVE_ENERGY[1].value
    percent = 100 * (1 - optimum / adaptive)
    return (
        Correction(
            paper=f"'{SAVING[1].value} % increase', '{SAVING[2].value} % increase'",
            matter=f"they are reductions relative to the adaptive flight: "
            f"({adaptive / 1e3:.2f} - {optimum / 1e3:.2f}) / {adaptive / 1e3:.2f} = "
            f"{percent:.2f} %; the optimum in wind, not printed, is then "
            f"{implied_wind_optimum() / 1e3:.2f} kJ",
            here="called reductions, and given with both energies and the hover floor",
        ),
        Correction(
            paper="the adaptive controller is cited only",
            matter="gains and reference are unknown, so its energies cannot be reproduced",
            here="a published adaptive backstepping law as a stand-in, with two references",
        ),
    )
