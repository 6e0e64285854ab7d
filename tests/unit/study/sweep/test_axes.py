import numpy as np
import pytest
from pydantic import ValidationError
from scipy import stats

from pyomo_quad.sweep.design import Axis
from pyomo_quad.sweep.study_file import Sampling


def axis(**given) -> Axis:
    return Axis(path="mission.duration", **given)


def test_linear_and_logarithmic_values_hold_both_ends():
    steps = axis(linear={"first": 0.1, "last": 0.3, "count": 3}).spaced_values()
    assert steps == (0.1, 0.2, 0.3)
    ratios = axis(logarithmic={"first": 0.01, "last": 100.0, "count": 5}).spaced_values()
    assert ratios == (0.01, 0.1, 1.0, 10.0, 100.0)


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        ({}, "exactly one of"),
        ({"values": [1.0], "linear": {"first": 0.0, "last": 1.0, "count": 2}}, "exactly one of"),
        ({"logarithmic": {"first": 0.0, "last": 1.0, "count": 2}}, "first and last > 0"),
        ({"uniform": {"low": 1.0, "high": 1.0}}, "low < high"),
        ({"uniform": {"low": 0.0, "high": 1.0}, "group": "g"}, "must have no group"),
        ({"values": [float("nan")]}, "finite numbers"),
    ],
)
def test_an_axis_that_makes_no_sense_is_refused(given, complaint):
    with pytest.raises(ValidationError, match=complaint):
        axis(**given)


def test_normal_draws_follow_the_distribution():
    probabilities = Sampling(count=4000, seed=3).draw(1)[:, 0]
    drawn = axis(normal={"mean": 2.0, "standard_deviation": 0.5}).drawn_values(probabilities)
    assert stats.kstest(drawn, stats.norm(2.0, 0.5).cdf).pvalue > 0.5


def test_latin_hypercube_has_one_sample_in_each_stratum_of_each_axis():
    draws = Sampling(count=50, seed=1).draw(3)
    assert (np.sort(np.floor(draws * 50), axis=0) == np.arange(50)[:, np.newaxis]).all()


def test_random_draws_can_be_extended_and_depend_on_the_seed():
    short = Sampling(count=10, seed=5, method="random").draw(2)
    assert (Sampling(count=30, seed=5, method="random").draw(2)[:10] == short).all()
    assert (Sampling(count=10, seed=6, method="random").draw(2) != short).all()
