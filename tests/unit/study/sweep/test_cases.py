import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pyomo_quad.sweep.case import StudyTask
from pyomo_quad.sweep.design import Dimension, SweepDesign, bisection_parents, case_key, expand


def design(*sizes: int) -> SweepDesign:
    return SweepDesign(
        name="grid",
        title="",
        about="",
        task=StudyTask.OPTIMISE,
        baselines=(),
        outputs=(),
        report_on=("energy_J",),
        base={},
        dimensions=tuple(
            Dimension(paths=(f"field_{index}",), steps=tuple((float(k),) for k in range(size)))
            for index, size in enumerate(sizes)
        ),
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
