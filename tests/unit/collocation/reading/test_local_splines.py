"""Tables in CasADi: their values and derivatives at any place, and what evaluating them costs."""

import casadi
import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from pyomo_quad.collocation.reading import local_splines
from pyomo_quad.collocation.reading.tables import Spline

AXES = (np.linspace(0, 330, 9), np.array([0.0, 1.0, 4.0, 9.0, 16.0]), np.linspace(-2, 2, 6))


def tabulated():
    """Return a spline through random values, and the tensor product of SciPy's in its place."""
    values = np.random.default_rng(5).normal(size=[axis.size for axis in AXES])
    spline = Spline.through(AXES, values, 3)

    def by_scipy(place, orders):
        held = values
        for axis, at, order in zip(AXES, place, orders, strict=True):
            held = make_interp_spline(axis, held, k=3)(at, order)
        return float(held)

    return spline, by_scipy


@pytest.mark.parametrize("most", [1, 1000, 10**6])
def test_value_gradient_and_hessian_are_those_of_the_tensor_product(monkeypatch, most):
    monkeypatch.setattr(local_splines, "_MOST_LOOKED_UP", most)
    spline, by_scipy = tabulated()
    inside = np.random.default_rng(6).uniform([0, 0, -2], [330, 16, 2], (10, 3)).tolist()
    unit = np.eye(3, dtype=int)
    # Points of the grid too, where two polynomials meet.
    for place in [*inside, [41.25, 4.0, 0.4], [330.0, 16.0, 2.0], [0.0, 0.0, -2.0]]:
        value, gradient, hessian = (part.full() for part in spline.function(place))
        assert value.item() == pytest.approx(by_scipy(place, (0, 0, 0)), abs=1e-10)
        slopes = [by_scipy(place, one) for one in unit]
        assert gradient.ravel() == pytest.approx(slopes, rel=1e-9, abs=1e-9)
        bends = [[by_scipy(place, one + other) for other in unit] for one in unit]
        is_inside = place in inside
        if is_inside:
            assert hessian == pytest.approx(np.array(bends), rel=1e-6, abs=1e-6)


def test_beyond_its_ends_a_table_goes_straight_on():
    spline, by_scipy = tabulated()
    slope = by_scipy([330.0, 2.0, 0.5], (1, 0, 0))
    end = by_scipy([330.0, 2.0, 0.5], (0, 0, 0))
    value, gradient, _ = spline.function([400.0, 2.0, 0.5])
    assert float(value) == pytest.approx(end + 70.0 * slope, rel=1e-9)
    assert float(gradient[0]) == pytest.approx(slope, rel=1e-9)


def test_a_place_that_is_not_a_number_has_no_value():
    spline, _ = tabulated()
    assert np.isnan(float(spline.function([np.nan, 1.0, 0.0])[0]))


def test_a_hessian_looks_the_table_up_once():
    spline, _ = tabulated()
    place = casadi.SX.sym("place", 3)
    hessian = casadi.hessian(spline.written(casadi.vertsplit(place)), place)[0]
    made = casadi.Function("made", [place], [hessian]).str(True)
    assert made.count("= local(") == 1
    assert "adj1" not in made
