"""Derivatives with merged terms: the same values, with the calls of tables still in them."""

import casadi
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from pyomo_quad.collocation.program.shared_terms import WithoutCalls
from pyomo_quad.collocation.reading.tables import Spline

AXIS = np.linspace(0.0, 3.0, 7)
PLACES = np.random.default_rng(3).uniform(0.2, 2.8, (5, 3))


def surface(x, y):
    return np.sin(x) + 0.2 * x * y


def of_tables():
    """Return symbols, and expressions with a table whose argument is the value of a table."""
    wave = Spline.through([AXIS], surface(AXIS, 1.0), 3)
    hill = Spline.through([AXIS, AXIS], surface(AXIS[:, None], AXIS[None, :]), 3)
    x = casadi.SX.sym("x", 2)
    given = casadi.SX.sym("given", 1)
    inner = wave.written([x[0]])
    outer = hill.written([inner, x[1] * given])
    return x, given, casadi.vertcat(outer**2 + casadi.exp(x[1]), 3.0, inner * outer, 2.0 * x[0])


def compiled(symbols, column):
    return casadi.Function("made", symbols, [column])


def test_derivatives_of_nested_tables_are_those_without_merging():
    x, given, rows = of_tables()
    plain = WithoutCalls.of(rows, [x, given])
    assert len(plain.calls) == 2
    for derivative in (casadi.jacobian, lambda r, v: casadi.hessian(casadi.sum1(r), v)[0]):
        merged = compiled([x, given], plain.merged(casadi.vec(derivative(plain.rows, x))))
        direct = compiled([x, given], casadi.vec(derivative(rows, x)))
        for at in PLACES:
            found, wanted = (np.array(f(at[:2], at[2])) for f in (merged, direct))
            assert found == pytest.approx(wanted, rel=1e-12, abs=1e-12)
        assert merged.n_instructions() < direct.n_instructions()


def test_equal_terms_of_expressions_without_tables_are_merged():
    x = casadi.SX.sym("x", 2)
    rows = casadi.vertcat(casadi.sin(x[0]) * x[1], casadi.sin(x[0]) + x[1])
    plain = WithoutCalls.of(rows, [x])
    assert not plain.calls
    twice, once = compiled([x], rows), compiled([x], plain.rows)
    assert once.n_instructions() == twice.n_instructions() - 1
    assert_array_equal(once([0.3, -2.0]), twice([0.3, -2.0]))


def test_the_result_of_any_other_function_keeps_its_derivatives():
    place = casadi.MX.sym("place")
    square = casadi.Function("square", [place], [place**2], {"never_inline": True})
    x = casadi.SX.sym("x")
    plain = WithoutCalls.of(square(x), [x])
    slope = compiled([x], plain.merged(casadi.jacobian(plain.rows, x)))
    assert float(slope(3.0)) == pytest.approx(6.0)
