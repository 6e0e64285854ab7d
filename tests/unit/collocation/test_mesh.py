"""The mesh and its Radau rules: arithmetic, known digits, exactness, and what is refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis.strategies import floats

from pyomo_quad.collocation import Mesh, Timeline, TranscriptionError, control_polynomial
from pyomo_quad.collocation.mesh import interpolation_matrix, radau_rule
from tests.agreement.stock import radau_points, radau_weights

UNEVEN = Mesh(breakpoints=(0.0, 0.2, 0.5, 1.0), degrees=(3, 1, 4))


def test_counts():
    assert (UNEVEN.elements, UNEVEN.points) == (3, 8)
    np.testing.assert_array_equal(UNEVEN.first_node, [0, 3, 4, 8])
    np.testing.assert_array_equal(UNEVEN.element_of_point, [0, 0, 0, 1, 2, 2, 2, 2])


def test_points_end_each_element_exactly():
    ends = UNEVEN.point_fractions[UNEVEN.first_node[1:] - 1]
    np.testing.assert_array_equal(ends, UNEVEN.breakpoints[1:])
    assert np.all(np.diff(UNEVEN.node_fractions) > 0.0)
    assert UNEVEN.node_fractions[0] == 0.0


def test_quadrature_weights_integrate_over_the_horizon():
    fractions, weights = UNEVEN.point_fractions, UNEVEN.quadrature_weights
    assert weights.sum() == pytest.approx(1.0, rel=1e-14)
    # The element of degree 1 is exact for constants only.
    third = slice(4, 8)
    assert weights[third] @ fractions[third] ** 6 == pytest.approx((1 - 0.5**7) / 7, rel=1e-14)


def test_a_boundary_belongs_to_the_element_it_ends():
    np.testing.assert_array_equal(
        UNEVEN.locate(np.array([0.0, 0.1, 0.2, 0.2000001, 0.5, 1.0])), [0, 0, 0, 1, 1, 2]
    )


@given(start=floats(0.0, 100.0), duration=floats(0.5, 1000.0))
def test_a_time_at_a_boundary_belongs_to_the_element_it_ends_in_spite_of_rounding(start, duration):
    # Controls jump at boundaries; a table of a plan has the values at the ends of the elements.
    mesh = Mesh.uniform(60, 2)
    times = start + duration * mesh.node_fractions[1:]
    fractions = (times - start) / (start + duration - start)
    np.testing.assert_array_equal(mesh.locate(fractions), mesh.element_of_point)


def test_breakpoints_are_added_once():
    finer = UNEVEN.with_breakpoints([0.75, 0.2])
    assert finer.breakpoints == (0.0, 0.2, 0.5, 0.75, 1.0)
    assert finer.degrees == (3, 1, 4, 4)
    assert finer.with_breakpoints([0.75]) == finer


def test_uniform():
    mesh = Mesh.uniform(4, 3)
    assert mesh.breakpoints == (0.0, 0.25, 0.5, 0.75, 1.0)
    assert mesh.degrees == (3, 3, 3, 3)


@pytest.mark.parametrize(
    ("breakpoints", "degrees", "message"),
    [
        ((0.0, 0.5, 1.0), (3,), "3 breakpoints for 1 degrees"),
        ((0.0,), (), "at least one element"),
        ((0.0, 0.9), (3,), "run from 0.0 to 0.9"),
        ((0.1, 1.0), (3,), "run from 0.1 to 1.0"),
        ((0.0, 0.6, 0.6, 1.0), (3, 3, 3), "must increase strictly"),
        ((0.0, 1.0), (0,), "element degree = 0"),
    ],
)
def test_refused(breakpoints, degrees, message):
    with pytest.raises(TranscriptionError, match=message):
        Mesh(breakpoints=breakpoints, degrees=degrees)


def test_no_elements_are_refused():
    with pytest.raises(TranscriptionError, match="0 elements; must be at least 1"):
        Mesh.uniform(0, 3)


DEGREES = (1, 2, 3, 5, 8, 12, 20, 40)


def test_points_of_degree_three_are_those_of_radau_iia():
    # Hairer and Wanner (1996), table IV.5.6.
    expected = [(4 - np.sqrt(6)) / 10, (4 + np.sqrt(6)) / 10, 1.0]
    np.testing.assert_allclose(radau_rule(3).points, expected, rtol=1e-14)


def test_weights_of_degree_three_are_those_of_radau_iia():
    expected = [(16 - np.sqrt(6)) / 36, (16 + np.sqrt(6)) / 36, 1 / 9]
    np.testing.assert_allclose(radau_rule(3).weights, expected, rtol=1e-14)


def test_integration_matrix_of_degree_two_is_that_of_radau_iia():
    expected = [[5 / 12, -1 / 12], [3 / 4, 1 / 4]]
    np.testing.assert_allclose(radau_rule(2).integration, expected, rtol=1e-14)


@pytest.mark.parametrize("degree", [1, 2, 3, 5, 8])
def test_points_and_weights_agree_with_legendre_zeros_and_moments(degree):
    np.testing.assert_allclose(radau_rule(degree).points, radau_points(degree), atol=1e-14)
    np.testing.assert_allclose(radau_rule(degree).weights, radau_weights(degree), atol=1e-13)


@pytest.mark.parametrize("degree", DEGREES)
def test_points_lie_in_order_with_the_right_end_exact(degree):
    rule = radau_rule(degree)
    assert rule.points[0] > 0.0
    assert np.all(np.diff(rule.nodes) > 0.0)
    assert rule.points[-1] == 1.0


@pytest.mark.parametrize("degree", DEGREES)
def test_quadrature_is_exact_to_degree_two_d_minus_two(degree):
    rule = radau_rule(degree)
    for power in range(2 * degree - 1):
        assert rule.weights @ rule.points**power == pytest.approx(1 / (power + 1), rel=1e-12)


@pytest.mark.parametrize("degree", [1, 2, 3, 5, 8])
def test_quadrature_is_exact_no_further(degree):
    rule = radau_rule(degree)
    # Largest power that rounding lets be told apart: the error falls by 16 per degree.
    power = 2 * degree - 1
    assert abs(rule.weights @ rule.points**power - 1 / (power + 1)) > 1e-13


@pytest.mark.parametrize("degree", DEGREES)
def test_differentiation_is_exact_for_the_element_polynomials(degree):
    rule = radau_rule(degree)
    for power in range(degree + 1):
        expected = power * rule.points ** max(power - 1, 0)
        found = rule.differentiation @ rule.nodes**power
        np.testing.assert_allclose(found, expected, atol=1e-11 * degree**2)


@pytest.mark.parametrize("degree", DEGREES)
def test_slope_at_start(degree):
    rule = radau_rule(degree)
    found = [rule.slope_at_start @ rule.nodes**power for power in range(degree + 1)]
    np.testing.assert_allclose(found, np.eye(degree + 1)[1], atol=1e-11 * degree**2)


@pytest.mark.parametrize("degree", DEGREES)
def test_integration_undoes_differentiation(degree):
    rule = radau_rule(degree)
    for power in range(degree):
        expected = rule.points ** (power + 1) / (power + 1)
        np.testing.assert_allclose(rule.integration @ rule.points**power, expected, atol=1e-12)
    np.testing.assert_allclose(rule.integration[-1], rule.weights, atol=1e-12)


@pytest.mark.parametrize("degree", DEGREES[1:])
def test_interpolation_reproduces_polynomials_and_nodes(degree):
    nodes = radau_rule(degree).nodes
    targets = np.concatenate([np.linspace(0, 1, 17), nodes])
    matrix = interpolation_matrix(nodes, targets)
    for power in range(degree + 1):
        np.testing.assert_allclose(matrix @ nodes**power, targets**power, atol=1e-12)
    np.testing.assert_array_equal(matrix[17:], np.eye(degree + 1))


@pytest.mark.parametrize("degree", DEGREES[1:])
def test_controls_are_held_to_a_limit_that_they_pass_for_a_moment_only(degree):
    random, times = np.random.default_rng(degree), np.linspace(0.0, 1.0, 1001)
    for _ in range(4):
        values = random.uniform(-1.0, 1.0, size=(degree, 1))
        free = control_polynomial(Mesh.uniform(1, degree), values, 0, 0.0, 1.0)
        peak = max(float(free(t)[0]) for t in times)
        limits = np.array([-np.inf]), np.array([peak - 1e-6])
        held = control_polynomial(Mesh.uniform(1, degree), values, 0, 0.0, 1.0, limits)
        assert max(float(held(t)[0]) for t in times) <= limits[1][0]


@pytest.mark.parametrize("degree", [0, -1])
def test_degree_below_one_is_refused(degree):
    with pytest.raises(TranscriptionError, match=f"element degree = {degree}; must be at least 1"):
        radau_rule(degree)


def test_rules_cannot_be_changed_behind_the_cache():
    with pytest.raises(ValueError, match="read-only"):
        radau_rule(3).points[0] = 0.5


def test_the_fraction_at_one_time_is_that_of_many_times():
    times = np.array([2.0, 3.5, 4.0, 9.0])
    for kept in (slice(None), slice(0, 4, 3)):
        timeline = Timeline(fractions=np.array([0.0, 0.25, 0.5, 1.0])[kept], times=times[kept])
        asked = np.sort(np.append(np.linspace(2.0, 9.0, 50), times))
        found = [timeline.fraction_at(float(time)) for time in asked]
        assert found == pytest.approx(timeline.fraction(asked), rel=1e-14, abs=1e-15)
