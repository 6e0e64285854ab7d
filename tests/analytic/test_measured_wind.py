"""A wind measured over time, in missions whose times a plan chooses, against SciPy's splines."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from pyomo_quad.model.wind import still_air
from tests.declared_model import scenario
from tests.flights import PLANNER

TIMES = np.linspace(0.0, 30.0, 61)
SPEEDS = {"x": 3.0 * np.sin(TIMES / 2.0), "y": 2.0 * np.cos(TIMES / 3.0)}
GOAL = {"goal": {"position": [6.0, 7.0, 8.0]}}
FREE = GOAL | {"duration": "free"}
PASSING = {"waypoints": [{"position": [3.0, 4.0, 4.0]}]}


@pytest.fixture
def blown(tmp_path):
    """Missions in a measured wind."""
    rows = [",".join(f"{n:.17g}" for n in row) for row in zip(TIMES, *SPEEDS.values(), strict=True)]
    file = tmp_path / "wind.csv"
    file.write_text("\n".join(["time_s,wind_x_m_per_s,wind_y_m_per_s", *rows]) + "\n")

    def told(mission, **tables):
        wind = {"use": "calm", "file": str(file), "coupling": "drag"} | tables.pop("wind", {})
        return scenario(mission=mission, wind=wind, **tables)

    return told


# At proof, the energy of a plan is that of the solution, on whichever mesh.
PROOF = {"accuracy": "proof"}
COARSE = {"solver": PROOF | {"elements": 8, "max_refinements": 0}}


def flown_in(plan, offset=0.0):
    """The largest miss of the wind along a plan from the spline through the file's rows [m/s]."""
    flight = plan.to_frame()
    spline = {name: CubicSpline(TIMES, row)(flight.index + offset) for name, row in SPEEDS.items()}
    return max(np.abs(flight[f"wind_{name}_m_per_s"] - spline[name]).max() for name in SPEEDS)


@pytest.mark.lengthy
def test_waypoints_are_passed_in_the_measured_wind(blown):
    told = blown(GOAL | {"duration": 10.0} | PASSING, wind={"time_offset": 7.3})
    plan = PLANNER.solve(told)
    assert plan.is_verified
    assert flown_in(plan, offset=7.3) < 1e-9


@pytest.mark.lengthy
def test_a_chosen_time_costs_what_the_same_time_costs_when_given(blown):
    """Where times are given the wind is numbers at the points; where chosen, a formula of time."""
    chosen = PLANNER.solve(blown(FREE, **COARSE))
    assert chosen.solution.status.is_solved
    assert flown_in(chosen) < 1e-9
    at = chosen.duration_s
    given = [
        PLANNER.solve(blown(GOAL | {"duration": share * at}, **COARSE)).energy
        for share in (0.99, 1.0, 1.01)
    ]
    assert chosen.energy == pytest.approx(given[1], rel=1e-6)
    # It is the best time: the wind's slope is in the derivative by which it was found.
    assert min(given[0], given[2]) > chosen.energy


@pytest.mark.slow
@pytest.mark.parametrize("passing", [{}, PASSING])
def test_a_plan_of_free_duration_is_verified_in_its_measured_wind(blown, passing):
    chosen = PLANNER.solve(blown(FREE | passing, solver=PROOF))
    given = PLANNER.solve(blown(GOAL | {"duration": chosen.duration_s} | passing, solver=PROOF))
    assert chosen.is_verified
    assert flown_in(chosen) < 1e-9
    assert chosen.energy == pytest.approx(given.energy, rel=1e-6)


def winds(dynamics, times):
    """The wind along x at some times [m/s]."""
    states = np.ones((len(times), 1)) * list(dynamics.initial_states().values())
    controls = np.ones((len(times), len(dynamics.control_names)))
    return dynamics.evaluate("wind.velocity_x", np.array(times), states, controls)


@pytest.mark.parametrize("duration", ["free", 80.0])
def test_after_its_last_row_the_wind_is_held(blown, duration):
    """A controlled flight may take longer than the plan whose wind the file covers."""
    told = blown(FREE)
    dynamics = PLANNER.dynamics(told if duration == "free" else told.lasting(duration))
    inside = np.linspace(0.0, 29.5, 60)
    spline = CubicSpline(TIMES, SPEEDS["x"])
    np.testing.assert_allclose(winds(dynamics, inside), spline(inside), atol=1e-9)
    np.testing.assert_allclose(winds(dynamics, (31.0, 60.0, 80.0)), SPEEDS["x"][-1], atol=1e-9)
    ending = winds(dynamics, np.linspace(29.0, 31.0, 2001))
    assert np.max(np.abs(np.diff(ending, 2))) < 0.05 * np.max(np.abs(np.diff(ending)))


def test_still_air_stills_it(blown):
    told = blown(FREE)
    problem, _ = PLANNER.problem_for(told)
    still = problem.dynamics(parameters=PLANNER.parameters(told) | still_air(problem.model))
    np.testing.assert_array_equal(winds(still, (0.0, 3.0, 9.0)), 0.0)


@pytest.mark.lengthy
def test_missions_of_other_longest_times_read_other_rows(blown):
    """A model has the rows that its longest flight reads: another flight needs a model anew."""
    for longest in (1.0, 29.0):
        dynamics = PLANNER.dynamics(blown(FREE | {"duration_max": longest}))
        expected = CubicSpline(TIMES, SPEEDS["x"])(longest)
        assert winds(dynamics, (longest,))[0] == pytest.approx(expected, abs=1e-9)


def test_a_free_duration_ends_where_the_wind_does(blown):
    told = blown(FREE, wind={"time_offset": 2.0, "forecast": {"use": "calm"}})
    assert told.mission.duration_limits[1] == 28.0
    assert told.provenance["mission.duration_max"].startswith("file ")
    assert blown(FREE | {"duration_max": 9.0}).mission.duration_max == 9.0
    both = {"forecast": {"file": told.wind.file, "time_offset": 5.0}, "time_offset": 1.0}
    assert blown(FREE, wind=both).mission.duration_max == 25.0
    fixed = told.with_values({"mission.duration": 9.0})
    assert fixed.mission.duration_max is None
