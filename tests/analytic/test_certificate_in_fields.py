"""The bound in a wind field against steady winds, the field itself, and flights planned in it."""

import casadi
import numpy as np
import pytest
import shapely
import xarray as xr

from pyomo_quad.flight.steady import MomentumDemand
from pyomo_quad.model.wind_field import ColumnWinds, wind_corners, winds_of_columns
from pyomo_quad.study.legs import legs_of
from pyomo_quad.study.pairs import POWER_TOLERANCE, MotionPrices, Pairs
from pyomo_quad.study.potential import PlacePrices, Places, Sampled, bound_by_places
from tests.analytic.test_certificate_through_air import M100, flying
from tests.declared_model import scenario
from tests.flights import PLANNER, certified

X, Y, Z = np.linspace(-60.0, 160.0, 23), np.linspace(-90.0, 90.0, 19), np.linspace(-40.0, 60.0, 6)
HEAD_WIND = 5.0


def uniform(x, _y, _z):
    return -HEAD_WIND + 0.0 * x, 0.0 * x, 0.0 * x


def shear(_x, y, _z):
    return 0.04 * y, 0.0 * y, 0.0 * y


def vortex(x, y, _z):
    turning = 0.2 * casadi.exp(-((x - 50.0) ** 2 + (y - 20.0) ** 2) / 40.0**2)
    return -turning * (y - 20.0), turning * (x - 50.0), 0.0 * x


def jet(x, y, z):
    core = casadi.exp(-(((y - 30.0) / 25.0) ** 2) - ((z - 10.0) / 30.0) ** 2)
    return 5.0 * core, 0.0 * x, 0.5 * core


def in_field(folder, field, goal=(100.0, 0.0, 0.0), duration=10.0, **wind):
    told = np.array([[[[float(w) for w in field(x, y, z)] for z in Z] for y in Y] for x in X])
    axes, units = ("x", "y", "z"), {"units": "m s-1"}
    held = {name: (axes, told[..., k], units) for k, name in enumerate("uvw")}
    xr.Dataset(held, {"x": X, "y": Y, "z": Z}).to_netcdf(folder / "field.nc")
    mission = {"goal": {"position": list(goal)}, "duration": duration}
    blows = {"field": str(folder / "field.nc"), "coupling": "drag"} | wind
    limits = {"speed_max": 25.0}
    return scenario(**(M100 | {"mission": mission, "wind": blows, "limits": limits}))


def pairs_of(told):
    steady = PLANNER.steady_flight(told)
    dynamics = steady.dynamics
    standing = MomentumDemand(dynamics).thrust(dynamics.start)
    most = float(steady.thrust(told.limits.rotor_speed_max))
    return Pairs(told, dynamics, standing, most, wind_corners(told)), steady


@pytest.mark.lengthy
@pytest.mark.parametrize("field", [uniform, shear, vortex, jet])
@pytest.mark.parametrize("scale", [1.0, -0.7])
def test_no_wind_of_the_field_is_outside_of_the_polyhedron(tmp_path, field, scale):
    told = in_field(tmp_path, field, field_scale=scale, vertical=0.3)
    dynamics, random = PLANNER.dynamics(told), np.random.default_rng(1)
    states = np.zeros((4000, len(dynamics.state_names)))
    for name, axis in zip("xyz", (X, Y, Z), strict=True):
        where = list(dynamics.state_names).index(f"rigid_body.{name}")
        states[:, where] = random.uniform(axis[0], axis[-1], len(states))
    keys = tuple((f"wind.velocity_{name}", None) for name in "xyz")
    controls = np.zeros((len(states), len(dynamics.control_names)))
    winds = dynamics.table(keys, np.zeros(len(states)), states, controls)
    corners = wind_corners(told)
    ways = random.normal(size=(500, 3))
    farthest, allowed = (ways @ winds.T).max(axis=1), (ways @ corners.T).max(axis=1)
    assert np.all(farthest <= allowed + 1e-9)
    over = winds_of_columns(told)
    at = states[:, [list(dynamics.state_names).index(f"rigid_body.{name}") for name in "xy"]].T
    i, j = (np.searchsorted(axis, one) - 1 for axis, one in zip((over.x, over.y), at, strict=True))
    assert np.all(over.low[:, i, j] - 1e-9 <= winds[:, :2].T)
    assert np.all(over.high[:, i, j] + 1e-9 >= winds[:, :2].T)
    # A polygon of eight sides round a disc reaches 1 / cos(22.5 degrees) of its radius.
    assert np.ptp(corners, axis=0).max() <= 1.1 * np.ptp(winds, axis=0).max() + 0.01


def test_cells_without_wind_count_only_where_their_wind_is_held(tmp_path):
    # Filled from both sides, the gap has a step from 3 to 9 m/s, at which the spline overshoots.
    def gap(x, _y, _z):
        wind = 3.0 if x < 100.0 else 9.0
        return (float("nan") if 45.0 < x < 155.0 else wind), 0.0, 0.0

    goal = (30.0, 0.0, 0.0)
    known = wind_corners(in_field(tmp_path, gap, goal))[:, 0]
    held = wind_corners(in_field(tmp_path, gap, goal, beyond="hold"))[:, 0]
    assert held.min() < 2.9 < known.min() <= 3.0
    assert 9.0 <= known.max() < 9.1 < held.max()


@pytest.mark.lengthy
def test_no_wind_between_the_corners_is_more_favourable_than_the_best_corner(tmp_path):
    told = in_field(tmp_path, vortex)
    found, steady = pairs_of(told)
    hover, weight = steady.hover_power, found.standing[2]
    prices = MotionPrices(
        momentum=np.array([1.0, 0.5, 1.4 * hover / weight]),
        displacement=np.array([20.0, 3.0, weight]),
        motion=1.05,
    )
    least, _ = found.cheapest(prices, 1.0)
    random, corners = np.random.default_rng(2), wind_corners(told)
    shares = random.dirichlet(np.full(len(corners), 0.3), size=12)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    for wind in shares @ corners:
        for speed in (0.0, 8.0, 15.0):
            # Steady flight: no force on average, and only the way is priced.
            trim = steady.trim([speed, 0.0, 0.0]).power_W
            assert (
                least <= trim - 20.0 * (speed + wind[0]) - 3.0 * wind[1] - weight * wind[2] + 1e-6
            )
    inner = Pairs(
        told, steady.dynamics, found.standing, float(steady.thrust(told.limits.rotor_speed_max)),
        np.vstack([2 * middle - shares @ corners, shares @ corners]),
    )  # fmt: skip
    assert inner.cheapest(prices, 1.0)[0] >= least - 1e-6 * hover


@pytest.mark.slow
@pytest.mark.parametrize("duration", [10.0, "free"])
def test_a_uniform_field_has_the_bound_of_its_steady_wind(tmp_path, duration):
    told = in_field(tmp_path, uniform, duration=duration)
    steady = flying([100.0, 0.0, 0.0], duration, HEAD_WIND)
    found, expected = certified(told), certified(steady)
    allowed = 2 * POWER_TOLERANCE * found.hover_energy_J
    assert found.lower_bound_J == pytest.approx(expected.lower_bound_J, abs=allowed)


@pytest.mark.slow
@pytest.mark.parametrize("field", [shear, vortex, jet])
@pytest.mark.parametrize("duration", [12.0, "free"])
def test_no_plan_in_a_field_spends_less_than_its_bound(tmp_path, field, duration):
    told = in_field(tmp_path, field, duration=duration)
    plan, found = PLANNER.solve(told), certified(told)
    assert plan.is_verified
    assert 0.5 * plan.energy <= found.lower_bound_J <= plan.energy
    assert "over all winds that occur" in found.reason


def columns(closed=()):
    """Winds over cells of 10 m, of which some are closed."""
    x, y = np.linspace(0.0, 100.0, 11), np.linspace(0.0, 60.0, 7)
    is_open = np.ones((10, 6), dtype=bool)
    for cell in closed:
        is_open[cell] = False
    still = np.zeros((2, 10, 6))
    return ColumnWinds(x=x, y=y, low=still, high=still, is_open=is_open)


def discs(places, radius):
    angles = 2 * np.pi * np.arange(64) / 64
    ring = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.tile(ring, (places.corners.shape[0] * 4, 1, 1))


def test_a_potential_of_one_slope_rises_by_the_distance():
    ends = np.array([[12.0, 7.0, 5.0], [83.0, 52.0, 5.0]])
    places = Places(columns(), ends)
    rise, straight = places.rise(discs(places, 3.0)), 3.0 * np.linalg.norm(ends[1] - ends[0])
    assert np.cos(np.pi / 64) * straight * (1 - 1e-5) <= rise <= straight * (1 + 1e-9)


def test_a_potential_rises_round_a_wall_by_no_more_than_the_shortest_way():
    ends = np.array([[20.0, 10.0, 5.0], [80.0, 10.0, 5.0]])
    places = Places(columns([(5, j) for j in range(4)]), ends)
    rise = places.rise(discs(places, 2.0))
    shortest = 2.0 * (np.hypot(30.0, 30.0) + 10.0 + np.hypot(20.0, 30.0))
    assert 2.0 * 60.0 < 0.9 * shortest <= rise <= shortest


@pytest.mark.lengthy
def test_motions_in_a_cell_spend_at_least_what_its_gradients_credit(tmp_path):
    told = in_field(tmp_path, shear, duration="free")
    pairs, steady = pairs_of(told)
    weight, hover = pairs.standing[2], steady.hover_power
    prices = PlacePrices(
        offset=np.array([2.0, -1.0, 1.4 * hover / weight]), motion=0.9, climb=1.2 * weight
    )
    random = np.random.default_rng(3)
    winds = np.array([[-3.0, 1.0], [-3.0, 2.0], [-1.0, 1.0], [-1.0, 2.0]])
    size = np.linalg.norm(prices.offset[:2] + prices.motion * winds, axis=1)
    lengths = np.tile([0.0, 10.0, 25.0, 40.0], (9, 1))
    tolerance, sampled = POWER_TOLERANCE * hover, Sampled(pairs)
    table = prices.table(
        lambda own: pairs.least_through_air(own, sampled(own), tolerance),
        np.array([size.min() - 0.1, size.max() + 0.1]),
        lengths,
    )
    allowed = table.gradients(prices, winds)
    assert np.linalg.norm(allowed, axis=2).min() > 1.0
    common = shapely.intersection_all(shapely.polygons(allowed))
    for place in np.array(common.exterior.coords)[:: len(common.exterior.coords) // 5]:
        wind = np.array([*(random.dirichlet(np.ones(4)) @ winds), 0.0])
        own = MotionPrices(
            momentum=prices.offset + prices.motion * wind,
            displacement=np.array([*place, prices.climb]),
            motion=prices.motion,
        )
        still = Pairs(
            told, steady.dynamics, pairs.standing,
            float(steady.thrust(told.limits.rotor_speed_max)), wind[None],
        )  # fmt: skip
        assert still.cheapest(own, 1.0)[0] >= -1e-6 * hover


@pytest.mark.slow
def test_two_layers_cost_nearly_what_each_costs_alone(tmp_path):
    def layers(x, _y, _z):
        return (-4.0 if x <= 50.0 else -1.0), 0.0, 0.0

    both = certified(in_field(tmp_path, layers, duration="free"))
    alone = [certified(flying([50.0, 0.0, 0.0], "free", wind)).lower_bound_J for wind in (4.0, 1.0)]
    assert 0.92 * sum(alone) <= both.lower_bound_J <= sum(alone)
    assert "in each cell of the field" in both.reason


@pytest.mark.slow
def test_a_nearly_uniform_field_has_nearly_the_bound_of_its_mean_wind(tmp_path):
    def nearly(x, _y, _z):
        return -HEAD_WIND + 1e-3 * (x - 50.0), 0.0, 0.0

    told = in_field(tmp_path, nearly, duration="free")
    pairs, steady = pairs_of(told)
    (leg,), (durations,) = legs_of(told)
    ends = np.array([told.mission.start.position, told.mission.goal.position])
    power, places = steady.hover_power, Places(winds_of_columns(told), ends)
    found = bound_by_places(lambda _: pairs, wind_corners(told), places, leg, durations, power)
    mean = certified(flying([100.0, 0.0, 0.0], "free", HEAD_WIND)).lower_bound_J
    # The polygon of gradients and the values between the proven ones cost up to 3 %.
    assert 0.97 * mean <= found <= 1.002 * mean


@pytest.mark.lengthy
def test_a_field_that_accelerates_has_no_bound(tmp_path):
    found = certified(in_field(tmp_path, shear, coupling="acceleration"))
    assert found.lower_bound_J is None
    assert "wind.coupling" in found.reason
