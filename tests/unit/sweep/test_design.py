"""Axes, their values and draws, and the tree of cases that they span."""

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy import stats

from pyomo_quad.sweep.case import StudyTask
from pyomo_quad.sweep.design import (
    Axis,
    Dimension,
    SweepDesign,
    bisection_parents,
    case_key,
    expand,
)
from pyomo_quad.sweep.study_file import Sampling
from tests.sweep.studies import made_design


def design(*sizes: int) -> SweepDesign:
    return made_design(
        *(
            Dimension(paths=(f"field_{index}",), steps=tuple((float(k),) for k in range(size)))
            for index, size in enumerate(sizes)
        )
    )


def depth(parents, node) -> int:
    count = 0
    while parents[node] is not None:
        node, count = parents[node], count + 1
    return count


@given(st.integers(1, 300))
def test_bisection_tree_has_one_root_and_logarithmic_depth(count):
    parents = bisection_parents(count)
    assert parents.count(None) == 1
    assert max(depth(parents, node) for node in range(count)) <= math.log2(count)


@given(st.lists(st.integers(1, 6), min_size=1, max_size=4))
def test_every_case_descends_from_the_first_and_differs_in_one_field_from_its_parent(sizes):
    cases = expand(design(*sizes))
    assert [case.position for case in cases] == list(range(math.prod(sizes)))
    assert len({case.key for case in cases}) == len(cases)
    parents = [case.parent for case in cases]
    assert parents.count(None) == 1
    for case in cases:
        depth(parents, case.position)
        if case.parent is not None:
            other = cases[case.parent].overrides
            assert sum(case.overrides[path] != other[path] for path in other) == 1


def test_cases_that_are_only_flown_wait_for_nothing():
    flown = SweepDesign(**{**vars(design(3, 4)), "task": StudyTask.FLY_PLAN})
    assert {case.parent for case in expand(flown)} == {None}


def test_neighbours_are_those_by_value_and_not_by_place_in_the_file():
    shuffled = Dimension(paths=("a",), steps=((3.0,), (1.0,), (2.0,)))
    cases = expand(SweepDesign(**{**vars(design(1)), "dimensions": (shuffled,)}))
    assert [case.parent for case in cases] == [2, 2, None]


def test_last_dimension_varies_fastest():
    cases = expand(design(2, 3))
    assert [tuple(case.overrides.values()) for case in cases[:4]] == [
        (0.0, 0.0),
        (0.0, 1.0),
        (0.0, 2.0),
        (1.0, 0.0),
    ]


def test_key_does_not_hang_on_the_order_of_fields():
    assert case_key({"a": 1.0, "b": 2.0}) == case_key({"b": 2.0, "a": 1.0})
    assert case_key({"a": 1.0}) != case_key({"a": 1.5})


def test_design_survives_json_and_refuses_other_json():
    one = design(2, 3)
    assert SweepDesign.from_json(one.to_json()) == one
    for text in ("[]", "{}", '"x"', json.dumps({"dimensions": [1]})):
        with pytest.raises(ValueError, match="not a sweep design"):
            SweepDesign.from_json(text)


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
