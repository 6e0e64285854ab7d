"""What a misplaced switch costs, where no error of an equation tells of it.

A velocity v = 2 - s, s the sign of y, is asked for by a penalty on what is left of the
complementarity.  Between s = -1 and s = 1 the optimum switches once, at y = -e just before zero,
which leaves a number to be found instead of a function.
"""

from dataclasses import replace

import numpy as np
import pytest

from pyomo_quad.collocation import Mesh, compile
from pyomo_quad.collocation.refining.error import estimate_error
from pyomo_quad.collocation.refining.switches import misplaced_switches
from tests.problems import bang_bang, double_integrator
from tests.problems.published.mechanics import COMPLEMENTARY_COST, complementary


@pytest.mark.lengthy
def test_a_penalised_complementarity_is_no_farther_off_than_claimed():
    solution = compile(complementary()).solve(tolerance=1e-6)
    assert solution.is_converged
    off = abs(solution.objective - COMPLEMENTARY_COST) / COMPLEMENTARY_COST
    assert off <= solution.error_estimate <= 1e-6


@pytest.mark.slow
def test_a_sharper_one_is_within_its_tolerance():
    """The estimate may be below the error: see docs/theory/refinement.md, "Error estimation"."""
    solution = compile(complementary()).solve(tolerance=1e-8)
    assert solution.is_converged
    off = abs(solution.objective - COMPLEMENTARY_COST) / COMPLEMENTARY_COST
    assert max(off, solution.error_estimate) <= 1e-8


@pytest.mark.parametrize("shift", [-0.01, 0.004, 0.02])
def test_a_switch_held_beside_its_place_costs_no_more_than_is_counted(shift):
    """A mesh whose one sliver holds the switch of the car in the wrong place."""
    switch = 2.0 / 3.0 + shift
    width = 3.0 * abs(shift)
    edges = (0.0, switch - width / 2.0, switch + width / 2.0, 1.0)
    mesh = Mesh(breakpoints=edges, degrees=(3, 1, 3))
    solution = compile(bang_bang.build()).solve(mesh=mesh)
    off = abs(solution.objective - bang_bang.objective())
    counted = misplaced_switches(solution) + estimate_error(solution).objective.sum() * 30.0
    assert off <= counted.sum()


def test_nothing_is_counted_where_nothing_switches():
    solution = compile(double_integrator.build()).solve(mesh=Mesh.uniform(5, 3))
    assert not np.any(misplaced_switches(solution))


def test_a_jump_counts_by_the_width_it_may_lie_in():
    """Costates that deny the jump of one another leave the smaller."""
    solution = compile(complementary()).solve(mesh=Mesh.uniform(10, 4))
    counted = misplaced_switches(solution)
    assert counted.max() > 0.01
    flat = replace(solution.costates, stages=np.zeros_like(solution.costates.stages))
    other = replace(solution)
    other.__dict__["costates"] = flat
    assert np.all(misplaced_switches(other) <= counted * (1.0 + 1e-12) + 1e-12)
