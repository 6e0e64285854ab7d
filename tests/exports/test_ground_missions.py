"""Missions of ground stations as scenarios, and back again to the same places."""

import json
from pathlib import Path

import numpy as np
import pytest

from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.exports import Motion, export_plan, read_mission
from pyomo_quad.exports.ground_station import mission, thin, waypoint_file
from pyomo_quad.flight import Planner
from pyomo_quad.flight.flight import POSITION_STATES
from pyomo_quad.scenario import ScenarioError, load_scenario

MISSIONS = Path(__file__).parent / "missions"
PLANS = ("square", "tour", "fence")
# Of WGS 84, by the standard formulas of its radii of curvature.
SEMI_MAJOR, ECCENTRICITY_2 = 6_378_137.0, 6.694379990141e-3


def metres(home, latitude, longitude):
    """East and north of a home by the ellipsoid's radii of curvature there (mm over 100 m)."""
    phi = np.radians(home.latitude)
    across = 1.0 - ECCENTRICITY_2 * np.sin(phi) ** 2
    meridian = SEMI_MAJOR * (1.0 - ECCENTRICITY_2) / across**1.5
    parallel = SEMI_MAJOR / np.sqrt(across) * np.cos(phi)
    east = np.radians(longitude - home.longitude) * (parallel + home.altitude * np.cos(phi))
    return east, np.radians(latitude - home.latitude) * (meridian + home.altitude)


def places(scenario):
    return np.array(scenario.mission.positions)


def along(scenario, pace_s=10.0):
    """A flight in straight lines through a mission's places, a leg every ten seconds."""
    rows, times, passed = [scenario.mission.start.position], [0.0], []
    for waypoint in scenario.mission.waypoints:
        reached = times[-1] + pace_s
        passed.append(reached)
        for time in sorted({reached, reached + waypoint.hold}):
            rows.append(waypoint.position)
            times.append(time)
    rows.append(scenario.mission.goal.position)
    times.append(times[-1] + pace_s)
    return Motion(
        name=scenario.name,
        mission=scenario.lasting(times[-1], passed),
        times=np.array(times),
        states=np.array(rows),
        names=POSITION_STATES,
        degrees=(1,) * (len(times) - 1),
    )


def test_a_plan_file_becomes_places_holds_and_heights():
    read = read_mission(MISSIONS / "tour.plan")
    scenario = read.scenario
    home = scenario.mission.origin
    written = [
        (46.9482, 7.4474, 10.0),
        (46.94838, 7.44768, 16.0),
        (46.94810, 7.44795, 18.0),  # 560.5 m above the sea, 542.5 m at home
        (46.94785, 7.44770, 14.0),
        (46.94785, 7.44735, 15.0),
        (46.9482, 7.4474, 10.0),
    ]
    expected = [(*metres(home, *place[:2]), place[2]) for place in written]
    np.testing.assert_allclose(places(scenario), expected, atol=2e-3)
    assert [waypoint.hold for waypoint in scenario.mission.waypoints] == [0.0, 0.0, 0.0, 5.0]
    assert scenario.mission.is_free
    assert read.left_out == (
        "speeds, which the plan chooses",
        "command 195",
        "terrain: altitudes over it count from the home's, as over flat ground",
    )


def test_a_fence_becomes_airspace_and_a_gripper_a_release():
    scenario = read_mission(MISSIONS / "fence.plan", payload_kg=0.4).scenario
    inside = scenario.airspace.keep_in
    assert inside is not None
    assert np.array(inside.corners).shape == (4, 2)
    assert [zone.shape.value for zone in scenario.airspace.keep_out] == ["polygon", "cylinder"]
    for zone in scenario.airspace.keep_out:
        middle = zone.centre or np.mean(zone.corners, axis=0)
        assert zone.depth([[*middle, -1e4], [*middle, 1e4]]).min() > 0.0
    assert scenario.airspace.keep_out[1].radius == pytest.approx(9.5)
    assert [z for *_, z in scenario.mission.rally] == pytest.approx([25.0, 30.0], abs=1e-3)
    assert [waypoint.release for waypoint in scenario.mission.waypoints] == [0.0, 0.4, 0.0]
    assert scenario.mission.goal.position == scenario.mission.start.position


def test_a_waypoint_file_of_mission_planner():
    read = read_mission(MISSIONS / "mapped.waypoints")
    start, first, second, goal = places(read.scenario)
    np.testing.assert_allclose([start, goal], [[0.0, 0.0, 12.0]] * 2, atol=1e-6)
    east, north = metres(read.scenario.mission.origin, 47.05038, 8.30955)
    np.testing.assert_allclose(first, [east, north, 12.0], atol=2e-3)
    assert second[2] == pytest.approx(16.5, abs=1e-3)
    waypoints = read.scenario.mission.waypoints
    assert [waypoint.hold for waypoint in waypoints] == [3.0, 4.0]
    # A heading of 90 degrees looks east, along x; 0 says in this format that any will do.
    assert [waypoint.yaw for waypoint in waypoints] == [None, pytest.approx(0.0)]


@pytest.mark.parametrize("moved", ["0.0000000", "0.0010000"])
def test_circling_without_end_is_the_goal_at_the_last_place_too(tmp_path, moved):
    """The place at which the vehicle circles may be the one to which it flew before."""
    north = f"{47.0506 + float(moved):.7f}"
    rows = (
        "QGC WPL 110",
        "0 1 0 16 0 0 0 0 47.0502 8.3093 436.0 1",
        "1 0 3 22 0 0 0 0 0 0 12.0 1",
        "2 0 3 16 0 0 0 0 47.0506 8.3093 12.0 1",
        f"3 0 3 17 0 0 0 0 {north} 8.3093 12.0 1",
        "4 0 3 16 0 0 0 0 47.0600 8.3093 12.0 1",
    )
    path = tmp_path / "circling.waypoints"
    path.write_text("\n".join([rows[0], *(row.replace(" ", "\t") for row in rows[1:])]) + "\n")
    read = read_mission(path)
    goal = places(read.scenario)[-1]
    expected = metres(read.scenario.mission.origin, float(north), 8.3093)
    np.testing.assert_allclose(goal, [*expected, 12.0], atol=5e-3)


@pytest.mark.parametrize("name", PLANS)
@pytest.mark.parametrize("ending", [".plan", ".waypoints"])
def test_a_flight_through_the_places_is_read_as_the_same_mission(tmp_path, name, ending):
    scenario = read_mission(MISSIONS / f"{name}.plan", payload_kg=0.4).scenario
    motion = along(scenario)
    held = mission(thin(motion, 0.25), scenario.mission.origin, motion, 0.25)
    file = tmp_path / f"again{ending}"
    file.write_text(json.dumps(held) if ending == ".plan" else waypoint_file(held))
    again = read_mission(file, payload_kg=0.4).scenario
    np.testing.assert_allclose(places(again), places(scenario), atol=1e-3)
    for one, other in zip(again.mission.waypoints, scenario.mission.waypoints, strict=True):
        assert (one.hold, one.release) == (pytest.approx(other.hold), other.release)
    if ending == ".plan":
        np.testing.assert_allclose(again.mission.rally, scenario.mission.rally, atol=1e-3)
        inside, before = again.airspace.keep_in, scenario.airspace.keep_in
        assert (inside is None) == (before is None)
        if inside is not None and before is not None:
            np.testing.assert_allclose(inside.corners, before.corners, atol=1e-3)
        assert len(again.airspace.keep_out) == len(scenario.airspace.keep_out)


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANS)
def test_a_plan_is_exported_and_read_as_the_same_places(tmp_path, name):
    scenario = read_mission(MISSIONS / f"{name}.plan", payload_kg=0.4).scenario
    # At `quick`, a plan may pass its waypoints farther off than 1 mm.
    plan = Planner().solve(scenario.with_values({"solver.accuracy": "standard"}))
    assert plan.is_verified
    made = export_plan(plan, "qgroundcontrol", tmp_path / "flown.plan")
    assert made.position_error_m < 0.26
    again = read_mission(made.path, payload_kg=0.4).scenario
    np.testing.assert_allclose(places(again), places(scenario), atol=1e-3)


@pytest.mark.slow
def test_a_quick_plan_whose_heading_turns_as_much_as_is_tolerated_is_exported(tmp_path):
    scenario = read_mission(MISSIONS / "square.plan", payload_kg=0.4).scenario
    plan = Planner().solve(scenario.with_values({"solver.accuracy": "quick"}))
    assert plan.is_verified
    assert export_plan(plan, "qgroundcontrol", tmp_path / "flown.plan").position_error_m < 0.26


def test_the_command_writes_a_scenario_that_loads(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    command = ["import", str(MISSIONS / "fence.plan"), "--payload", "0.4", "--name", "site"]
    assert main(command) == ExitCode.VERIFIED
    said = capsys.readouterr().out.splitlines()
    assert said[0] == (
        "Written to site.toml: start, 3 waypoints, goal; a fence, 2 zones, 2 rally points."
    )
    assert said[1:] == ["Left out: command 206.", "Fly it: pyomo-quad run site.toml"]
    read = read_mission(MISSIONS / "fence.plan", payload_kg=0.4, name="site").scenario
    written = load_scenario("site.toml")
    assert (written.mission, written.airspace) == (read.mission, read.airspace)
    assert main(command) == ExitCode.BAD_INPUT
    assert "site.toml: exists already" in capsys.readouterr().err


def changed(tmp_path, change):
    document = json.loads((MISSIONS / "square.plan").read_text())
    change(document)
    file = tmp_path / "changed.plan"
    file.write_text(json.dumps(document))
    return file


@pytest.mark.parametrize("numbers", [(0, 4), (0,), (4,)])
def test_headings_of_start_and_goal_are_kept_and_their_holds_and_radii_told(tmp_path, numbers):
    def change(document):
        for number in numbers:
            item = document["mission"]["items"][number]
            item.update(command=16, params=[3.0, 1.5, 0, 90.0 * number, *item["params"][4:]])

    read = read_mission(changed(tmp_path, change))
    # Compass headings of 0 and 360 degrees look north, along y.
    ends = read.scenario.mission.start, read.scenario.mission.goal
    assert [end.yaw for end in ends] == pytest.approx([np.pi / 2] * 2)
    times = f" ({len(numbers)} times)" if len(numbers) > 1 else ""
    assert read.left_out == (
        f"the time of hover at an end of the flight{times}",
        f"the acceptance radius at an end of the flight{times}",
    )


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d.update(fileType="Log"), r"is no plan file; must have .fileType"),
        (lambda d: d["mission"].update(plannedHomePosition=[95, 8]), r"plannedHomePosition, lat"),
        (lambda d: d["mission"]["items"][1]["params"].pop(), r"item 2: has no seven params"),
        (lambda d: d["mission"]["items"][1]["params"].__setitem__(4, 123.0), r"item 2, latitude"),
        (lambda d: d["mission"]["items"][1].update(command=177), r"item 2: repeats a part"),
        (lambda d: d["mission"]["items"][1].update(frame=9), r"item 2: frame 9; must be one of"),
        (
            lambda d: d["mission"]["items"].append({"type": "ComplexItem", "complexItemType": "S"}),
            r"item 6: .S. has no list of commands; convert it to waypoints",
        ),
        (lambda d: d["mission"].update(items=[]), r"the mission has 0 places; must have at least"),
        (
            lambda d: d["geoFence"].update(
                circles=[{"circle": {"center": [47.0, 8.3], "radius": 5}, "inclusion": True}] * 2
            ),
            r"has 2 fences to stay inside of; a scenario has one at most",
        ),
    ],
)
def test_a_mission_that_no_scenario_holds_is_told_in_one_line(tmp_path, change, said):
    with pytest.raises(ScenarioError, match=said) as told:
        read_mission(changed(tmp_path, change))
    assert len(str(told.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is neither a .plan file"),
        ("QGC WPL 120\n", "begins with .QGC WPL 120.; must be QGC WPL 110"),
        ("QGC WPL 110\n", "has no rows; the first is the home"),
        ("QGC WPL 110\n0 1 0 16 0 0 0 0 47 8 436 one\n", "row .0.: has a word that is no number"),
        ("QGC WPL 110\n0 1 0 16 0 0 0 0 47 8 nan 1\n", "row .0.: must have twelve finite numbers"),
        ("QGC WPL 110\n0 1 0 16 0 0 0 0 47 8 436 1\n", "the mission has 0 places"),
    ],
)
def test_a_text_that_is_no_mission_is_told_in_one_line(tmp_path, text, said):
    file = tmp_path / "m.waypoints"
    file.write_text(text)
    with pytest.raises(ScenarioError, match=said) as told:
        read_mission(file)
    assert len(str(told.value).splitlines()) == 1


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ScenarioError, match="cannot be read"):
        read_mission(tmp_path / "none.plan")
