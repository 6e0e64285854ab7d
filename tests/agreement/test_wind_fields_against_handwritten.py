"""Flights through wind fields that are formulas against programs written by hand in CasADi.

The package is given each field on a grid; the program by hand has its formula.
"""

import casadi
import numpy as np
import pytest
import xarray as xr

from pyomo_quad.scenario import load_scenario
from tests.benchmarks.handwritten import solve_by_hand
from tests.command import PAPER_CALM
from tests.flights import PLANNER

DRAG = 0.3
CENTRE, CORE = (4.5, 2.0), 3.0


def shear(_x, y):
    return 0.4 * y, 0.0 * y


def vortex(x, y):
    """Gaussian vortex, whose stream function is a bell."""
    east, north = x - CENTRE[0], y - CENTRE[1]
    turning = 3.0 * casadi.exp(-(east**2 + north**2) / CORE**2)
    return -turning * north, turning * east


def jet(x, y):
    return 5.0 * casadi.exp(-(((y - 4.0) / 2.5) ** 2)), 0.0 * x


@pytest.mark.slow
@pytest.mark.parametrize("field", [shear, vortex, jet])
def test_the_optimum_in_a_field_is_that_of_a_program_by_hand(tmp_path, field):
    x, y = np.linspace(-6, 14, 81), np.linspace(-6, 16, 89)
    told = np.array([[[float(part) for part in field(a, b)] for b in y] for a in x])
    held = {name: (("x", "y"), told[..., k], {"units": "m s-1"}) for k, name in enumerate("uv")}
    xr.Dataset(held, {"x": x, "y": y}).to_netcdf(tmp_path / "field.nc")
    tables = {
        "vehicle": {"attitude": "paper", "drag_linear": DRAG},
        "wind": {"coupling": "drag", "field": str(tmp_path / "field.nc")},
    }
    plan = PLANNER.solve(load_scenario(PAPER_CALM, tables))
    assert plan.is_verified
    assert plan.energy == pytest.approx(solve_by_hand(40, 4, air=(DRAG, field)).energy_J, rel=1e-5)
    still = tables | {"wind": {"coupling": "drag"}}
    assert abs(PLANNER.solve(load_scenario(PAPER_CALM, still)).energy / plan.energy - 1) > 1e-3
