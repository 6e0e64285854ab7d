"""The standard atmosphere against its published table, and a vehicle in thin air."""

import pytest

from pyomo_quad.scenario import Scenario, ScenarioError, load_scenario
from pyomo_quad.scenario.wind import Air
from tests.scenario_files import write_scenario


@pytest.mark.parametrize(
    ("height", "density"),
    # ISO 2533:1975, table 1.
    [(0.0, 1.225), (1000.0, 1.11166), (2000.0, 1.00655), (5000.0, 0.736429), (10000.0, 0.413510)],
)
def test_density_is_that_of_the_published_table(height, density):
    assert Air(height=height).density == pytest.approx(density, rel=2e-5)


def test_warm_air_is_thin():
    assert Air(temperature=303.15).density == pytest.approx(1.225 * 288.15 / 303.15, rel=1e-6)


def test_rotors_turn_faster_in_thin_air_and_give_less(tmp_path):
    low = load_scenario(write_scenario(tmp_path))
    high = load_scenario(write_scenario(tmp_path), {"air.height": 2000.0})
    thinner = high.air.density / 1.225
    assert high.vehicle.hover_speed(9.81) == pytest.approx(
        low.vehicle.hover_speed(9.81) / thinner**0.5
    )
    assert high.limits.thrust_max == pytest.approx(thinner * low.limits.thrust_max)
    assert high.power.air_density == high.air.density
    assert high.vehicle.mass == low.vehicle.mass
    assert "in air of 1.007 kg/m^3" in high.provenance["vehicle.thrust_coefficient"]
    assert "air" not in low.model_dump()


def test_a_stored_scenario_is_thinned_once_and_can_be_moved(tmp_path):
    high = load_scenario(write_scenario(tmp_path), {"air.height": 2000.0})
    stored = Scenario.model_validate_json(high.model_dump_json())
    assert stored.with_values({"gravity": 9.8}).vehicle == high.vehicle
    higher = stored.with_values({"air.height": 2500.0})
    expected = high.with_values({"air.height": 2500.0})
    assert higher.vehicle.thrust_coefficient == pytest.approx(expected.vehicle.thrust_coefficient)
    assert higher.power.air_density == expected.power.air_density


def test_a_density_that_is_written_is_kept(tmp_path):
    file = write_scenario(tmp_path, "air.height = 1000.0", "power.air_density = 1.0")
    assert load_scenario(file).power.air_density == 1.0


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("air.height = 20000.0", r"air.height = 20000 m; must be from -500 to 11000: the standard"),
        (
            "air.temperature = 20.0",
            r"air.temperature = 20 K; must be from 180 to 340: temperatures on the",
        ),
        ("air.heigth = 3.0", r"unknown key air.heigth; did you mean air.height\?"),
    ],
)
def test_air_that_is_none(tmp_path, line, message):
    with pytest.raises(ScenarioError, match=message):
        load_scenario(write_scenario(tmp_path, line))
