"""A reactor of three phases with a limit that grows with a free time: its published optimum.

Betts (2010), example 6.15, after Leineweber: 3.16466910 h at a final time of 1.7468208 h.
"""

import pytest

from pyomo_quad.collocation import Mesh, compile
from tests.problems.published.chemistry import kinetic_reactor, kinetic_times

# Fractions of the declared horizon: two elements in the first phase, three and four in the others.
EDGES = (0.0, 0.0025, 0.005, 0.08, 0.17, 0.25, 0.4, 0.6, 0.8, 1.0)


@pytest.mark.slow
def test_the_kinetic_batch_reactor_on_one_mesh():
    m = kinetic_reactor()
    problem = compile(m, times=kinetic_times(m))
    rough = problem.solve(mesh=Mesh(breakpoints=EDGES, degrees=(4,) * 9))
    found = problem.solve(mesh=Mesh(breakpoints=EDGES, degrees=(7,) * 9), warm_start=rough)
    assert found.is_converged
    assert found.objective == pytest.approx(3.16466910, rel=2e-5)
    assert found.horizon[1] == pytest.approx(1.7468208, rel=2e-4)
    assert found.value(m.T2) == pytest.approx(found.horizon[1] / 4, rel=1e-9)
