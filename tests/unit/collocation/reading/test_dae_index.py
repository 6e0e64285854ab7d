"""The index of DAEs: pendulums in every form, circuits, and equations that a control keeps."""

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Objective, Var, sqrt
from scipy.special import ellipk

from pyomo_quad.collocation import TranscriptionError, compile
from pyomo_quad.collocation.formulation import structural_index
from tests.problems import double_integrator, implicit_dae

GRAVITY = 9.81
PERIOD = 4 * ellipk(np.sin(np.pi / 4) ** 2) / np.sqrt(GRAVITY)


def pendulum(form, *, end=0.5 * PERIOD):
    """A mass on a rod of length 1, let go where the rod is level, in Cartesian coordinates."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, end))
    for name, first in (("x", 1), ("y", 0), ("u", 0), ("v", 0)):
        m.add_component(name, Var(m.t, initialize=first))
        m.add_component(f"d{name}", DerivativeVar(m.component(name), wrt=m.t))
        m.component(name)[0].fix(first)
    m.pull = Var(m.t, initialize=1)
    m.across = Constraint(m.t, rule=lambda m, t: m.dx[t] == m.u[t])
    m.up = Constraint(m.t, rule=lambda m, t: m.dy[t] == m.v[t])
    m.push = Constraint(m.t, rule=lambda m, t: m.du[t] == -m.pull[t] * m.x[t])
    m.fall = Constraint(m.t, rule=lambda m, t: m.dv[t] == -m.pull[t] * m.y[t] - GRAVITY)
    m.rod = Constraint(m.t, rule=lambda m, t: form(m, t) == 0)
    return m


def length(m, t):
    return m.x[t] ** 2 + m.y[t] ** 2 - 1


def speed_along(m, t):
    return m.x[t] * m.u[t] + m.y[t] * m.v[t]


def tension(m, t):
    return m.u[t] ** 2 + m.v[t] ** 2 - m.pull[t] * (m.x[t] ** 2 + m.y[t] ** 2) - GRAVITY * m.y[t]


def test_a_pendulum_of_index_3_is_refused_with_the_form_to_write():
    with pytest.raises(
        TranscriptionError,
        match=r"^rod: makes the model a DAE of index 3; at most 2 .* Write its second time deriv",
    ):
        compile(pendulum(length))


@pytest.mark.lengthy
def test_the_reduced_form_swings_as_elliptic_integrals_say():
    problem = compile(pendulum(tension))
    assert "index of the DAE" not in problem.summary
    solution = problem.solve(tolerance=1e-8)
    assert solution.is_converged
    assert solution.value("x", 0.5 * PERIOD) == pytest.approx(-1.0, abs=1e-7)
    assert solution.value("y", 0.25 * PERIOD) == pytest.approx(-1.0, abs=1e-7)


def test_an_index_of_2_is_named():
    problem = compile(pendulum(speed_along))
    assert problem.summary["index of the DAE"] == "2"
    assert structural_index(problem.compiled.declared).differentiated["rod"] == 1


@pytest.mark.parametrize("build", [double_integrator.build, implicit_dae.build])
def test_other_models_are_of_index_1_at_most(build):
    assert structural_index(compile(build()).compiled.declared).index <= 1


def test_a_way_on_a_sphere_that_an_equation_keeps_is_a_great_circle():
    ends = np.array([[1.0, 0.0, 0.0], [0.36, 0.48, 0.8]])
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 1))
    for k, name in enumerate("xyz"):
        m.add_component(name, Var(m.t))
        m.add_component(f"u{name}", Var(m.t))
        m.add_component(f"d{name}", DerivativeVar(m.component(name), wrt=m.t))

        def law(m, t, name=name):
            return m.component(f"d{name}")[t] == m.component(f"u{name}")[t]

        m.add_component(f"{name}_law", Constraint(m.t, rule=law))
        m.component(name)[0].fix(ends[0, k])
        m.component(name)[1].fix(ends[1, k])
    m.T = Var(bounds=(0.1, 10), initialize=1)
    m.sphere = Constraint(m.t, rule=lambda m, t: m.x[t] ** 2 + m.y[t] ** 2 + m.z[t] ** 2 == 1)

    def squared(m, t):
        return m.ux[t] ** 2 + m.uy[t] ** 2 + m.uz[t] ** 2

    m.even = Constraint(m.t, rule=lambda m, t: squared(m, t) == m.T**2)
    # Without a guess all rates are zero, where the root has no slope.
    m.way = Integral(m.t, wrt=m.t, rule=lambda m, t: sqrt(squared(m, t)))
    m.cost = Objective(expr=m.way)
    problem = compile(m)
    assert problem.summary["index of the DAE"] == "2"
    solution = problem.solve()
    assert solution.is_converged, solution.message
    assert solution.objective == pytest.approx(np.arccos(0.36), rel=1e-6)
