"""A plan's file: what is saved comes back, and whatever is damaged is refused in one line."""

import json
import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor
from copy import deepcopy
from dataclasses import asdict, replace

import numpy as np
import pytest

from pyomo_quad import Plan
from pyomo_quad.flight import Planner
from pyomo_quad.flight.orders import OrderSearch
from pyomo_quad.flight.verification import verify_controls
from pyomo_quad.model import parameter_values
from pyomo_quad.report.tables import plan_summary
from pyomo_quad.scenario import ScenarioError
from tests.flights import PLANNER, plan, scenario
from tests.starts import noted_starts

COARSE = ("solver.tolerance=1e-5", "solver.elements=12")
RAGGED = object()
REAL = ("states", "controls", "energy", "costates", "hamiltonian")
STARTS = ("states", "lower_states", "upper_algebraics", "equations")
NUMBERS = ("energy", "hover_energy_J")


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    file = tmp_path_factory.mktemp("plan") / "plan.npz"
    plan("paper_calm", *COARSE).save(file)
    return file


@pytest.fixture(scope="module")
def parts(saved):
    with np.load(saved) as held:
        return {name: held[name] for name in held.files}


def test_a_plan_is_shown_in_one_short_line():
    line = repr(plan("paper_calm", *COARSE))
    assert line.startswith("<Plan scenario: paper_calm, status: verified, energy: ")
    assert "\n" not in line
    assert len(line) < 400


def test_all_that_is_saved_comes_back(saved):
    fresh, loaded = plan("paper_calm", *COARSE), Plan.load(saved)
    for name in ("scenario", "status", "message", "energy", "verification", "history", "attempts"):
        assert getattr(loaded, name) == getattr(fresh, name)
    assert loaded.trajectories.horizon == fresh.trajectories.horizon
    for name in REAL:
        np.testing.assert_array_equal(
            getattr(loaded.trajectories, name), getattr(fresh.trajectories, name)
        )


def test_the_search_for_an_order_comes_back(tmp_path):
    search = OrderSearch(order=(2, 0, 1), cost_J=1013.0, bound_J=1000.0, solved=7, legs=12)
    found = replace(plan("paper_calm", *COARSE), order_search=search)
    found.save(tmp_path / "plan.npz")
    assert Plan.load(tmp_path / "plan.npz").order_search == search
    told = plan_summary(found, wall_s={})["order"]
    assert told["waypoints"] == [2, 0, 1]
    assert told["gap_percent"] == pytest.approx(1.3)


@pytest.mark.lengthy
def test_a_loaded_plan_starts_another_solve_like_a_fresh_one(saved):
    longer = scenario("paper_calm", *COARSE).with_values({"mission.duration": 10.5})
    cold = Planner().solve(longer)
    fresh = plan("paper_calm", *COARSE)
    begun = []
    for held in (fresh, Plan.load(saved)):
        with noted_starts() as starts:
            warm = Planner().solve(longer, warm_start=held)
        begun.append(starts[0])
        assert warm.is_verified
        assert warm.energy == pytest.approx(cold.energy, rel=1e-5)
    assert begun[0].is_warm
    assert asdict(begun[1]) == pytest.approx(asdict(begun[0]), rel=1e-9)


def flown(held):
    """Fly a plan's controls; run in a process that has built no model."""
    path = held.trajectories
    verification, _ = verify_controls(
        held.dynamics, path.mesh, path.states, path.controls, path.horizon, held.energy
    )
    return held, verification


@pytest.mark.lengthy
def test_a_pickled_plan_flies_in_a_fresh_process_and_solves_again():
    fresh = plan("paper_calm", *COARSE)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        pickled, verification = pool.submit(flown, fresh).result()
    # Another process may round otherwise.
    assert verification.is_verified == fresh.verification.is_verified
    for name in ("flown_energy_J", "terminal_miss_m", "max_violation"):
        there, here = (getattr(found, name) for found in (verification, fresh.verification))
        assert there == pytest.approx(here, rel=1e-6, abs=1e-9)
    assert (pickled.scenario, pickled.energy) == (fresh.scenario, fresh.energy)
    np.testing.assert_array_equal(pickled.flown.states, fresh.flown.states)
    assert pickled.to_frame().equals(fresh.to_frame())
    assert pickled.dynamics.unit("rotors.omega") == "rad/s"
    again = pickled.solution.problem.solve(
        mesh=pickled.mesh,
        parameters=parameter_values(fresh.scenario),
        horizon=pickled.trajectories.horizon,
    )
    assert again.objective == pytest.approx(fresh.energy, rel=1e-9)


def test_a_deep_copied_plan_flies():
    fresh = plan("paper_calm", *COARSE)
    copied = deepcopy(fresh)
    assert copied.solution.problem is not fresh.solution.problem
    assert copied.to_frame().equals(fresh.to_frame())


@pytest.mark.lengthy
def test_a_vehicle_keeps_its_measured_wind_when_pickled(tmp_path):
    rows = "\n".join(f"{t},{np.sin(t)},{np.cos(2 * t)}" for t in range(12))
    (tmp_path / "wind.csv").write_text(f"time_s,wind_x_m_per_s,wind_y_m_per_s\n{rows}\n")
    windy = scenario("paper_calm", f"wind.file='{tmp_path / 'wind.csv'}'")
    model = Planner().dynamics(windy)
    restored = pickle.loads(pickle.dumps(model))
    times = np.linspace(0.0, windy.mission.duration, 57)
    states, controls = np.ones((57, len(model.state_names))), np.ones((57, 4))
    for name in ("wind.velocity_x", "wind.velocity_y"):
        pair = [held.evaluate(name, times, states, controls) for held in (restored, model)]
        np.testing.assert_allclose(*pair, rtol=0, atol=1e-11)
        assert np.ptp(pair[1]) > 1.0


def test_a_warm_start_without_some_conditions_is_left_aside(parts, tmp_path):
    name = "warm_start.conditions"
    file = tmp_path / "plan.npz"
    with file.open("wb") as stream:
        np.savez(stream, **parts | {name: parts[name][:-1]})
    found = PLANNER.solve(scenario("paper_calm", *COARSE), warm_start=Plan.load(file))
    assert found.energy == pytest.approx(plan("paper_calm", *COARSE).energy, rel=1e-5)


def with_about(parts, change):
    about = json.loads(parts["about"].tobytes())
    change(about)
    return parts | {"about": np.frombuffer(json.dumps(about).encode(), dtype=np.uint8)}


def set_field(path, value):
    def change(about):
        *steps, last = path
        for step in steps:
            about = about[step]
        if value is RAGGED:
            del about[last]
        else:
            about[last] = value

    return change


def damaged_array(array, how):
    flat = np.array(array)
    if how == "nan":
        flat.flat[0] = np.nan
    if how == "infinite":
        flat.flat[-1] = -np.inf
    return {
        "strings": array.astype(str),
        "complex": array + 0j,
        "whole numbers": array.astype(int),
        "truth": array > 0,
        "single precision": array.astype(np.float32),
        "one short": array[:-1],
        "empty": array[:0],
        "one axis more": array[..., None],
        "flat": array.ravel() if array.ndim > 1 else array[0],
        "objects": np.array([None, {}], dtype=object),
    }.get(how, flat)


HOW = (
    *("nan", "infinite", "strings", "complex", "truth", "objects", "whole numbers"),
    *("single precision", "one short", "empty", "one axis more", "flat"),
)


def assert_refused(tmp_path, parts, match):
    file = tmp_path / "plan.npz"
    with file.open("wb") as stream:
        np.savez(stream, **parts)
    with pytest.raises(ScenarioError, match=match) as caught:
        Plan.load(file)
    line = str(caught.value)
    assert len(line.splitlines()) == 1
    assert line.startswith(str(file))
    assert len(line) < len(str(file)) + 300


@pytest.mark.parametrize("how", HOW)
@pytest.mark.parametrize("name", [*REAL, "breakpoints", *(f"warm_start.{s}" for s in STARTS)])
def test_a_damaged_array_is_named(parts, name, how, tmp_path):
    broken = parts | {name: damaged_array(parts[name], how)}
    held = name.removeprefix("warm_start.")
    pattern = "is not a plan" if how == "objects" else f"{held}|mesh: |states: |algebraics: "
    assert_refused(tmp_path, broken, pattern)


@pytest.mark.parametrize("name", [*REAL, "breakpoints", "degrees", "warm_start.states", "about"])
def test_a_missing_array_is_named(parts, name, tmp_path):
    less = {held: array for held, array in parts.items() if held != name}
    assert_refused(tmp_path, less, f"{name}|is not a plan")


def test_an_array_of_another_kind_of_file_is_named(parts, tmp_path):
    assert_refused(tmp_path, parts | {"weights": np.zeros(3)}, "weights: is no array of a plan")


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("breakpoints", lambda held: held[::-1]),
        ("breakpoints", lambda held: 2.0 * held),
        ("breakpoints", lambda held: np.where(held == held[3], held[2], held)),
        ("degrees", lambda held: 0 * held),
        ("degrees", lambda held: held + 10**9),
        ("degrees", lambda held: held + 0.5),
        ("degrees", lambda held: held[None]),
        ("degrees", lambda held: held.astype(str)),
        ("degrees", lambda held: held + 1),
    ],
)
def test_what_is_no_mesh_is_refused(parts, name, array, tmp_path):
    assert_refused(tmp_path, parts | {name: array(parts[name])}, "mesh: |degrees: |states: has")


WRONG = ("8", None, [1.0], {"a": 1}, True, float("nan"), RAGGED)
FIELDS = [
    *((("plan", name), value) for name in NUMBERS for value in (*WRONG, float("inf"))),
    *((("plan", "error_estimate"), value) for value in WRONG),
    *((("plan", "status"), value) for value in ("perfect", 3, None, RAGGED)),
    *((("plan", "message"), value) for value in (3, None, ["a"], RAGGED)),
    *((("plan", "history"), value) for value in ("a", [1], [{}], {}, RAGGED)),
    *((("plan", "history", 0, "points"), value) for value in ("8", 1.5, None, RAGGED)),
    *((("plan", "history", 0, "error"), value) for value in WRONG),
    *((("plan", "verification"), value) for value in ("a", [], {}, None, RAGGED)),
    *((("plan", "verification", "is_verified"), value) for value in ("yes", 1, False, RAGGED)),
    *((("plan", "verification", "flown_energy_J"), value) for value in WRONG),
    *((("plan", "attempts"), value) for value in ("abc", [1], None, RAGGED)),
    *((("plan", "timings"), value) for value in ("abc", {"solve": "x"}, [1], RAGGED)),
    *((("plan",), value) for value in ("abc", None, [], {}, RAGGED)),
    *((("horizon",), value) for value in ([1], [0, 0], [2, 1], ["0", "1"], 3, [0, 1, 2], None)),
    *((("horizon", 1), value) for value in WRONG),
    *(
        ((f"{kind}_names",), value)
        for kind in ("state", "control", "costate")
        for value in ([], ["a"], "abc", [1, 2], None, RAGGED)
    ),
    *((("scenario",), value) for value in ("paper_calm", None, [], {}, RAGGED)),
    *((("scenario", "mission", "duration"), value) for value in ("10", -1.0, None, RAGGED)),
    *((("format",), value) for value in (1, "2", None, RAGGED)),
    *((("surprise",), value) for value in (1,)),
]


@pytest.mark.parametrize(("path", "value"), FIELDS)
def test_a_damaged_field_is_refused(parts, path, value, tmp_path):
    named = [step for step in path if isinstance(step, str)][-1]
    pattern = rf"{named}|is not a plan|status = verified|must be names|has the shape"
    assert_refused(tmp_path, with_about(parts, set_field(path, value)), pattern)
