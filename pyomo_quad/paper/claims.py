"""What the paper prints, and where it is wrong or silent: what is compared with a run."""

from dataclasses import dataclass
from typing import Any

from pyomo_quad.flight import Planner
from pyomo_quad.paper.experiments import POWER_MODELS, Experiment, paper_scenario
from pyomo_quad.paper.study import PaperStudy
from pyomo_quad.scenario import PowerModel


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A result that the paper prints.

    ``value`` is in the unit of the name under which it is listed.
    """

    value: float
    place: str


@dataclass(frozen=True, kw_only=True)
class PrintedNumber:
    """A parameter that the paper prints, and the scenario's field that stands for it."""

    symbol: str
    printed: str
    unit: str
    field: str


#: By number of the experiment, J. The optimum of the second is not printed.
OPTIMAL_ENERGY = {1: Claim(value=1890.0, place="section IV, first test")}
ADAPTIVE_ENERGY = {
    1: Claim(value=5770.0, place="section IV, first test"),
    2: Claim(value=9740.0, place="section IV, second test"),
}
#: By number of the experiment, percent; the paper calls each an increase.
SAVING = {
    1: Claim(value=67.24, place="section IV, first test"),
    2: Claim(value=78.85, place="section IV, second test"),
}


def implied_wind_optimum() -> float:
    """Return the optimum of the second test that its adaptive energy and percentage imply.

    Returns
    -------
    float
        The percentages are reductions relative to the adaptive flight, J.
    """
    return ADAPTIVE_ENERGY[2].value * (1 - SAVING[2].value / 100)


TABLE_1 = (
    PrintedNumber(symbol="I_r", printed="4.1904e-5", unit="kg m²", field="vehicle.rotor_inertia"),
    PrintedNumber(symbol="k_t", printed="0.0104e-3", unit="N m/A", field="vehicle.torque_constant"),
    PrintedNumber(symbol="k_v", printed="96.342", unit="rad/s/V", field="vehicle.voltage_constant"),
    PrintedNumber(symbol="R", printed="0.2", unit="Ω", field="vehicle.motor_resistance"),
    PrintedNumber(symbol="Q_bat", printed="1.55", unit="Ah", field="battery.capacity"),
    PrintedNumber(symbol="R_bat", printed="0.02", unit="Ω", field="battery.cell_resistance"),
    PrintedNumber(symbol="e_0", printed="1.24", unit="V", field="battery.E0"),
    PrintedNumber(symbol="k", printed="2.92e-3", unit="V", field="battery.K"),
    PrintedNumber(symbol="c_1", printed="0.156", unit="V", field="battery.A"),
    PrintedNumber(symbol="c_2", printed="2.35", unit="1/Ah", field="battery.B"),
)

VEHICLE = (
    PrintedNumber(symbol="l", printed="0.175", unit="m", field="vehicle.arm_length"),
    PrintedNumber(symbol="m", printed="1.3", unit="kg", field="vehicle.mass"),
    PrintedNumber(symbol="I_x", printed="0.081", unit="kg m²", field="vehicle.Ix"),
    PrintedNumber(symbol="I_y", printed="0.081", unit="kg m²", field="vehicle.Iy"),
    PrintedNumber(symbol="I_z", printed="0.142", unit="kg m²", field="vehicle.Iz"),
    PrintedNumber(
        symbol="κ_b", printed="3.8305e-6", unit="N s²", field="vehicle.thrust_coefficient"
    ),
    PrintedNumber(
        symbol="κ", printed="2.2518e-8", unit="N m s²", field="vehicle.drag_torque_coefficient"
    ),
    PrintedNumber(symbol="g", printed="9.81", unit="m/s²", field="gravity"),
)


def _axis(axis: str, rows: tuple[tuple[str, str], ...]) -> tuple[PrintedNumber, ...]:
    harmonics = tuple(
        number
        for k, (frequency, amplitude) in enumerate(rows)
        for number in (
            PrintedNumber(
                symbol=f"Ω_{k + 1}, {axis}",
                printed=frequency,
                unit="Hz",
                field=f"wind.{axis}.frequencies[{k}]",
            ),
            PrintedNumber(
                symbol=f"A_{k + 1}, {axis}",
                printed=amplitude,
                unit="m/s",
                field=f"wind.{axis}.amplitudes[{k}]",
            ),
        )
    )
    return (
        *harmonics,
        PrintedNumber(
            symbol=f"v_gmax, {axis}",
            printed="0.20",
            unit="m/s",
            field=f"wind.{axis}.gust_amplitude",
        ),
        PrintedNumber(
            symbol=f"T_g, {axis}", printed="10", unit="s", field=f"wind.{axis}.gust_period"
        ),
    )


TABLE_2 = (
    PrintedNumber(symbol="v_0, x", printed="1.0", unit="m/s", field="wind.x.mean"),
    *_axis("x", (("0.5", "0.10"), ("0.7", "0.25"), ("1.0", "0.30"))),
    PrintedNumber(symbol="v_0, y", printed="0.5", unit="m/s", field="wind.y.mean"),
    *_axis("y", (("0.6", "-0.05"), ("1.0", "-0.10"), ("1.5", "-0.30"))),
)


_PRINTED_HOVER_SPEED = 912.0  # rad/s, section IV


def corrections(study: PaperStudy) -> dict[str, Any]:
    """Return the numbers of the template that says where the paper is wrong or silent."""
    printed = next(float(n.printed) for n in TABLE_1 if n.field == "vehicle.torque_constant")
    scenario = paper_scenario(Experiment.CALM)
    steady = Planner().steady_flight(scenario.with_values({"power.model": PowerModel.SHAFT}))
    at_hover = steady.hover
    weight = scenario.vehicle.total_mass * scenario.gravity
    # Whether braking earns, as the experiments are declared.
    earns = {
        model: paper_scenario(Experiment.CALM, {"power.model": model}).power.regeneration
        for model in POWER_MODELS
    }
    return {
        "vehicle": scenario.vehicle,
        "printed_torque_constant": printed,
        "printed_current_A": at_hover.power_W / 4 / at_hover.rotor_speed_rad_per_s / printed,
        "printed_hover_speed": _PRINTED_HOVER_SPEED,
        "hover_speed": at_hover.rotor_speed_rad_per_s,
        "lack_percent": 100 * (1 - float(steady.thrust(_PRINTED_HOVER_SPEED)) / weight),
        "critical_acceleration": study.critical_acceleration,
        "greatest_speed": study.efficiency_map.speed[-1],
        "without_credit": [model.value for model, credit in earns.items() if not credit],
        "with_credit": [model.value for model, credit in earns.items() if credit],
        "cell": study.packs[0],
        "optimum_J": OPTIMAL_ENERGY[1].value,
        "adaptive_J": {number: claim.value for number, claim in ADAPTIVE_ENERGY.items()},
        "saving_percent": {number: claim.value for number, claim in SAVING.items()},
        "implied_wind_optimum_J": implied_wind_optimum(),
    }
