"""Compiled problems kept as a program keeps them: shared, and the oldest discarded."""

import pyomo.environ as pyo
from pyomo.dae import ContinuousSet, DerivativeVar

from pyomo_quad.flight import Planner
from pyomo_quad.flight.caches import Recent
from pyomo_quad.scenario import load_scenario
from tests.command import SCENARIOS

CALM = load_scenario(SCENARIOS / "paper_calm.toml")


def test_the_oldest_value_is_discarded_and_one_stored_anew_is_the_newest():
    held = Recent(2)
    for key, value in (("a", 1), ("b", 2), ("a", 3), ("c", 4)):
        assert held.store(key, value) == value
    assert [held.get(key) for key in "abc"] == [3, None, 4]
    held.capacity = 1
    held.store("d", 5)
    assert [held.get(key) for key in "acd"] == [None, None, 5]


def decay(scenario):
    """Declare a state that decays, whatever the scenario."""
    m = pyo.ConcreteModel()
    m.t = ContinuousSet(bounds=(0.0, 1.0))
    m.x = pyo.Var(m.t, initialize=1.0)
    m.dx_dt = DerivativeVar(m.x, wrt=m.t)
    m.decay = pyo.Constraint(m.t, rule=lambda m, t: m.dx_dt[t] == -m.x[t])
    m.start = pyo.Constraint(expr=m.x[0.0] == 1.0)
    return m


def evaluator(planner, scenario):
    return planner.problem_for(scenario)[0].evaluator


def test_planners_of_the_declared_model_share_what_they_compile_and_others_do_not():
    assert evaluator(Planner(), CALM) is evaluator(Planner(), CALM)
    assert evaluator(Planner(decay), CALM) is not evaluator(Planner(decay), CALM)


def test_a_problem_that_was_discarded_is_compiled_anew():
    planner = Planner(decay)
    first = evaluator(planner, CALM)
    assert evaluator(planner, CALM) is first
    for mass in (1.2, 1.4, 1.5, 1.6):
        evaluator(planner, CALM.with_values({"vehicle.mass": mass}))
    assert evaluator(planner, CALM) is not first
