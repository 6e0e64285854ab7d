"""The random missions are what they say, and their zones those of the package by other formulas."""

import numpy as np
import pytest

from pyomo_quad.scenario import load_scenario
from tests.benchmarks.random_places import depth, missions
from tests.benchmarks.robustness import BASE


def test_missions_are_sound_and_zones_are_where_they_are_written():
    shapes = set()
    for settings in list(missions(8, 1))[4:]:
        told = load_scenario(BASE, settings)
        assert 1 <= len(told.mission.waypoints) <= 4
        places = np.random.default_rng(0).uniform(-12.0, 12.0, size=(50, 3))
        for zone in told.airspace.keep_out:
            shapes.add(zone.shape)
            assert depth(zone, places) == pytest.approx(zone.depth(places), abs=1e-12)
    assert len(shapes) > 1


def test_equal_seeds_draw_equal_missions():
    assert list(missions(3, 7)) == list(missions(3, 7)) != list(missions(3, 8))
