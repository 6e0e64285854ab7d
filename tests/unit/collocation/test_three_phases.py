"""A reactor of three phases with a limit that grows with a free time.

Betts (2010), example 6.15, after Leineweber: 3.16466910 at a final time of 1.7468208 h.
"""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from pyomo_quad.collocation import compile
from tests.problems.published.chemistry import kinetic_reactor, kinetic_times

# Equilibrium constants of the ions of y1, y3 and y5, mol/kg.
EQUILIBRIA = np.array([4.876e-14, 1.7884e-16, 2.575e-16])


def ions(y, exponent):
    return EQUILIBRIA * y[[0, 2, 4]] / (EQUILIBRIA + 10**-exponent)


def rates(y, kelvin, p):
    """Return the rates as published, with the exponent of the protons as the unknown."""

    def charge(exponent):
        return p - y[5] + 10**-exponent - ions(y, exponent).sum()

    u2, u3, u4 = ions(y, brentq(charge, 0, 15, xtol=1e-13, rtol=1e-13))
    forward = 1.3708e12 * np.exp(-9.2984e3 / kelvin)
    back = 1.6215e20 * np.exp(-1.3108e4 / kelvin)
    first = forward * y[1] * y[5] - back * u4
    second = 5.2282e12 * np.exp(-9.5999e3 / kelvin) * y[1] * u2
    third = forward * y[3] * y[5] - back / 2 * u3
    return [-second, -first - second, second + third, -third, first, -first - third]


@pytest.mark.slow
def test_the_kinetic_batch_reactor_is_flown_better_than_published():
    m = kinetic_reactor()
    found = compile(m, times=kinetic_times(m)).solve(tolerance=1e-6)
    assert found.is_converged
    p, turn, end = found.value(m.p), found.value(m.T2), found.horizon[1]
    assert turn == pytest.approx(end / 4, rel=1e-9)
    assert end == pytest.approx(1.7468208, rel=1e-4)
    assert end + 100 * p == pytest.approx(found.objective, rel=1e-9)

    def kelvin(t):
        return np.clip(found.value(m.kelvin, t), 293.15, 393.15)

    y = np.array([1.5776, 8.32, 0, 0, 0, p])
    edges = [found.timeline.time(fraction) for fraction in found.mesh.breakpoints]
    for start, stop in pairwise(edges):
        flown = solve_ivp(
            lambda t, y: rates(y, kelvin(t), p),
            (start, stop),
            y,
            method="LSODA",
            rtol=1e-9,
            atol=1e-12,
            t_eval=np.linspace(start, stop, 5),
        )
        if stop <= turn:
            assert np.all(flown.y[3] <= 2 * flown.t**2 + 1e-6)
        y = flown.y[:, -1]
    assert y[3] == pytest.approx(1, abs=2e-6)
    assert 3.1646 < found.objective < 3.16466910 - 4e-5
