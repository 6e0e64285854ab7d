import itertools

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pyomo_quad.sweep.design import Dimension
from pyomo_quad.sweep.statistics import SweepResults, best_along, pareto_front
from tests.sweep.studies import made_design

A = Dimension(paths=("a",), steps=((1.0,), (2.0,), (3.0,)))
B = Dimension(paths=("b",), steps=((0.0,), (10.0,), (20.0,)))
NAME = Dimension(paths=("name",), steps=(("calm",), ("windy",)))


def design(*dimensions: Dimension, base=()):
    return made_design(*dimensions, base=base, report_on="y")


def grid() -> pd.DataFrame:
    frame = pd.DataFrame(
        itertools.product((1.0, 2.0, 3.0), (0.0, 10.0, 20.0), ("calm", "windy")),
        columns=["a", "b", "name"],
    )
    frame["y"] = 100.0 * frame["a"] + frame["b"] + (frame["name"] == "windy") * 5.0
    return frame.assign(status="finished")


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), min_size=1, max_size=30))
def test_no_row_beats_a_row_of_the_front_and_every_other_row_is_beaten(points):
    frame = pd.DataFrame(points, columns=["time", "energy"])
    front = {tuple(row) for row in pareto_front(frame, "time", "energy").to_numpy()}

    def is_beaten(point):
        return any(
            other[0] <= point[0] and other[1] <= point[1] and other != point for other in points
        )

    assert front == {point for point in points if not is_beaten(point)}


def test_curves_are_one_for_each_combination_of_the_rest():
    curves = SweepResults(design(A, B, NAME), grid()).curves_along("a")
    assert len(curves) == 6
    assert curves[1].fixed == {"b": 0.0, "name": "windy"}
    assert list(curves[1].rows["y"]) == [105.0, 205.0, 305.0]


def test_plane_leaves_a_hole_where_a_case_failed():
    frame = grid()
    frame.loc[(frame["a"] == 3.0) & (frame["b"] == 20.0), "status"] = "failed"
    plane = SweepResults(design(A, B, NAME), frame).plane(A, B, "y")
    expected = [[105, 205, 305], [115, 215, 315], [125, 225, np.nan]]
    np.testing.assert_array_equal(plane.to_numpy(), expected)


def test_sensitivities_of_a_grid_are_its_range_through_the_middle():
    first, second = SweepResults(design(A, B, NAME), grid()).sensitivities("y")
    assert (first.field, first.least, first.greatest) == ("a", 115.0, 315.0)
    assert (second.field, second.least_at, second.greatest_at) == ("b", 0.0, 20.0)
    assert second.swing == 20.0


def test_the_central_case_is_that_of_the_base_scenario_for_an_entry_of_a_list_too():
    first, second = "mission.goal.position[0]", "b"
    place = Dimension(paths=(first,), steps=((1.0,), (5.0,), (9.0,)))
    base = {"mission": {"goal": {"position": [1.0, 2.0, 3.0]}}, "b": 10.0}
    frame = grid().rename(columns={"a": first}).query("name == 'calm'")
    frame[first] = frame[first].map({1.0: 1.0, 2.0: 5.0, 3.0: 9.0})
    found = SweepResults(design(place, B, base=base), frame).sensitivities("y")
    (of_b,) = (one for one in found if one.field == second)
    assert (of_b.least, of_b.greatest) == (100.0, 120.0)


def test_sensitivity_to_an_angle_does_not_hang_on_where_the_circle_was_cut():
    angles = [0.0, 90.0, 180.0, 270.0]
    around = Dimension(paths=("angle",), steps=tuple((angle,) for angle in angles))
    frame = pd.DataFrame({"angle": angles, "y": [5.0, 9.0, 5.0, 1.0]}).assign(status="finished")
    (found,) = SweepResults(design(around), frame).sensitivities("y")
    assert (found.least, found.least_at, found.greatest, found.greatest_at) == (1, 270, 9, 90)


def test_sensitivities_of_random_fields_are_the_slopes_of_a_linear_quantity():
    generator = np.random.default_rng(1)
    draws = generator.normal(size=(200, 2))
    drawn = Dimension(paths=("a", "b"), steps=tuple(map(tuple, draws.tolist())), is_random=True)
    frame = pd.DataFrame(draws, columns=["a", "b"]).assign(status="finished")
    frame["y"] = 7.0 + 3.0 * frame["a"] - 0.5 * frame["b"]
    found = SweepResults(design(drawn), frame).sensitivities("y")
    assert [one.field for one in found] == ["a", "b"]
    slopes = [one.swing / (one.greatest_at - one.least_at) for one in found]
    assert slopes == pytest.approx([3.0, -0.5])


def test_sensitivities_and_maps_go_through_the_base_case_where_the_grid_holds_it():
    based = design(A, B, NAME, base={"a": 1.0, "b": 20.0, "name": "windy"})
    first, second = SweepResults(based, grid()).sensitivities("y")
    assert (first.least, first.greatest, second.least) == (125.0, 325.0, 105.0)
    assert first.base == second.base == 125.0
    plane = SweepResults(based, grid()).plane(A, B, "y")
    assert plane.loc[20.0, 1.0] == 125.0
    half = design(A, B, NAME, base={"a": 1.5, "b": 20.0, "name": "windy"})
    assert SweepResults(half, grid()).sensitivities("y")[0].base == 225.0


def test_a_base_case_that_failed_has_no_value():
    frame = grid()
    frame.loc[(frame["a"] == 2.0) & (frame["b"] == 10.0), "status"] = "failed"
    assert all(
        np.isnan(one.base) for one in SweepResults(design(A, B, NAME), frame).sensitivities("y")
    )


def test_the_spread_is_that_of_the_cases_and_its_linear_share_that_of_a_regression():
    generator = np.random.default_rng(2)
    draws = generator.normal(size=(300, 2))
    drawn = Dimension(paths=("a", "b"), steps=tuple(map(tuple, draws.tolist())), is_random=True)
    frame = pd.DataFrame(draws, columns=["a", "b"]).assign(status="finished", case=range(300))
    frame["y"] = frame["a"] + frame["b"] ** 2
    spread = SweepResults(design(drawn), frame).spread("y")
    assert (spread.least, spread.greatest) == (frame["y"].min(), frame["y"].max())
    assert spread.greatest_case == frame["y"].argmax()
    # Share explained = 1 - 1 / (K^-1)_00 of the correlations K of y with the fields.
    inverse = np.linalg.inv(frame[["y", "a", "b"]].corr().to_numpy())
    assert spread.linear_share == pytest.approx(1.0 - 1.0 / inverse[0, 0])
    (straight, _) = SweepResults(design(drawn), frame).sensitivities("y")
    assert straight.swing < 0.7 * (spread.greatest - spread.least)


@pytest.mark.parametrize(
    ("energies", "place"),
    [
        ([3.0, 1.0, 2.0], (2.0, 1.0, 3.0, True)),
        ([1.0, 2.0, 3.0], (1.0, None, 2.0, False)),
        ([3.0, 2.0, 1.0], (3.0, 2.0, None, False)),
        ([None, 1.0, 2.0], (2.0, 1.0, 3.0, False)),
        ([2.0, 1.0, None], (2.0, 1.0, 3.0, False)),
    ],
)
def test_the_best_is_inside_only_where_dearer_cases_lie_on_both_sides(energies, place):
    frame = pd.DataFrame({"a": [1.0, 2.0, 3.0], "y": energies})
    frame["status"] = ["failed" if energy is None else "finished" for energy in energies]
    (curve,) = SweepResults(design(A), frame).curves_along("a")
    best = best_along(curve, "a", "y", A.values("a"))
    assert (best.at, best.below, best.above, best.is_inside) == place
