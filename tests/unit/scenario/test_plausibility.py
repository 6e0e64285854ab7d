"""Vehicles that cannot exist: what is refused, what is told, and what is at the edge."""

from math import pi, sqrt

import pytest

from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.report import Figures
from pyomo_quad.report.report import REPORT_NAME
from pyomo_quad.scenario import ScenarioError, load_scenario
from pyomo_quad.scenario.description import shipped_scenarios
from tests.declared_model import scenario, steady
from tests.scenario_files import write_scenario


def fields(told):
    return [found.field for found in told.contradictions]


def test_a_motor_that_gives_more_than_it_takes_in_hover_is_refused():
    told = (
        r"vehicle\.voltage_constant = 920 rad/s/V: its product with torque_constant = 0\.0104 "
        r"N m/A is 9\.568; must be 1, since a motor in hover gives out 17\.1 W and takes 2\.44 W; "
        r"give 96\.15 rad/s/V, or another torque_constant; were rpm/V meant\? 920 rpm/V are "
        r"96\.34\.$"
    )
    for model in ("motor", "motor_with_friction"):
        frictionless = {"friction_torque": 0.0, "viscous_damping": 0.0}
        with pytest.raises(ScenarioError, match=told):
            scenario(vehicle=frictionless | {"voltage_constant": 920.0}, power={"model": model})
    # Where no motor makes the power nothing is created, yet the vehicle is none.
    shafts = scenario(vehicle={"voltage_constant": 920.0}, power={"model": "shaft"})
    assert fields(shafts) == ["vehicle.voltage_constant"]


@pytest.mark.parametrize("resistance", [0.05, 0.2])
def test_the_border_is_where_the_declared_equations_create_power(resistance):
    """The copper loss hides a product above 1 up to a bound, which the equations set."""
    vehicle = {"motor_resistance": resistance}
    flight = steady(scenario(vehicle=vehicle))
    speed = flight.hover_speed
    torque = float(flight.rotor_value("rotors.motor_torque", speed))
    loss = resistance * (torque / 0.0104) ** 2
    border = 1 / (0.0104 * (1 - loss / (torque * speed)))
    below, above = ({"voltage_constant": border * factor} for factor in (1 - 1e-6, 1 + 1e-6))
    just = steady(scenario(vehicle=vehicle | below))
    assert just.hover_power == pytest.approx(4 * torque * speed, rel=1e-5)
    with pytest.raises(ScenarioError, match="gives out"):
        scenario(vehicle=vehicle | above)


@pytest.mark.parametrize(("product", "is_told"), [(0.985, True), (0.995, False), (1.005, False)])
def test_a_product_off_by_more_than_rounding_is_told(product, is_told):
    told = scenario(vehicle={"voltage_constant": product / 0.0104})
    assert ("vehicle.voltage_constant" in fields(told)) == is_told
    assert any("its product" in line for line in told.remarks) != is_told


@pytest.mark.parametrize("largest", ["Ix", "Iy", "Iz"])
def test_no_moment_of_inertia_exceeds_the_sum_of_the_others(largest):
    others = [name for name in ("Ix", "Iy", "Iz") if name != largest]
    moments = dict.fromkeys(others, 0.05)
    assert fields(scenario(vehicle=moments | {largest: 0.1})) == []
    (found,) = scenario(vehicle=moments | {largest: 0.102}).contradictions
    assert found.field == f"vehicle.{largest}"
    assert found.message == (
        f"vehicle.{largest} = 0.102 kg m^2; must be at most {' + '.join(others)} = 0.1 kg "
        "m^2; correct one of the three."
    )


@pytest.mark.lengthy
@pytest.mark.parametrize("radius", [None, 0.1])
def test_no_rotor_hovers_below_the_ideal_power_of_its_disc(radius):
    area = 4 * pi * (0.175 / sqrt(2) if radius is None else radius) ** 2
    ideal = (1.3 * 9.81) ** 1.5 / sqrt(2 * 1.225 * area)
    shaft = steady(scenario(power={"model": "shaft"})).hover_power
    sized = {} if radius is None else {"rotor_radius": radius}
    for share, expected in ((1.0, []), (0.98, ["vehicle.drag_torque_coefficient"])):
        torque = {"drag_torque_coefficient": 2.2518e-8 * share * ideal / shaft}
        told = scenario(vehicle=sized | torque, power={"model": "shaft"})
        assert fields(told) == expected
        for found in told.contradictions:
            assert (
                f"{share * ideal:.4g} W at the shafts, ideal rotors {ideal:.4g} W" in found.message
            )


def test_momentum_theory_is_never_below_itself():
    vehicle = {"rotor_radius": 0.12, "drag_torque_coefficient": 1e-9}
    assert fields(scenario(vehicle=vehicle, power={"model": "momentum"})) == []


@pytest.mark.parametrize("name", sorted(shipped_scenarios()))
def test_the_shipped_vehicles_can_exist(name):
    assert load_scenario(shipped_scenarios()[name]).contradictions == ()


def test_what_of_the_papers_vehicle_is_at_the_edge_is_said():
    motors, rotors = load_scenario(shipped_scenarios()["paper_calm"]).remarks
    assert "is 1.002; must be 1; below 46.9 rad/s a motor gives out more than it takes" in motors
    assert "figure of merit 0.97. Rotors of small vehicles reach 0.5 to 0.7" in rotors
    # With the radius of its source, 0.12 m, its hover is the ideal one to four digits.
    exact = load_scenario(shipped_scenarios()["paper_calm"], {"vehicle.rotor_radius": 0.12})
    assert exact.contradictions == ()
    assert "figure of merit 1.00" in exact.remarks[1]


@pytest.mark.lengthy
def test_check_and_headline_say_what_cannot_exist(tmp_path, capsys):
    file = write_scenario(tmp_path, "vehicle.Iz = 0.2", "solver.elements = 10")
    found = "vehicle.Iz = 0.2 kg m^2; must be at most Ix + Iy = 0.162 kg m^2"
    assert main(["check", str(file)]) == ExitCode.VERIFIED
    said = capsys.readouterr().out
    assert f"Mission, unphysical: {found}" in said
    assert "Note: vehicle.voltage_constant = 96.34 rad/s/V" in said
    arguments = ["solve", str(file), "--out", str(tmp_path / "out"), "--figures", Figures.NONE]
    assert main(arguments) == ExitCode.VERIFIED
    headline = capsys.readouterr().out.splitlines()[1]
    assert headline.startswith(f"hop: no such vehicle can exist: {found}")
    report = (tmp_path / "out" / REPORT_NAME).read_text(encoding="utf-8")
    (verdict,) = [
        line for line in report.splitlines() if line.startswith("> **Verified in simulation.**")
    ]
    assert f"**No such vehicle can exist:** {found}" in verdict


def test_bad_motors_end_a_command_as_bad_input(tmp_path, capsys):
    file = write_scenario(tmp_path, "vehicle.voltage_constant = 920.0")
    assert main(["check", str(file)]) == ExitCode.BAD_INPUT
    assert "were rpm/V meant?" in capsys.readouterr().err
