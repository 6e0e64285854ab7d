"""What becomes of an element in which the control of the bang-bang car jumps."""

import numpy as np
import pytest

from pyomo_quad import collocation
from pyomo_quad.collocation import Mesh, RefinementOptions
from pyomo_quad.collocation.refining.error import estimate_error
from pyomo_quad.collocation.refining.remeshing import Marks, refined_mesh
from tests.problems.bang_bang import SWITCH, build

TOLERANCE = 1e-6


def refined(mesh, element):
    solution = collocation.compile(build()).solve(mesh=mesh)
    return refined_mesh(
        solution,
        estimate_error(solution),
        Marks(coarse=frozenset({element}), kept=frozenset(range(mesh.elements)) - {element}),
        TOLERANCE,
        RefinementOptions(),
    )


def test_a_jump_is_isolated_in_a_sliver():
    mesh = Mesh(breakpoints=(0.0, 0.3, 0.9, 1.0), degrees=(4, 4, 4))
    finer = refined(mesh, 1)
    assert finer.degrees == (4, 4, 1, 4, 4)
    start, end = finer.breakpoints[2:4]
    assert start < SWITCH < end
    assert end - start < 0.1 * (0.9 - 0.3)


def test_an_element_beside_a_sliver_is_split_by_thirds():
    mesh = Mesh(breakpoints=(0.0, 0.3, 0.302, 0.9, 1.0), degrees=(4, 1, 4, 4))
    finer = refined(mesh, 2)
    assert finer.degrees == (4, 1, 4, 4, 4, 4)
    assert np.diff(finer.breakpoints[2:6]) == pytest.approx(np.full(3, 0.598 / 3))
