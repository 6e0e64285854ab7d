"""Corridors through a wind field: closed forms of their cost, and where they lie."""

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from scipy.optimize import minimize_scalar

from pyomo_quad import processes
from pyomo_quad.collocation import Mesh, SolveError
from pyomo_quad.flight import PlanStatus
from pyomo_quad.flight.corridors import Corridors, WindMap, has_corridors, steady_power
from pyomo_quad.flight.route_flights import RouteFlights
from pyomo_quad.flight.routes import NoRouteError, Route, journeys_of
from pyomo_quad.scenario import load_scenario
from pyomo_quad.scenario.airspace import KeepIn
from tests.flights import PLANNER
from tests.unit.flight.coarse_solution import CoarseFlights, solution_at

X, Y = np.linspace(0, 200, 41), np.linspace(0, 120, 25)
# Corners of a fence that reaches beyond the field in the south and north, and not in the east.
AROUND = ((-50.0, -90.0), (190.0, -90.0), (190.0, 210.0), (-50.0, 210.0))
ENDS = np.array([[20.0, 60.0, 10.0], [180.0, 60.0, 10.0]])


def power(airspeed):
    return np.where(airspeed <= 24.0, 300.0 + 0.05 * np.asarray(airspeed) ** 3, np.inf)


def mission_in(folder, wind, **airspace):
    east, north = np.meshgrid(X, Y, indexing="ij")
    u, v = (np.broadcast_to(part, east.shape) for part in wind(east, north))
    held = {n: (("x", "y"), part, {"units": "m s-1"}) for n, part in (("u", u), ("v", v))}
    xr.Dataset(held, {"x": X, "y": Y}).to_netcdf(folder / "field.nc")
    return load_scenario(
        {
            "name": "corridors",
            "vehicle": {"use": "dji_phantom_2", "drag_linear": 0.3},
            "wind": {"field": str(folder / "field.nc")},
            "airspace": airspace,
            "mission": {
                "start": {"position": ENDS[0].tolist()},
                "goal": {"position": ENDS[1].tolist()},
                "duration": "free",
            },
        }
    )


def corridors_in(folder, wind, **airspace):
    told = mission_in(folder, wind, **airspace)
    return Corridors(told, power, ENDS, told.nominal_duration)


@pytest.mark.lengthy
@pytest.mark.parametrize("wind", [(0.0, 0.0), (5.0, 0.0), (-4.0, 3.0)])
def test_an_even_wind_has_one_corridor_which_is_straight_and_costs_the_closed_form(tmp_path, wind):
    found = corridors_in(tmp_path, lambda _x, _y: wind)
    (route,) = found.routes()
    assert route.length == pytest.approx(160.0, rel=1e-9)

    def per_metre(speed):
        return power(np.hypot(speed - wind[0], wind[1])) / speed

    best = minimize_scalar(per_metre, bounds=(0.5, 24.0), method="bounded", options={"xatol": 1e-9})
    assert route.estimate_J == pytest.approx(160.0 * best.fun, rel=1e-3)


@pytest.mark.lengthy
def test_a_jet_beside_the_way_carries_the_cheapest_corridor(tmp_path):
    found = corridors_in(tmp_path, lambda _x, y: (8.0 * np.exp(-(((y - 90.0) / 10.0) ** 2)), 0.0))
    route = found.routes()[0]
    assert 80.0 < route.places[:, 1].max() < 100.0
    assert route.estimate_J < 0.95 * found.energy_of(ENDS)


@pytest.mark.lengthy
def test_a_contrary_wind_in_the_middle_has_a_corridor_on_either_side(tmp_path):
    def contrary(x, y):
        return -12.0 * np.exp(-(((x - 100.0) / 40.0) ** 2) - ((y - 60.0) / 15.0) ** 2), 0.0

    routes = corridors_in(tmp_path, contrary).routes()
    sides = [
        float(np.interp(100.0, route.places[:, 0], route.places[:, 1])) for route in routes[:2]
    ]
    assert min(sides) < 45.0
    assert max(sides) > 75.0
    assert routes[0].estimate_J == pytest.approx(routes[1].estimate_J, rel=1e-2)


@pytest.mark.lengthy
def test_corridors_keep_out_of_zones_and_of_places_without_wind(tmp_path):
    tower = {"name": "tower", "shape": "box", "low": [80, 50, 0], "high": [120, 120, 50]}

    def lacking(x, y):
        return np.where((x > 90) & (x < 110) & (y < 30), np.nan, 0.0), 0.0

    found = corridors_in(tmp_path, lacking, keep_out=[tower], clearance=1.0)
    for route in found.routes():
        places = route.places_at(np.linspace(0, 1, 400))
        inside = (places[:, 0] > 79) & (places[:, 0] < 121) & (places[:, 1] > 49)
        assert not inside.any()
        unknown = (places[:, 0] > 93) & (places[:, 0] < 107) & (places[:, 1] < 27)
        assert not unknown.any()
    assert found.routes()
    assert found.energy_of(ENDS) is None


def test_only_a_field_that_changes_over_the_ground_is_searched(tmp_path):
    assert not has_corridors(mission_in(tmp_path, lambda _x, _y: (5.0, 1.0)))
    assert has_corridors(mission_in(tmp_path, lambda _x, y: (0.01 * y, 0.0)))


@pytest.mark.parametrize("is_held", [False, True])
def test_a_gap_in_an_even_field_is_passed_unless_the_wind_beside_it_holds(tmp_path, is_held):
    def lacking(x, y):
        return np.where((x > 90) & (x < 110) & (y < 30), np.nan, 5.0), 1.0

    told = mission_in(tmp_path, lacking)
    if is_held:
        told = told.with_values({"wind.beyond": "hold"})
    assert has_corridors(told) is not is_held
    within = WindMap(told).at(np.array([[100.0, 15.0, 10.0]]), np.zeros(1))
    np.testing.assert_allclose(within, [[5.0, 1.0]] if is_held else [[np.nan, np.nan]])


def test_without_hover_every_airspeed_takes_infinite_power():
    def trim(*_):
        raise SolveError("none")

    assert np.isinf(steady_power(SimpleNamespace(trim=trim))(np.array([0.0, 5.0]))).all()


def test_steady_power_is_that_of_the_trims_and_infinite_beyond_them():
    def trim(velocity, _near):
        if velocity[0] > 12.0:
            raise SolveError("none")
        return SimpleNamespace(power_W=100.0 + velocity[0])

    power = steady_power(SimpleNamespace(trim=trim))
    np.testing.assert_allclose(power(np.array([0.0, 3.7, 12.0])), [100.0, 103.7, 112.0])
    assert power(12.1) == np.inf


def test_places_without_a_way_between_them_have_no_corridor(tmp_path):
    def divided(x, y):
        return np.where(np.abs(x - 100.0) < 21.0, np.nan, 4.0) + 0.0 * y, 0.0

    found = corridors_in(tmp_path, divided)
    assert found.routes() == []
    assert found.energy_of(ENDS) is None


@pytest.mark.lengthy
def test_a_wall_across_the_field_leaves_no_way_unless_the_field_goes_on_beyond_its_edges(tmp_path):
    """The wall ends outside of the field, so that a route round it would leave the field."""
    wall = {
        "name": "wall",
        "shape": "box",
        "low": [95.0, -5.0, -10.0],
        "high": [105.0, 125.0, 400.0],
    }
    told = mission_in(
        tmp_path, lambda _x, y: (0.01 * y, 0.0), keep_out=[wall], floor=1.0, ceiling=50.0
    )
    with pytest.raises(NoRouteError, match=r"wall .* may not leave wind\.field"):
        journeys_of(told)
    wide = told.airspace.model_copy(update={"keep_in": KeepIn(corners=AROUND)})
    with pytest.raises(NoRouteError, match=r"wall .* may not leave wind\.field"):
        journeys_of(told.model_copy(update={"airspace": wide}))
    beyond = told.with_values({"wind.beyond": "hold"})
    (route,) = journeys_of(beyond)[0]
    assert not 0.0 <= route.places[:, 1].min() <= route.places[:, 1].max() <= 120.0
    planned = PLANNER.solve(told)
    assert planned.status is PlanStatus.INFEASIBLE
    assert "wind.beyond" in planned.message


def test_the_mission_is_solved_along_every_corridor(tmp_path, monkeypatch):
    """Corridors have no sides of zones; a solution along one says nothing about the others."""
    monkeypatch.setattr(processes, "cores", lambda _most, **_: 1)
    told = mission_in(tmp_path, lambda _x, y: (0.01 * y, 0.0))
    corridors = [(Route(places=ENDS, sides=(), label=f"corridor {k}"),) for k in range(3)]
    solved = []

    class Flights(CoarseFlights):
        def __init__(self):
            RouteFlights.__init__(self, SimpleNamespace(told=told))

        def smooth_guess(self, _journey):
            return "smooth"

        def fly(self, journey, guess="lines", options=None):
            del options
            solved.append((journey[0].label, guess))
            return solution_at(float(len(solved)), 100.0 * len(solved), Mesh.uniform(4, 3))

    Flights().compared(corridors)
    assert solved == [("corridor 0", "smooth"), ("corridor 1", "lines"), ("corridor 2", "lines")]
    solved.clear()
    Flights().compared(corridors[:1])
    # A mission of several optima begins at two guesses at least.
    assert solved == [("corridor 0", "smooth"), ("corridor 0", "lines")]
