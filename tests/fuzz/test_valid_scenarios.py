"""Every scenario that the schema lets through builds, has consistent units, and compiles."""

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from pyomo_quad.collocation import compile as compile_model
from pyomo_quad.model import build_model, inspect_model
from pyomo_quad.scenario import FeasibilityError, PowerModel, WindCoupling, scenario_from_mapping

EXAMPLES = 4


def within(lowest, highest):
    return st.floats(lowest, highest, allow_subnormal=False)


positions = st.lists(within(-1e3, 1e3), min_size=3, max_size=3)
scenarios = st.fixed_dictionaries(
    {
        "name": st.just("drawn"),
        "mission": st.fixed_dictionaries(
            {
                "duration": within(1e-2, 1e4),
                "start": st.fixed_dictionaries({"position": positions}),
                "goal": st.fixed_dictionaries({"position": positions, "yaw": within(-7, 7)}),
            }
        ),
        "vehicle": st.fixed_dictionaries(
            {
                "payload": within(0, 1),
                "drag_linear": within(0, 10),
                "arm_length": within(0.01, 9),
                "rotor_radius": within(0.01, 1),
            }
        ),
        "wind": st.fixed_dictionaries(
            {
                "use": st.sampled_from(("calm", "constant", "paper_table_2")),
                "coupling": st.sampled_from([coupling.value for coupling in WindCoupling]),
                "speed": within(0, 30),
            }
        ),
        "power": st.fixed_dictionaries(
            {
                "model": st.sampled_from([model.value for model in PowerModel]),
                "regeneration": st.booleans(),
            }
        ),
        "limits": st.fixed_dictionaries(
            {},
            optional={
                "state_of_charge_min": within(0, 99),
                "battery_current_max": within(1e-3, 1e3),
                "battery_voltage_min": within(0.1, 12),
                "battery_power_share_max": within(1e-3, 1),
            },
        ),
    }
)


@pytest.mark.lengthy
@settings(max_examples=EXAMPLES, deadline=None, derandomize=True)
@given(scenarios)
def test_valid_scenarios_build_and_compile(tables):
    try:
        scenario = scenario_from_mapping(tables)
    except FeasibilityError:
        assume(False)
    model = build_model(scenario)
    assert inspect_model(model).is_unit_consistent
    assert compile_model(model).compiled.declared.states
