"""The columns of a flight's table print the declared model's values in the unit they name."""

import pytest
from pyomo.environ import units

from pyomo_quad.flight.columns import COLUMNS, ENERGY, TIME, column_of
from pyomo_quad.model import build_model
from tests.declared_model import scenario

# Units in print, as pint reads them; it counts rad as 1, as products of forces and speeds need.
PINT = {"°": "degree", "°/s": "degree/s", "mN m": "mN*m", "rad/s²": "rad/s**2", "%": "percent"}
SHOWN = [column for column in COLUMNS if column.name != ENERGY]


@pytest.fixture(scope="module")
def model():
    return build_model(scenario())


@pytest.mark.parametrize("column", SHOWN, ids=lambda column: column.name)
def test_scale_turns_the_model_s_unit_into_the_printed_one(model, column):
    declared = next(iter(model.find_component(column.component).values()))
    stored = units.pint_registry(str(units.get_units(declared)))
    printed = stored.to(PINT.get(column.unit, column.unit))
    assert column.scale == pytest.approx(printed.magnitude, rel=1e-12)


def test_a_column_is_found_by_its_variable_and_the_energy_by_its_name():
    assert [column_of(column.variable) for column in SHOWN] == SHOWN
    assert column_of("rotors.omega[3]").name == "omega_3_rad_per_s"
    assert column_of(ENERGY).unit == "J"
    assert TIME not in {column.name for column in COLUMNS}
