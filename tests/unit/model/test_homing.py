"""The charge kept for the return: its closed form, and that a plan keeps it."""

import numpy as np
import pytest
from pyomo.environ import value

from pyomo_quad.flight import Planner, PlanStatus
from pyomo_quad.flight.return_flight import with_return_flight
from pyomo_quad.model import build_model
from pyomo_quad.scenario import ScenarioError, load_scenario
from tests.command import SCENARIOS

PARCEL = SCENARIOS / "parcel.toml"
KEPT = {
    "mission.return_reserve": True,
    "mission.return_flight.airspeed": 10.0,
    "mission.return_flight.current": 12.0,
    "mission.return_flight.margin": 0.25,
}


def homing_at(place, **changed):
    model = build_model(load_scenario(PARCEL, KEPT | changed))
    t = model.time.first()
    for axis, coordinate in zip("xyz", place, strict=True):
        getattr(model.rigid_body, axis)[t].set_value(coordinate)
    return model, t


def test_the_charge_is_that_of_the_wind_triangle():
    model, t = homing_at((300.0, 0.0, 10.0), **{"wind.speed": 4.0, "wind.direction": np.pi / 2})
    # Across a wind of 4 m/s, of 10 m/s through the air sqrt(84) are left.
    way = np.hypot(300.0, 1.0)
    expected = 1.25 * 12.0 * way / np.sqrt(100.0 - 16.0) / 3600.0
    assert value(model.homing.charge_home[t]) == pytest.approx(expected, rel=1e-4)
    ahead, _ = homing_at((300.0, 0.0, 10.0), **{"wind.speed": 4.0, "wind.direction": 0.0})
    assert value(ahead.homing.ground_speed[0, t]) == pytest.approx(6.0, rel=1e-4)


def test_a_wind_across_faster_than_the_vehicle_stops_the_return():
    # From east and behind, 13.4 m/s at 45 degrees to the way home, of 8 m/s through the air.
    fields = {
        "wind.speed": 9.0 * np.sqrt(2.0),
        "wind.direction": 0.75 * np.pi,
        "mission.return_flight.airspeed": 8.0,
    }
    model, t = homing_at((300.0, 0.0, 10.0), **fields)
    assert value(model.homing.tail_wind[0, t]) == pytest.approx(9.0, rel=1e-3)
    assert value(model.homing.ground_speed[0, t]) == pytest.approx(0.5, abs=0.02)


@pytest.mark.lengthy
def test_the_nearest_home_counts_and_never_less_than_it():
    homes = {"mission.rally": [[900.0, 0.0, 10.0]], "wind.speed": 0.0}
    for x in (0.0, 300.0, 440.0, 460.0, 600.0, 900.0):
        model, t = homing_at((x, 0.0, 10.0), **homes)
        charges = [value(model.homing.charge_to[k, t]) for k in model.homing.home]
        assert min(charges) <= value(model.homing.charge_home[t]) <= max(charges)
        if abs(x - 450.0) > 300.0:
            assert value(model.homing.charge_home[t]) == pytest.approx(min(charges), rel=1e-2)


@pytest.mark.lengthy
def test_airspeed_and_current_are_those_of_least_charge_against_the_wind():
    scenario = load_scenario(PARCEL, {"mission.return_reserve": True})
    told = with_return_flight(Planner(), scenario).mission.return_flight
    wind = scenario.wind.speed
    steady = Planner().steady_flight(load_scenario(PARCEL))
    drawn = np.array([(1.0 - scenario.limits.least_charge) * steady.pack_capacity])

    def cost(airspeed):
        rates, _ = steady.charge_rates(steady.trim([airspeed, 0.0, 0.0]), drawn)
        return rates[0] * 3600.0 / (airspeed - wind)

    assert told.current / (told.airspeed - wind) == pytest.approx(cost(told.airspeed), rel=1e-9)
    assert all(cost(told.airspeed) <= cost(told.airspeed + step) for step in (-1.0, -0.1, 0.1, 1.0))


def with_hill(folder):
    """Return the fields of terrain that is level at 5 m, with a wall of 65 m at x = 150 m."""
    x, y = np.meshgrid(np.arange(-200.0, 401.0, 25.0), np.arange(-100.0, 101.0, 25.0))
    heights = np.where(np.abs(x - 150.0) < 1.0, 65.0, 5.0)
    columns = np.column_stack([axis.ravel() for axis in (x, y, heights)])
    file = folder / "terrain.csv"
    np.savetxt(file, columns, delimiter=",", header="x_m,y_m,height_m", comments="")
    changed = {
        "airspace.terrain": str(file),
        "airspace.floor": 3.0,
        "wind.speed": 0.0,
        "mission.start.position": [0.0, 0.0, 10.0],
        "mission.goal.position": [-100.0, 0.0, 10.0],
        "mission.return_flight.climb_rate": 2.0,
        "mission.return_flight.climb_current": 30.0,
    }
    return changed | {"airspace.ceiling": None, "airspace.keep_out": []}


def test_over_terrain_the_return_climbs_above_the_highest_ground_on_its_way(tmp_path):
    model, t = homing_at((300.0, 0.0, 20.0), **with_hill(tmp_path))
    homing = model.homing
    above = value(homing.height_home[0, t])
    assert above >= 65.0 + 3.0
    climb, level = above - 20.0, above - 10.0
    assert value(homing.climb[0, t]) == pytest.approx(climb, rel=1e-9)
    way = np.hypot(300.0, 1.0) + np.hypot(level, 1.0)
    expected = 1.25 * (12.0 * way / 10.0 + 30.0 * climb / 2.0) / 3600.0
    assert value(homing.charge_home[t]) == pytest.approx(expected, rel=1e-4)


def test_behind_no_hill_and_above_it_nothing_is_climbed(tmp_path):
    fields = with_hill(tmp_path)
    for place in ((-150.0, 0.0, 30.0), (300.0, 0.0, 110.0)):
        model, t = homing_at(place, **fields)
        assert value(model.homing.climb[0, t]) == pytest.approx(0.0, abs=1e-9)
        descent = place[2] - 10.0
        way = np.hypot(place[0], 1.0) + np.hypot(descent, 1.0)
        expected = 1.25 * 12.0 * way / 10.0 / 3600.0
        assert value(model.homing.charge_home[t]) == pytest.approx(expected, rel=1e-4)


@pytest.mark.lengthy
def test_the_current_of_the_climb_is_the_greater_of_both_ends(tmp_path):
    fields = with_hill(tmp_path) | {"mission.return_reserve": True}
    del fields["mission.return_flight.climb_current"]
    scenario = load_scenario(PARCEL, fields)
    told = with_return_flight(Planner(), scenario).mission.return_flight
    steady = Planner().steady_flight(scenario.with_mission(return_reserve=False))
    drawn = np.array([(1.0 - scenario.limits.least_charge) * steady.pack_capacity])
    for speed in (0.0, told.airspeed / 2, told.airspeed):
        rates, _ = steady.charge_rates(steady.trim([speed, 0.0, told.climb_rate]), drawn)
        assert told.climb_current >= rates[0] * 3600.0 * (1 - 1e-9)
    assert told.climb_current > told.current


@pytest.mark.slow
def test_a_plan_keeps_the_charge_of_its_return():
    planner = Planner()
    free = load_scenario(PARCEL, {"battery.initial_state_of_charge": 60.0})
    plan = planner.solve(free)
    charge = plan.to_frame(10.0)["state_of_charge_percent"]
    used = charge.iloc[0] - charge.iloc[-1]
    kept = {"mission.return_reserve": True}
    full = planner.solve(load_scenario(PARCEL, kept | {"battery.initial_state_of_charge": 60.0}))
    assert full.is_verified
    assert full.energy == pytest.approx(plan.energy, rel=1e-6)
    # A fifth stays in the pack; what is left above it covers the flight there and a little more.
    scarce = kept | {"battery.initial_state_of_charge": float(20.0 + 1.2 * used)}
    none = planner.solve(load_scenario(PARCEL, scarce))
    assert none.status is PlanStatus.INFEASIBLE


def test_a_wind_that_is_an_acceleration_is_refused():
    with pytest.raises(ScenarioError, match=r"mission.return_reserve under wind.coupling = .*drag"):
        load_scenario(SCENARIOS / "paper_wind.toml", {"mission.return_reserve": True})
