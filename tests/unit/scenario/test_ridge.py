"""The shipped ridge: its files hold the formulas of its script, and air is conserved."""

import runpy

import numpy as np
import pytest

from pyomo_quad.scenario import load_scenario
from tests.command import SCENARIOS

RIDGE = runpy.run_path(str(SCENARIOS / "ridge" / "make_data.py"))
PLACES = np.array([[700.0, 100.0, 80.0], [1000.0, 60.0, 95.0], [1300.0, -200.0, 100.0]]).T


def test_the_files_hold_the_formulas():
    told = load_scenario(SCENARIOS / "ridge.toml")
    ground, grid = told.airspace.ground, told.wind.grid
    x, y = np.meshgrid(ground.x, ground.y, indexing="ij")
    assert ground.elevations == pytest.approx(RIDGE["ground"](x, y), abs=1e-5)
    axes = np.meshgrid(*grid.axes, indexing="ij")
    assert grid.components == pytest.approx(RIDGE["air"](*axes), abs=1e-6)


def test_the_air_has_neither_divergence_nor_curl_and_follows_gentle_slopes():
    step = 1e-2
    slope = np.empty((3, 3, PLACES.shape[1]))  # of component, along axis
    for axis in range(3):
        off = step * np.eye(3)[axis][:, None]
        ahead, behind = RIDGE["air"](*(PLACES + off)), RIDGE["air"](*(PLACES - off))
        slope[:, axis] = (ahead - behind) / (2 * step)
    assert np.trace(slope) == pytest.approx(np.zeros(3), abs=1e-9)
    assert slope == pytest.approx(np.swapaxes(slope, 0, 1), abs=1e-9)
    assert np.abs(slope).max() > 1e-3
    # Linear flow follows the ground where it is read at the foot of the hills.
    x, y = PLACES[:2]
    ground, (east, north) = RIDGE["ground"], RIDGE["WIND"]
    along_x = (ground(x + step, y) - ground(x - step, y)) / (2 * step)
    along_y = (ground(x, y + step) - ground(x, y - step)) / (2 * step)
    rising = RIDGE["air"](x, y, 0.0 * x)[2]
    assert rising == pytest.approx(east * along_x + north * along_y, abs=1e-6)
