"""Every number of the library has a source, and the numbers are those of the papers."""

import math

import pytest

from pyomo_quad.scenario import LIBRARY_KINDS, ScenarioError, library_entry, library_names
from pyomo_quad.scenario.fields import leaves, spell

ENTRIES = [(kind, name) for kind in LIBRARY_KINDS for name in library_names(kind)]


def test_names():
    assert library_names("vehicles") == (
        "crazyflie",
        "dji_matrice_100",
        "dji_phantom_2",
        "freefly_alta_8",
        "hexacopter_dorling",
        "hummingbird",
        "iris_difranco",
        "iris_stolaroff",
    )
    assert {"matrice_100_pack", "paper_cell", "phantom_2_pack"} <= set(library_names("batteries"))
    for name in library_names("vehicles"):
        assert library_entry("vehicles", name).battery in library_names("batteries")
    assert library_names("winds") == ("calm", "constant", "paper_table_2")


@pytest.mark.parametrize(("kind", "name"), ENTRIES)
def test_every_value_has_a_source(kind, name):
    entry = library_entry(kind, name)
    fields = {spell(path) for path, _ in leaves(entry.tables)}
    assert fields - {f"{LIBRARY_KINDS[kind]}.use"} == set(entry.sources)
    assert all(entry.sources.values())


def test_unknown_kind():
    with pytest.raises(ScenarioError, match=r"library: unknown kind 'cars'; must be one of vehi"):
        library_names("cars")


def test_unknown_name():
    with pytest.raises(ScenarioError, match=r"library: no wind named 'clam'; .*mean calm\?"):
        library_entry("winds", "clam")


def test_phantom_2_constants_agree_with_each_other():
    vehicle = library_entry("vehicles", "dji_phantom_2").tables["vehicle"]
    # Rotor of Morbidi 2016: r = 0.12 m, C_T = 0.0048, air of 1.225 kg/m^3.
    disc = 1.225 * math.pi * 0.12**2
    assert vehicle["thrust_coefficient"] == pytest.approx(0.0048 * disc * 0.12**2, rel=1e-4)
    drag_torque = 0.0048**1.5 / math.sqrt(2) * disc * 0.12**3
    assert vehicle["drag_torque_coefficient"] == pytest.approx(drag_torque, rel=1e-4)
    assert vehicle["torque_constant"] == pytest.approx(1 / vehicle["voltage_constant"], rel=3e-3)


def test_battery_constants_are_the_scaled_generic_cell():
    cell = library_entry("batteries", "paper_cell").tables["battery"]
    assert cell["E0"] == pytest.approx(3.7348 / 3, rel=5e-3)
    assert cell["A"] == pytest.approx(0.468 / 3)
    assert cell["K"] == pytest.approx(0.00876 / 3)
    assert cell["B"] == pytest.approx(3.5294 / 1.5, rel=2e-3)
    pack = library_entry("batteries", "phantom_2_pack").tables["battery"]
    assert pack["B"] == pytest.approx(3.5294 / 5.2, rel=1e-4)
    assert pack["cell_resistance"] == pytest.approx(0.09 / 5.2, rel=1e-3)


def test_hover_speed_of_the_phantom_2():
    # The paper prints 912 rad/s; m g / (4 kb) gives a little more.
    from pyomo_quad.scenario import scenario_from_mapping

    scenario = scenario_from_mapping(
        {"name": "hop", "mission": {"duration": 5.0, "goal": {"position": [0.0, 0.0, 1.0]}}}
    )
    hover_speed = scenario.vehicle.hover_speed(scenario.gravity)
    assert hover_speed == pytest.approx(912.3, abs=0.1)
