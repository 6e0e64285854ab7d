"""The mesh: its arithmetic and what it refuses."""

import numpy as np
import pytest

from pyomo_quad.collocation import Mesh, TranscriptionError

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
