"""The declared equations as LaTeX that a LaTeX reader reads; the paper's numbers lead to them."""

import inspect
from importlib import import_module

import pytest
from matplotlib.mathtext import MathTextParser
from pyomo.environ import Constraint, units

from pyomo_quad.model import build_model
from pyomo_quad.model.screening import inspect_model
from pyomo_quad.model.typeset import EQUATION_TABLE, typeset_equations
from pyomo_quad.scenario import PowerModel, WindCoupling
from tests.declared_model import scenario

EVERY_LIMIT = {
    "state_of_charge_min": 20.0,
    "battery_current_max": 30.0,
    "battery_voltage_min": 9.0,
    "battery_power_share_max": 0.9,
}


def texts(model):
    return {equation.name: equation.latex for equation in typeset_equations(model)}


@pytest.mark.parametrize(
    ("name", "latex"),
    [
        ("rotors.motor_torque", r"\tau_{j} = I_r \, \alpha_{j} + \kappa \, \omega_{j}^{2}"),
        ("rotors.motor_current", r"i_{j} = \frac{\tau_{j}}{k_t}"),
        ("rotors.motor_voltage", r"v_{j} = R \, i_{j} + \frac{1}{k_v} \, \omega_{j}"),
        ("rigid_body.x_kinematics", r"\dot{x} = v_x"),
        (
            "rotors.roll_moment",
            r"u_2 = l \, \kappa_b \, \left(\omega_{2}^{2} - \omega_{4}^{2}\right)",
        ),
        ("limits.thrust_limit", r"0 \le u_1 \le T_{max}"),
        ("rotors.rotor_kinematics", r"\dot{\omega}_{j} = \alpha_{j}"),
        ("power.rotor_power", r"P_{j} = v_{j} \, i_{j}"),
    ],
)
def test_known_equations(name, latex):
    assert texts(build_model(scenario()))[name] == latex


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("power", "coupling"),
    [
        (PowerModel.EFFICIENCY, WindCoupling.DRAG),
        (PowerModel.CONSTANT_EFFICIENCY, WindCoupling.ACCELERATION),
        (PowerModel.MOTOR_WITH_FRICTION, WindCoupling.ACCELERATION),
    ],
)
def test_every_equation_is_latex(power, coupling):
    model = build_model(
        scenario(
            power={"model": power.value},
            wind={"use": "paper_table_2", "coupling": coupling.value},
            limits=EVERY_LIMIT,
        )
    )
    parser = MathTextParser("path")
    found = typeset_equations(model)
    assert len(found) > 45
    for equation in found:
        assert equation.description
        # Matplotlib knows this sign by its longer name alone.
        latex = equation.latex.replace(r"\le ", r"\leq ")
        parser.parse(f"${latex}$")


def test_a_limit_in_a_hover_is_typeset_and_counted_although_it_holds_at_few_times():
    points = [{"position": [1.0, 2.0, 3.0]}, {"position": [4.0, 5.0, 6.0], "hold": 2.0}]
    model = build_model(scenario(mission={"waypoints": points}))
    plain = build_model(scenario(mission={"waypoints": points[:1]}))
    assert "mission.hold_distance" in texts(model)
    assert "mission.hold_distance" not in texts(plain)
    assert inspect_model(model).path_limits > inspect_model(plain).path_limits


def test_a_constraint_of_the_user_appears_under_its_name():
    model = build_model(scenario())
    model.ceiling = Constraint(
        model.time, rule=lambda m, t: m.rigid_body.z[t] <= 8.5 * units.m, doc="ceiling [m]"
    )
    assert texts(model)["ceiling"] == r"z \le 8.5"


def test_every_numbered_equation_of_the_paper_is_listed():
    assert tuple(EQUATION_TABLE) == tuple(range(1, 13))


@pytest.mark.parametrize("number", EQUATION_TABLE)
def test_the_functions_named_exist(number):
    for name in EQUATION_TABLE[number]:
        module, _, function = name.rpartition(".")
        declared = getattr(import_module(module), function)
        assert inspect.isfunction(declared)
        # A name imported from elsewhere would send the reader to the wrong file.
        assert declared.__module__ == module


@pytest.mark.parametrize("number", EQUATION_TABLE)
def test_the_declarations_of_those_modules_cite_the_equation(number):
    model = build_model(scenario(power={"model": "efficiency"}))
    cited = " ".join(e.description for e in typeset_equations(model))
    sources = "".join(
        inspect.getsource(import_module(name.rpartition(".")[0])) for name in EQUATION_TABLE[number]
    )
    assert f"eq. ({number})" in sources
    assert f"eq. ({number})" in cited
