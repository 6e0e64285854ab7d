"""Heights above terrain: derivatives, limits, the wind over it, and a plan across a hill."""

import casadi
import numpy as np
import pytest
import xarray as xr
from pyomo.environ import value

from pyomo_quad.flight import Planner
from pyomo_quad.flight.limit_words import limit_words
from pyomo_quad.flight.margins import greatest_margin
from pyomo_quad.model import build_model
from pyomo_quad.model.build import parameter_values, structure_key
from pyomo_quad.model.screening import screen_model
from pyomo_quad.scenario import load_scenario
from pyomo_quad.scenario.accuracy import FIGURES

NAMES = ("rigid_body.x", "rigid_body.y", "rigid_body.z")


def hill(x, y):
    return 12.0 / (1 + ((x - 20.0) ** 2 + (y - 3.0) ** 2) / 8.0**2) ** 1.5


@pytest.fixture(scope="module")
def terrain(tmp_path_factory):
    x, y = np.arange(-10.0, 51.0, 2.0), np.arange(-14.0, 15.0, 2.0)
    file = tmp_path_factory.mktemp("terrain") / "hill.nc"
    heights = xr.Dataset({"dem": (("x", "y"), hill(x[:, None], y))}, {"x": x, "y": y})
    heights.to_netcdf(file)
    return str(file)


def mission(terrain, **tables):
    flight = {
        "start": {"position": [0.0, 0.0, 6.0]},
        "goal": {"position": [40.0, 0.0, 6.0]},
        "duration": 9.0,
    }
    vehicle = {"use": "dji_phantom_2", "drag_linear": 0.3}
    space = {"terrain": terrain, "floor": 3.0, "ceiling": 40.0}
    return load_scenario(
        {"name": "hill", "vehicle": vehicle, "mission": flight, "airspace": space} | tables
    )


def test_the_height_above_the_ground_has_exact_derivatives(terrain):
    dynamics = Planner().dynamics(mission(terrain))
    at = casadi.SX.sym("at", 3)
    where = dict(zip(NAMES, casadi.vertsplit(at), strict=True))
    for height in ("height_limited_below", "height_limited_above"):
        (written,) = dynamics.expressions(((f"ground.{height}", None),), 1.0, where)
        hessian, gradient = casadi.hessian(written, at)
        found = casadi.Function("found", [at], [written, gradient, hessian])
        place, step = np.array([14.3, 1.7, 9.0]), 1e-4
        steps = step * np.eye(3)
        first = [float(found(place + e)[0] - found(place - e)[0]) / (2 * step) for e in steps]
        second = [
            (found(place + e)[1] - found(place - e)[1]).full().ravel() / (2 * step) for e in steps
        ]
        height_there, slope, bend = (part.full() for part in found(place))
        assert slope.ravel() == pytest.approx(first, rel=1e-7, abs=1e-9)
        assert bend == pytest.approx(np.array(second), rel=1e-6, abs=1e-8)
        assert height_there.item() == pytest.approx(9.0 - hill(14.3, 1.7), abs=0.4)


def test_what_is_declared_is_the_surface_that_places_are_judged_by(terrain):
    told = mission(terrain)
    model = build_model(told)
    time, body, places = model.time.first(), model.rigid_body, np.array([[17.0, 5.0, 30.0]])
    body.x[time], body.y[time], body.z[time] = places[0]
    for side, name in ((1, "below"), (-1, "above")):
        declared = value(model.ground.component(f"height_limited_{name}")[time])
        judged = told.airspace.height_above_ground(places, side)
        assert declared == pytest.approx(judged[0], abs=1e-9)


def test_a_wind_by_height_takes_the_height_above_the_ground(terrain):
    profile = {"law": "power", "exponent": 0.2}
    wind = {"use": "constant", "speed": 5.0, "coupling": "drag", "profile": profile}
    told = mission(terrain, wind=wind)
    model = build_model(told)
    time, body = model.time.first(), model.rigid_body
    body.x[time], body.y[time], body.z[time] = 20.0, 3.0, 25.0
    over = float(told.airspace.height_above_ground([20.0, 3.0, 25.0]))
    assert over < 14.0
    assert value(model.wind.velocity_x[time]) == pytest.approx(5.0 * (over / 10) ** 0.2, rel=1e-9)


def test_edges_of_terrain_beyond_a_fence_are_no_fault_of_the_mission(terrain):
    fence = {"corners": [[-5.0, -10.0], [45.0, -10.0], [45.0, 10.0], [-5.0, 10.0]]}
    told = mission(terrain).replace({"airspace.keep_in": fence})
    assert screen_model(build_model(told)) == ()


def test_models_over_other_ground_are_not_shared(terrain, tmp_path):
    told = mission(terrain)
    flat = told.replace({"airspace.terrain": None})
    x, y = np.arange(-10.0, 51.0, 2.0), np.arange(-14.0, 15.0, 2.0)
    other = xr.Dataset({"dem": (("x", "y"), 0.5 * hill(x[:, None], y))}, {"x": x, "y": y})
    other.to_netcdf(tmp_path / "other.nc")
    keys = [structure_key(s) for s in (told, flat, mission(str(tmp_path / "other.nc")))]
    assert len(set(keys)) == 3
    assert flat.airspace.ground is None
    assert parameter_values(told)["airspace.floor"] == 3.0


def test_flights_are_judged_by_their_height_above_the_ground(terrain):
    told = mission(terrain)
    dynamics = Planner().dynamics(told)
    start = dynamics.initial_states() | dict.fromkeys(NAMES, 0.0)
    shares = np.linspace(0.0, 1.0, 50)
    states = np.tile([start.get(name, 0.0) for name in dynamics.state_names], (50, 1))
    columns = [list(dynamics.state_names).index(name) for name in NAMES]
    states[:, columns] = np.outer(1 - shares, [0.0, 0.0, 6.0]) + np.outer(shares, [40.0, 0.0, 6.0])
    controls = np.zeros((50, len(dynamics.control_names)))
    broken = {v.name: v.size for v in dynamics.violations(9.0 * shares, states, controls)}
    over = told.airspace.height_above_ground(states[:, columns])
    assert broken["airspace.floor_limit"] == pytest.approx(3.0 - over.min(), abs=1e-6)
    assert broken["airspace.floor_limit"] > 4.0
    assert limit_words("airspace.terrain_edge[west]") == "west edge of the terrain"


def test_margins_over_terrain_are_limited_by_the_height_above_the_ground(terrain):
    told = mission(terrain)
    room = told.airspace.height_above_ground(told.mission.positions).min() - 3.0
    assert greatest_margin(told, "airspace.floor") == pytest.approx(room - 0.01, abs=1e-9)
    assert 2.0 < room < 2.9


@pytest.mark.lengthy
def test_a_plan_crosses_a_hill_at_its_floor_and_is_verified_between_its_points(terrain):
    plan = Planner().solve(mission(terrain))
    assert plan.is_verified
    states = plan.trajectories
    columns = [list(states.state_names).index(name) for name in NAMES]
    shares = np.linspace(0.0, 1.0, 2000)
    places = states.states_at(plan.duration_s * shares)[:, columns]
    over = places[:, 2] - hill(places[:, 0], places[:, 1])
    # Between the points of its grid, the hill is higher than the ground by less than 0.05 m.
    assert over.min() > 3.0 - 0.05
    # It touches the floor, but for the centimetres by which its path may be pushed off.
    lowest = plan.scenario.airspace.height_above_ground(places).min()
    allowed = FIGURES[plan.scenario.solver.accuracy].intrusion
    assert 3.0 - allowed <= lowest <= 3.05
    flat = Planner().solve(plan.scenario.replace({"airspace.terrain": None}))
    assert plan.energy > 1.0001 * flat.energy
