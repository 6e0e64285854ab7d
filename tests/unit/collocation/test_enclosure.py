"""Enclosures hold every value and slope in their boxes, and refuse what they cannot enclose."""

import casadi
import numpy as np
import pytest

from pyomo_quad.collocation import Enclosure, TranscriptionError, symbols


def written(x, y, c):
    """Every operation that has an enclosure, in one expression."""
    return (x**2 + c * y) / (1 + y**2) + (2 * x + 3 - y) ** 0.5 - 1 / (x + 2) - x * y


def test_values_and_slopes_are_enclosed():
    x, y, c = symbols("x", "y", "c")
    enclosure = Enclosure([written(x, y, c), x - y], [x, y], [c])
    generator = np.random.default_rng(0)
    low = generator.uniform(-0.5, 0.5, (2, 300))
    high = low + generator.uniform(0.0, 0.3, (2, 300))
    (under, over), (least, most) = enclosure.over(low, high, [0.7])
    for share in generator.uniform(0.0, 1.0, (20, 2, 300)):
        at = low + share * (high - low)
        value, step = written(*at, 0.7), 1e-6
        assert np.all(under[0] <= value + 1e-12)
        assert np.all(value - 1e-12 <= over[0])
        for k in range(2):
            moved = at + step * np.eye(2)[k][:, None]
            slope = (written(*moved, 0.7) - value) / step
            assert np.all(least[k] <= slope + 1e-4)
            assert np.all(slope - 1e-4 <= most[k])


def test_a_point_encloses_itself():
    x, y, c = symbols("x", "y", "c")
    at = np.array([[0.3, -0.2], [0.1, 0.4]])
    enclosure = Enclosure([written(x, y, c)], [x, y], [c])
    (under, over), _ = enclosure.over(at, at, [0.7])
    np.testing.assert_allclose(under[0], written(*at, 0.7), rtol=1e-13)
    np.testing.assert_array_equal(under, over)
    np.testing.assert_array_equal(enclosure.at(at, [0.7]), under)


def test_nought_in_a_divisor_leaves_everything_open():
    x, c = symbols("x", "c")
    (under, over), _ = Enclosure([c / x], [x], [c]).over(
        np.array([[-1.0]]), np.array([[1.0]]), [1.0]
    )
    assert (under[0, 0], over[0, 0]) == (-np.inf, np.inf)


def test_an_operation_without_enclosure_is_refused():
    x, c = symbols("x", "c")
    with pytest.raises(TranscriptionError, match="of CasADi has no interval arithmetic"):
        Enclosure([casadi.sin(x)], [x], [c])
