"""Units of the declared model, on its continuous equations."""

import dataclasses

import pytest
from pyomo.environ import Constraint, units

from pyomo_quad.model import aerodynamics, build_model, inspect_model
from pyomo_quad.model.parameters import parameter_tables
from pyomo_quad.scenario import PowerModel, WindCoupling
from pyomo_quad.scenario.fields import unit_of
from tests.declared_model import AIRSPACE, scenario

EVERY_LIMIT = {
    "state_of_charge_min": 20.0,
    "battery_current_max": 30.0,
    "battery_voltage_min": 9.0,
    "battery_power_share_max": 0.9,
    "speed_max": 5.0,
}


@pytest.mark.parametrize(
    "coupling",
    [WindCoupling.DRAG, pytest.param(WindCoupling.ACCELERATION, marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("power", list(PowerModel))
def test_every_equation_is_consistent(power, coupling):
    wind = {"use": "paper_table_2", "coupling": coupling.value}
    vehicle = {"rotor_radius": 0.12}
    model = build_model(
        scenario(power={"model": power.value}, wind=wind, limits=EVERY_LIMIT, vehicle=vehicle)
    )
    assert inspect_model(model).unit_errors == ()


def test_the_airspace_is_consistent():
    assert inspect_model(build_model(scenario(airspace=AIRSPACE))).unit_errors == ()


def test_the_wind_coupling_as_printed_is_flagged(monkeypatch):
    # Eq. (9) adds W, a velocity, to an acceleration: a coefficient without its 1/s does that.
    (coefficient,) = aerodynamics.PARAMETERS
    as_printed = dataclasses.replace(coefficient, units=units.dimensionless)
    monkeypatch.setattr(aerodynamics, "PARAMETERS", (as_printed,))
    errors = inspect_model(build_model(scenario(wind={"use": "paper_table_2"}))).unit_errors
    assert [line.partition(":")[0] for line in errors] == [
        "rigid_body.x_momentum_balance",
        "rigid_body.y_momentum_balance",
    ]


def test_an_inconsistent_constraint_of_the_user_is_named():
    model = build_model(scenario())
    model.mistake = Constraint(
        model.time, rule=lambda m, t: m.rigid_body.z[t] <= m.rigid_body.vz[t]
    )
    (error,) = inspect_model(model).unit_errors
    assert error.startswith("mistake: ")


def test_units_are_those_of_the_scenario_fields():
    told = scenario(limits=EVERY_LIMIT, power={"model": "constant_efficiency"})
    checked = 0
    for block, table in parameter_tables(told):
        part = type(getattr(told, block, None))
        for row in table:
            field = unit_of(part, row.name) if hasattr(part, "model_fields") else ""
            if field:
                declared = str(units.get_units(1.0 * row.units))
                same = units.convert_value(1.0, _parse(field), row.units) if field != "1" else 1.0
                assert same == pytest.approx(1.0), (row.name, field, declared)
                checked += 1
    assert checked > 35


def _parse(text):
    names = {"rad", "s", "kg", "m", "N", "V", "A", "ohm", "percent", "W", "hr"}
    return eval(text.replace("^", "**"), {name: getattr(units, name) for name in names})
