"""Routes: their lengths beside closed forms, which sides they pass, and what closes them."""

from math import acos, asin, sqrt

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from pyomo_quad import processes
from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.collocation import Mesh, Status
from pyomo_quad.flight.flight import POSITION_STATES, VELOCITY_STATES
from pyomo_quad.flight.mission_problem import MissionProblem
from pyomo_quad.flight.route_flights import (
    RouteFlights,
    _is_dominated,
    guess_along,
    guess_from,
    sides_touched,
)
from pyomo_quad.flight.routes import (
    find_journeys,
    find_routes,
    length_of,
    no_way,
)
from pyomo_quad.flight.zones import MARGIN_M
from pyomo_quad.scenario import load_scenario
from pyomo_quad.scenario.airspace import Airspace
from tests.command import PAPER_CALM
from tests.declared_model import scenario
from tests.flights import PLANNER
from tests.unit.flight.coarse_solution import CoarseFlights, solution_at

START, GOAL = (0.0, 0.0, 5.0), (20.0, 0.0, 5.0)
MAST = {
    "name": "mast",
    "shape": "cylinder",
    "centre": [10, 0.5],
    "radius": 2,
    "bottom": 0,
    "top": 9,
}


def wall(name, low, high):
    return {"name": name, "shape": "box", "low": low, "high": high}


# Four walls round the start, without a lid.
YARD = [
    wall("north", [-3, 2, -1], [3, 3, 30]),
    wall("south", [-3, -3, -1], [3, -2, 30]),
    wall("west", [-3, -3, -1], [-2, 3, 30]),
    wall("east", [2, -3, -1], [3, 3, 30]),
]


def airspace(*zones, **heights):
    return Airspace.model_validate({"keep_out": zones, **heights})


def round_a_circle(radius, offset):
    """The shortest way from (0, 0) to (20, 0) past a circle at (10, offset), on the side of 0."""
    distance = sqrt(100 + offset**2)
    straight = sqrt(distance**2 - radius**2)
    inner = 2 * acos(10 / distance)
    arc = 2 * asin(radius / distance) + inner * (-1 if offset > 0 else 1)
    return 2 * straight + radius * arc


def test_the_ways_round_a_mast_are_as_long_as_tangents_and_arc():
    right, left = find_routes(airspace(MAST, floor=0.0, ceiling=9.0), START, GOAL)
    assert (right.name, left.name) == ("right of mast", "left of mast")
    for route, offset in ((right, 0.5), (left, -0.5)):
        exact = round_a_circle(2.0 + MARGIN_M, offset)
        assert exact - 2 * MARGIN_M < route.length < 1.01 * exact


@pytest.mark.parametrize("shape", ["cylinder", "sphere", "box"])
def test_no_route_cuts_into_a_zone(shape):
    zones = {
        "cylinder": MAST,
        "sphere": {"name": "ball", "shape": "sphere", "centre": [10, 0.5, 5], "radius": 2},
        "box": wall("hall", [8, -1, 0], [12, 3, 9]),
    }
    told = airspace(zones[shape], clearance=0.3)
    routes = find_routes(told, START, GOAL)
    assert len(routes) >= 3
    for route in routes:
        places = route.places_at(np.linspace(0.0, 1.0, 2001))
        assert np.max(told.keep_out[0].depth(places)) < -0.3 + 1e-9
    lengths = [route.length for route in routes]
    assert lengths == sorted(lengths)


def flooded(told, high):
    """Return the shortest way over free squares of half a metre from (0, 0) to (20, 0) [m]."""
    step = 0.5
    x, y = np.meshgrid(np.arange(-12.0, 32.1, step), np.arange(-12.0, 12.1, step), indexing="ij")
    places = np.stack([x, y, 0.0 * x + high], axis=-1)
    is_free = np.all([zone.depth(places) < -told.clearance for zone in told.keep_out], axis=0)
    number = np.arange(x.size).reshape(x.shape)
    lines = []
    for (dx, dy), length in (((1, 0), 1), ((0, 1), 1), ((1, 1), sqrt(2)), ((1, -1), sqrt(2))):
        along, down, up = slice(dx, None), slice(max(dy, 0), None), slice(max(-dy, 0), None)
        first = number[: x.shape[0] - dx, up][:, : x.shape[1] - abs(dy)].ravel()
        last = number[along, down][:, : x.shape[1] - abs(dy)].ravel()
        is_open = is_free.ravel()[first] & is_free.ravel()[last]
        lines += [(length * step, a, b) for a, b in zip(first[is_open], last[is_open], strict=True)]
    lengths, first, last = zip(*lines, strict=True)
    graph = csr_array((lengths, (first, last)), shape=(x.size,) * 2)
    ends = [int(number[np.argmin(np.abs(x[:, 0] - a)), np.argmin(np.abs(y[0]))]) for a in (0, 20)]
    return float(dijkstra(graph, directed=False, indices=ends[0])[ends[1]])


def test_a_hidden_corner_of_a_zone_does_not_close_the_way_round_its_neighbours():
    # The straight line hits the middle wall alone, whose corners lie within the other two.
    walls = [
        wall("middle", [9, -4, -1], [10, 4, 30]),
        wall("north", [8, 3, -1], [11, 7, 30]),
        wall("south", [8, -8, -1], [11, -3, 30]),
    ]
    told = airspace(*walls, floor=1.0, ceiling=9.0, clearance=0.5)
    shortest = find_routes(told, START, GOAL)[0]
    # Two tangents to the corners of "north" and the way along it.
    reach = 0.5 + MARGIN_M
    corner = np.hypot(8 - reach, 7 + reach), np.hypot(20 - 11 - reach, 7 + reach)
    assert shortest.length == pytest.approx(sum(corner) + 3 + 2 * reach)


@pytest.mark.lengthy
@settings(max_examples=25, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(3, 15), st.floats(-8, 6), st.floats(0.5, 4), st.floats(0.5, 6)),
        min_size=2,
        max_size=6,
    )
)
def test_the_shortest_route_is_no_longer_than_a_way_over_free_squares(boxes):
    walls = [
        wall(f"w{k}", [x, y, -1], [min(x + dx, 18.5), y + dy, 30])
        for k, (x, y, dx, dy) in enumerate(boxes)
    ]
    told = airspace(*walls, floor=1.0, ceiling=9.0, clearance=0.5)
    # Squares of half a metre that a clearance of 0.5 m and MARGIN_M leaves free.
    way = flooded(told.model_copy(update={"clearance": 0.5 + MARGIN_M}), START[2])
    routes = find_routes(told, START, GOAL)
    assert not np.isfinite(way) or routes[0].length <= way + 1e-6


def test_a_mirror_image_has_the_mirror_image_of_every_route():
    mirrored = MAST | {"centre": [10, -0.5]}
    heights = {"floor": 0.0, "ceiling": 20.0}
    there = find_routes(airspace(MAST, **heights), START, GOAL)
    here = find_routes(airspace(mirrored, **heights), START, GOAL)
    assert [r.length for r in there] == pytest.approx([r.length for r in here])
    swapped = {"left": "right", "right": "left"}
    for one, other in zip(there, here, strict=True):
        words = [swapped.get(word, word) for word in one.name.split()]
        assert " ".join(words) == other.name
        assert other.places * (1, -1, 1) == pytest.approx(one.places)


def test_every_class_of_two_masts_is_found_once():
    second = MAST | {"name": "second", "centre": [14, -0.5]}
    routes = find_routes(airspace(MAST, second, floor=0.0, ceiling=9.0), START, GOAL)
    assert sorted(route.name for route in routes) == [
        "left of mast, left of second",
        "left of mast, right of second",
        "right of mast, left of second",
        "right of mast, right of second",
    ]


def test_a_zone_beside_the_way_makes_no_other():
    (route,) = find_routes(airspace(MAST | {"centre": [10, 5]}), START, GOAL)
    assert route.name == "straight"
    assert route.length == pytest.approx(20.0)


LEG = (0.0, 0.0, 0.0), (6.0, 7.0, 8.0)
TOWER = {"name": "tower", "shape": "cylinder", "centre": [3, 3.5], "radius": 2}


@pytest.mark.parametrize(("bottom", "top"), [(-5, 50), (-50, 10), (-1, 9), (-500, 500)])
def test_a_tower_on_a_climb_is_passed_on_both_sides_however_tall(bottom, top):
    """The plane through the middle of the tallest lies beyond both ends of the leg."""
    routes = find_routes(airspace(TOWER | {"bottom": bottom, "top": top}), *LEG)
    names = {route.name: route for route in routes}
    left, right = names["left of tower"], names["right of tower"]
    # The leg leads through the tower's axis: each side is the mirror image of the other.
    assert left.length == pytest.approx(right.length, rel=1e-9)
    to_the_left = np.array([-7.0, 6.0, 0.0])
    assert max(left.places @ to_the_left) > 0.0 == pytest.approx(min(left.places @ to_the_left))
    assert min(right.places @ to_the_left) < 0.0 == pytest.approx(max(right.places @ to_the_left))


@pytest.mark.slow
def test_the_cheaper_side_of_a_tower_is_flown():
    told = scenario(
        mission={"goal": {"position": LEG[1]}, "duration": "free"},
        power={"model": "motor"},
        airspace={"keep_out": [TOWER | {"bottom": -5, "top": 50}]},
    )
    plan = PLANNER.solve(told)
    assert plan.is_verified
    tried = {route.name: route.energy_J for route in plan.routes}
    # Each side is the mirror image of the other.
    assert tried["left of tower"] == pytest.approx(tried["right of tower"], rel=1e-3)
    assert plan.energy <= (1.0 + told.solver.tolerance) * min(tried.values())


def beside(zone, leg):
    """Ways past the sides of a zone, by name, and their lengths."""
    routes = find_routes(airspace(zone), *leg)
    return {route.name: route.length for route in routes if " of " in route.name}


COORDINATE = st.floats(-10.0, 10.0)


@pytest.mark.lengthy
@settings(max_examples=60, deadline=None)
@given(
    across=st.tuples(COORDINATE, COORDINATE),
    climb=COORDINATE,
    offset=st.tuples(st.floats(-0.9, 0.9), st.floats(-0.9, 0.9)),
    where=st.floats(0.2, 0.8),
    is_round=st.booleans(),
    more=st.tuples(st.floats(0.0, 300.0), st.floats(0.0, 300.0)),
)
def test_a_zone_made_taller_keeps_its_routes(across, climb, offset, where, is_round, more):
    assume(np.hypot(*across) > 6.0)
    leg = (0.0, 0.0, 0.0), (*across, climb)
    x, y = where * np.array(across) + 0.7 * np.array(offset)
    # Neither end lies in the tower or at its wall.
    assume(min(np.hypot(x, y), np.hypot(x - across[0], y - across[1])) > 1.6)
    bottom, top = min(0.0, climb) - 1.0, max(0.0, climb) + 1.0

    def zone(down, up):
        if is_round:
            heights = {"bottom": bottom - down, "top": top + up}
            return {"name": "tower", "shape": "cylinder", "centre": [x, y], "radius": 1} | heights
        return wall("tower", [x - 0.7, y - 0.7, bottom - down], [x + 0.7, y + 0.7, top + up])

    short, tall = beside(zone(0.0, 0.0), leg), beside(zone(*more), leg)
    assert short.keys() == tall.keys() == {"left of tower", "right of tower"}
    for name, length in short.items():
        assert tall[name] == pytest.approx(length, rel=1e-6)


def test_an_upright_leg_passes_a_balcony_on_every_side():
    balcony = wall("balcony", [-2, -2, 9], [2, 2, 10])
    routes = find_routes(airspace(balcony), (0.0, 0.5, 0.0), (0.0, 0.5, 20.0))
    assert len({route.name for route in routes}) == 4
    nearly = find_routes(airspace(balcony), (0.0, 0.5, 0.0), (0.1, 0.5, 20.0))
    assert len({route.name for route in nearly}) == 4


def test_a_yard_is_left_by_the_air_unless_there_is_a_ceiling():
    start, goal = (0.0, 0.0, 5.0), (20.0, 0.0, 5.0)
    assert find_routes(airspace(*YARD), start, goal)
    closed = airspace(*YARD, floor=0.0, ceiling=20.0)
    assert find_routes(closed, start, goal) == ()
    assert no_way(closed, start, goal) == (
        "no route: keep-outs north, south, west, east with a clearance of 0 m leave no way 0.15 m "
        "wide from (0, 0, 5) to (20, 0, 5) m; move one of them, or move airspace.floor, or move "
        "airspace.ceiling."
    )


def test_the_zone_that_closes_a_gap_is_named():
    gate = wall("gate", [2, -1, -1], [3, 1, 30])
    east = [wall("left_post", [2, 1, -1], [3, 3, 30]), wall("right_post", [2, -3, -1], [3, -1, 30])]
    closed = airspace(*YARD[:3], *east, gate, ceiling=20.0, floor=-0.5)
    line = no_way(closed, START, GOAL)
    assert "gate" in line
    without = airspace(*YARD[:3], *east, ceiling=20.0, floor=-0.5)
    assert find_routes(without, START, GOAL)


@pytest.mark.lengthy
def test_a_mission_without_a_route_ends_as_infeasible(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    zones = ", ".join(
        f'{{name = "{z["name"]}", shape = "box", low = {z["low"]}, high = {z["high"]}}}'
        for z in YARD
    )
    settings = [
        f"--set=airspace.keep_out=[{zones}]",
        "--set=airspace.ceiling=20.0",
        "--set=airspace.floor=-0.5",
        "--set=mission.goal.position=[20, 0, 5]",
    ]
    assert main(["solve", PAPER_CALM, "--figures=none", *settings]) == ExitCode.NOT_SOLVED
    said = capsys.readouterr()
    assert "no route: keep-outs north, south, west, east" in said.out + said.err


def test_a_journey_goes_from_stop_to_stop_and_its_guess_is_there_in_time():
    turn = (10.0, 6.0, 5.0)
    told = airspace(MAST, floor=0.0, ceiling=9.0)
    journeys = find_journeys(told, (START, turn, GOAL))
    lengths = [length_of(journey) for journey in journeys]
    assert lengths == sorted(lengths)
    there, back = journeys[0]
    assert there.places[-1] == pytest.approx(turn)
    assert lengths[0] == pytest.approx(there.length + back.length)
    guess = guess_along(journeys[0], (4.0, 6.0, 11.0))
    x, y = (np.interp([4.0, 5.0, 6.0], guess["time"], guess[f"rigid_body.{a}"]) for a in "xy")
    assert x == pytest.approx([10.0] * 3)
    assert y == pytest.approx([6.0] * 3)
    assert guess["time"][-1] == 11.0
    shares = guess_along(journeys[0], (4.0, 6.0, 11.0), is_open=True)
    assert shares["time"] == pytest.approx(guess["time"] / 11.0)
    assert all(np.all(shares[name] == guess[name]) for name in guess if name != "time")


def test_ways_that_become_one_flight_on_the_second_mesh_are_refined_once(monkeypatch):
    """The meshes differ, and the energies by rounding alone."""
    monkeypatch.setattr(processes, "cores", lambda _most, **_: 1)
    journeys = find_journeys(airspace(MAST, floor=0.0, ceiling=9.0), [START, GOAL])
    heights = iter([1.0, 2.0])
    refined = []

    class Flights(CoarseFlights):
        def fly(self, _journey):
            return solution_at(next(heights), 100.0, Mesh.uniform(4, 3))

        def refine(self, known, meshes):
            if meshes is None:
                refined.append(known)
                return known
            elements = 5 if known.trajectory.states[0, 0] == 1.0 else 6
            return solution_at(1.5, 100.0 + 1e-9 * elements, Mesh.uniform(elements, 3))

    best, tried = Flights().compared(journeys)
    assert refined == [best]
    assert [(way.name, way.is_kept) for way in tried] == [("right of mast", True)]


def test_the_best_solution_is_flown_in_less_time_until_that_saves_nothing(monkeypatch):
    """Optima of five durations; the cheapest is reached from the better guess alone, in steps."""
    monkeypatch.setattr(processes, "cores", lambda _most, **_: 1)
    journeys = find_journeys(airspace(floor=0.0, ceiling=9.0), [START, GOAL])
    cost, mesh = {12.0: 130.0, 10.0: 100.0, 8.0: 90.0, 7.0: 80.0, 5.0: 95.0}, Mesh.uniform(4, 3)

    class Flights(CoarseFlights):
        has_several_optima = True

        def smooth_guess(self, _journey):
            return {"duration": 10.0}

        def fly(self, _journey, guess=None, options=None):
            del options
            duration = (guess or {"duration": 12.0})["duration"]
            return solution_at(duration, cost[duration], mesh)

        def fly_again(self, flown, share, options=None):
            del options
            duration = flown.trajectory.states[0, 0]
            near = min(cost, key=lambda known: abs(known - share * duration))
            return solution_at(near, cost[near], mesh)

    assert Flights().compared(journeys)[0].objective == min(cost.values())
    # A single journey is solved from both guesses.
    assert Flights().compared(journeys[:1])[0].objective == min(cost.values())


def test_no_further_solve_begins_at_a_failed_one(monkeypatch):
    monkeypatch.setattr(processes, "cores", lambda _most, **_: 1)
    journeys = find_journeys(airspace(floor=0.0, ceiling=9.0), [START, GOAL])
    failed = solution_at(1.0, 100.0, Mesh.uniform(4, 3))
    failed.status = Status.INFEASIBLE

    class Flights(CoarseFlights):
        has_several_optima = True

        def smooth_guess(self, _journey):
            return None

        def fly(self, _journey):
            return failed

        def fly_again(self, *_arguments):
            pytest.fail("solved again")

    assert Flights().compared(journeys)[0] is failed


@pytest.mark.lengthy
def test_a_guess_from_a_solution_in_another_time_follows_its_path_at_another_speed():
    told = load_scenario(PAPER_CALM, ["mission.duration='free'"])
    journey = find_journeys(told.airspace, told.mission.positions)[0]
    solution = RouteFlights(MissionProblem(PLANNER, told)).fly(journey)
    guess = guess_from(solution, 0.5)
    assert guess["duration"] == pytest.approx(0.5 * solution.horizon[1])
    for place, speed in zip(POSITION_STATES, VELOCITY_STATES, strict=True):
        rates = np.gradient(guess[place], guess["duration"] * guess["time"])
        # Differences of second order over 200 intervals.
        assert guess[speed][1:-1] == pytest.approx(rates[1:-1], abs=2e-3 * abs(rates).max() + 1e-6)


def test_a_journey_on_the_sides_of_the_zones_that_an_optimum_touches_is_dominated():
    east = MAST | {"name": "east", "centre": [14.0, 0.0]}
    journeys = find_journeys(airspace(MAST, east, floor=0.0, ceiling=9.0), [START, GOAL])
    sides = [dict(journey[0].sides) for journey in journeys]
    first = sides[0]
    touched = (frozenset({("mast", first["mast"])}),)
    dominated = [_is_dominated(journey, touched) for journey in journeys]
    assert dominated == [own["mast"] is first["mast"] for own in sides]
    assert len(set(dominated)) == 2
    # An optimum that touches nothing is the optimum of the mission without zones.
    assert all(_is_dominated(journey, (frozenset(),)) for journey in journeys)


def test_only_zones_on_the_way_of_the_optimum_are_touched():
    far = {"name": "far", "shape": "cylinder", "centre": [3.0, -1.2], "radius": 0.3}
    near = {"name": "near", "shape": "cylinder", "centre": [2.0, 0.05], "radius": 0.3}
    told = load_scenario(
        PAPER_CALM,
        [
            "mission.goal.position=[4.0, 0.0, 1.0]",
            "mission.duration=5.0",
            "airspace.keep_out=["
            + ", ".join(
                f"{{name='{z['name']}', shape='cylinder', centre={z['centre']}, "
                f"radius={z['radius']}, bottom=-9.0, top=9.0}}"
                for z in (near, far)
            )
            + "]",
        ],
    )
    mission = MissionProblem(PLANNER, told)
    journey = find_journeys(told.airspace, told.mission.positions)[0]
    solution = RouteFlights(mission).fly(journey)
    (touched,) = sides_touched(told, journey, solution)
    assert {name for name, _ in touched} == {"near"}
