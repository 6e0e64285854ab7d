"""Where solves begin: a warm start begins at the optimum that it comes from."""

from contextlib import contextmanager
from dataclasses import dataclass
from types import SimpleNamespace

import cyipopt
import numpy as np
import pytest

from pyomo_quad.collocation.program import ipopt


@dataclass(frozen=True, kw_only=True)
class Start:
    """A point that Ipopt was given, with its multipliers for a warm start.

    Attributes
    ----------
    is_warm : bool
        Whether multipliers were given.
    infeasibility : float
        Largest violation of a row or a bound.
    stationarity : float
        Largest component of the Lagrangian's gradient, as a share of the largest of its terms.
    """

    is_warm: bool
    objective: float
    infeasibility: float
    stationarity: float


def start_of(program, bounds, z, rows, lower, upper):
    is_warm = rows is not None
    if not is_warm:
        rows, lower, upper = (np.zeros(n) for n in (program.n_rows, z.size, z.size))
    values = program.constraints(z)
    violations = (
        bounds["cl"] - values,
        values - bounds["cu"],
        bounds["lb"] - z,
        z - bounds["ub"],
    )
    pulls = np.zeros(z.size)
    at_row, at_unknown = program.jacobianstructure()
    products = program.jacobian(z) * rows[at_row]
    np.add.at(pulls, at_unknown, products)
    gradient = program.gradient(z)
    terms = (gradient, products, lower, upper)
    largest = max(np.abs(term).max(initial=0.0) for term in terms)
    is_free = bounds["lb"] < bounds["ub"]
    left = (gradient + pulls - lower + upper)[is_free]
    return Start(
        is_warm=is_warm,
        objective=(-1.0 if program.is_negated else 1.0) * float(program.objective(z)),
        infeasibility=max(float(v.max(initial=0.0)) for v in violations),
        stationarity=float(np.abs(left).max(initial=0.0) / (largest or 1.0)),
    )


@contextmanager
def noted_starts():
    """Give the list of all starts that Ipopt is given inside the block."""
    starts: list[Start] = []

    class Noting(cyipopt.Problem):
        def __init__(self, *, problem_obj, **sizes):
            super().__init__(problem_obj=problem_obj, **sizes)
            self.noted = problem_obj.program, sizes

        def solve(self, z, **multipliers):
            held = (multipliers.get(name) for name in ("lagrange", "zl", "zu"))
            starts.append(start_of(*self.noted, z, *held))
            return super().solve(z, **multipliers)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ipopt, "cyipopt", SimpleNamespace(Problem=Noting))
        yield starts


def assert_begins_at(start, optimum, *, is_the_same=True):
    """Assert that a start is the point and the multipliers of an optimum.

    Of a program whose numbers have changed since only its objective and its Lagrangian are alike.
    """
    assert start.is_warm
    assert start.objective == pytest.approx(optimum.objective, rel=1e-9)
    assert start.stationarity < 1e-6
    if is_the_same:
        assert start.infeasibility < 1e-6
