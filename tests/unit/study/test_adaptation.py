"""What adaptation does about a steady wind, against the law's own equilibrium worked by hand."""

from math import sqrt

import numpy as np
import pytest

from pyomo_quad.study.comparison import ERROR_WITH, ERROR_WITHOUT, ESTIMATED, TRUE, adaptation_study
from tests import flights

WIND = 1.0
HOLD = (
    "wind.use='constant'",
    f"wind.speed={WIND}",
    "mission.goal.position=[0.0, 0.0, 0.0]",
    "mission.duration=8.0",
)


@pytest.fixture(scope="module")
def held():
    scenario = flights.scenario("paper_calm", *HOLD)
    return adaptation_study(scenario, dynamics=flights.vehicle("paper_calm", *HOLD))


def test_without_adaptation_a_steady_wind_leaves_a_steady_error(held):
    gains = flights.scenario("paper_calm", *HOLD).baseline.gains
    k1, k2, kappa = gains.position, gains.velocity, gains.force_identification
    # All rates zero: z = k1 s' and k1^2 s' + kappa z = d for the compensated error s', and the
    # effort k1^2 s' + k1 k2 s, cut off smoothly, carries d.
    compensated = WIND / (k1**2 + kappa * k1)
    effort = WIND / sqrt(1 - (WIND / gains.acceleration_max) ** 2)
    bent = (effort - k1**2 * compensated) / (k1 * k2)
    expected = bent / sqrt(1 - (bent * k1 / gains.speed_max) ** 2)
    last = held[held["time_s"] > 6.0][ERROR_WITHOUT]
    assert expected > 0.2
    assert np.ptp(last) < 0.01 * expected
    assert last.iloc[-1] == pytest.approx(expected, rel=1e-3)


def test_with_adaptation_the_error_vanishes_and_the_wind_is_known(held):
    last = held.iloc[-1]
    assert last[ERROR_WITH] < 1e-3
    assert last[list(TRUE)].tolist() == pytest.approx([WIND, 0.0, 0.0], abs=1e-12)
    assert last[list(ESTIMATED)].tolist() == pytest.approx([WIND, 0.0, 0.0], abs=1e-4)


@pytest.mark.lengthy
def test_in_the_papers_wind_adaptation_takes_most_of_the_error_away():
    scenario = flights.scenario("paper_wind")
    table = adaptation_study(scenario, dynamics=flights.vehicle("paper_wind"))
    under_way = table[table["time_s"] > 1.0]
    assert under_way[ERROR_WITH].max() < 0.15
    assert under_way[ERROR_WITHOUT].max() > 1.0
    assert under_way[ERROR_WITH].mean() < 0.1 * under_way[ERROR_WITHOUT].mean()
