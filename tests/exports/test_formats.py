"""Exports read back: by their consumers' own libraries, or by what the format's text says."""

import importlib.util
import json
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from pyomo_quad.exports import Format, Motion, export_plan
from pyomo_quad.exports.formats import (
    MOST_CRAZYFLIE_PIECES,
    offboard,
)
from pyomo_quad.exports.ground_station import Legs, mission
from pyomo_quad.flight import PlanStatus
from pyomo_quad.report import Figures
from pyomo_quad.report.report import write_solve_report
from pyomo_quad.report.tables import plan_summary, write_summary
from pyomo_quad.scenario import ScenarioError
from pyomo_quad.scenario.earth import GeodeticOrigin
from tests import flights

# A short hop that turns: all of position, attitude and yaw move.
HOP = ("mission.goal.position=[3.0, 2.0, 1.0]", "mission.goal.yaw=0.4", "mission.duration=4.0")
ORIGIN = "-33.8568,151.2153,58.0"
SPEED, WAYPOINT = 178, 16


@cache
def plan():
    return flights.plan("paper_wind", *HOP, "solver.elements=20")


@cache
def truth():
    """The plan as its own table says it, at every hundredth of a second."""
    return plan().to_frame(100.0)


def at(times, columns):
    frame = truth()
    return np.column_stack([np.interp(times, frame.index, frame[name]) for name in columns])


PLACE, SPEEDS = ("x_m", "y_m", "z_m"), ("vx_m_per_s", "vy_m_per_s", "vz_m_per_s")


@pytest.mark.lengthy
def test_px4_reads_setpoints_in_north_east_down(tmp_path):
    mavlink = pytest.importorskip("pymavlink.dialects.v20.common", reason="needs '.[test]'")
    made = export_plan(plan(), Format.PX4, tmp_path / "px4.csv", rate_hz=100.0)
    rows = pd.read_csv(made.path)
    sender, receiver = (mavlink.MAVLink(None) for _ in range(2))
    heard = []
    for row in rows.itertuples(index=False):
        said = mavlink.MAVLink_set_position_target_local_ned_message(
            row.time_boot_ms, 1, 1, row.coordinate_frame, row.type_mask, *row[3:]
        )
        heard.append(receiver.decode(bytearray(said.pack(sender))))
    times = np.array([message.time_boot_ms for message in heard]) / 1000.0
    assert {message.coordinate_frame for message in heard} == {mavlink.MAV_FRAME_LOCAL_NED}
    assert {message.type_mask for message in heard} == {0}
    east_north_up = [(m.y, m.x, -m.z) for m in heard]
    np.testing.assert_allclose(east_north_up, at(times, PLACE), atol=1e-6)
    np.testing.assert_allclose([(m.vy, m.vx, -m.vz) for m in heard], at(times, SPEEDS), atol=1e-6)
    # The declared equations were flown for the table: its speeds' slope is the acceleration.
    slopes = np.gradient(at(times, SPEEDS), times, axis=0)[5:-5]
    accelerations = np.array([(m.afy, m.afx, -m.afz) for m in heard])[5:-5]
    np.testing.assert_allclose(accelerations, slopes, atol=5e-3)
    # North is y: a plan that looks east, yaw 0, has a heading of a quarter turn.
    assert heard[0].yaw == pytest.approx(np.pi / 2)
    assert heard[-1].yaw == pytest.approx(np.pi / 2 - 0.4, abs=1e-5)
    assert times[-1] == pytest.approx(4.0)
    assert made.position_error_m < 1e-4


def test_a_bag_holds_the_trajectory_as_ros_2_deserialises_it(tmp_path):
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="needs '.[ros]'")
    from rosbags.typesys import Stores, get_typestore

    made = export_plan(plan(), Format.ROS2, tmp_path / "bag")
    types = get_typestore(Stores.ROS2_JAZZY)
    with rosbag2.Reader(made.path) as reader:
        ((topic, _, raw),) = reader.messages()
    trajectory = types.deserialize_cdr(raw, topic.msgtype)
    assert trajectory.joint_names == ["base_link"]
    assert len(trajectory.points) == made.parts == 201
    stamps = [p.time_from_start for p in trajectory.points]
    times = np.array([stamp.sec + 1e-9 * stamp.nanosec for stamp in stamps])
    places = [p.transforms[0].translation for p in trajectory.points]
    np.testing.assert_allclose([(v.x, v.y, v.z) for v in places], at(times, PLACE), atol=1e-6)
    turns = [p.transforms[0].rotation for p in trajectory.points]
    attitude = Rotation.from_quat([(q.x, q.y, q.z, q.w) for q in turns])
    yaw_pitch_roll = at(times, ("psi_rad", "theta_rad", "phi_rad"))
    np.testing.assert_allclose(attitude.as_euler("ZYX"), yaw_pitch_roll, atol=1e-6)
    speeds = [p.velocities[0].linear for p in trajectory.points]
    np.testing.assert_allclose([(v.x, v.y, v.z) for v in speeds], at(times, SPEEDS), atol=1e-6)
    rates = [p.velocities[0].angular.z for p in trajectory.points]
    np.testing.assert_allclose(rates, at(times, ("r_rad_per_s",))[:, 0], atol=1e-5)


def test_a_crazyflie_flies_pieces_within_the_stated_error(tmp_path):
    made = export_plan(plan(), "crazyflie", tmp_path / "swarm.csv", path_error_m=0.002)
    rows = np.loadtxt(made.path, delimiter=",", skiprows=1)
    assert rows.shape == (made.parts, 33)
    times = np.linspace(0.0, 4.0, 101)
    ends = np.cumsum(rows[:, 0])
    assert ends[-1] == pytest.approx(4.0, abs=1e-6)
    flown = []
    for t in times:
        piece = min(int(np.searchsorted(ends, t)), len(rows) - 1)
        coefficients = rows[piece, 1:].reshape(4, 8)
        local = t - (ends[piece] - rows[piece, 0])
        flown.append([np.polyval(axis[::-1], local) for axis in coefficients])
    flown = np.array(flown)
    distance = np.linalg.norm(flown[:, :3] - at(times, PLACE), axis=1).max()
    assert distance <= made.position_error_m + 1e-6 <= 0.002
    np.testing.assert_allclose(flown[:, 3], at(times, ("psi_rad",))[:, 0], atol=2e-3)


def test_the_crazyflie_library_packs_as_many_pieces_as_its_memory_holds(tmp_path):
    memory = pytest.importorskip(
        "cflib.crazyflie.mem.trajectory_memory", reason="cflib is not installed"
    )
    made = export_plan(plan(), "crazyflie", tmp_path / "swarm.csv")
    rows = np.loadtxt(made.path, delimiter=",", skiprows=1)
    packed = bytearray()
    for duration, *values in rows.tolist():
        axes = [memory.Poly4D.Poly(values[at : at + 8]) for at in range(0, 32, 8)]
        packed += memory.Poly4D(duration, *axes).pack()
    assert len(packed) == made.parts * 132 <= 4096
    assert np.array_equal(np.frombuffer(packed[:32], np.float32), rows[0, 1:9].astype(np.float32))
    assert (MOST_CRAZYFLIE_PIECES + 1) * 132 > 4096


def test_more_pieces_than_a_crazyflie_holds_are_refused(tmp_path):
    out = tmp_path / "swarm.csv"
    with pytest.raises(ScenarioError, match=r"31 pieces of degree 7.*give a larger --path-error"):
        export_plan(plan(), "crazyflie", out, path_error_m=1e-6)
    assert not list(tmp_path.iterdir())


def trajectory_of(file):
    spec = importlib.util.spec_from_file_location("exported", file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.trajectory


def test_rotorpy_follows_the_object_of_its_file(tmp_path):
    made = export_plan(plan(), "rotorpy", tmp_path / "hop_rotorpy.py")
    assert "pyomo_quad" not in (tmp_path / "hop_rotorpy.py").read_text()
    trajectory = trajectory_of(made.path)
    times = np.linspace(0.0, 4.0, 81)
    outputs = [trajectory.update(t) for t in times]
    flown = np.array([output["x"] for output in outputs])
    distance = np.linalg.norm(flown - at(times, PLACE), axis=1).max()
    assert distance <= made.position_error_m + 1e-6 <= 1.1e-4
    # Each derivative is the slope of the one before it.
    step = 1e-5
    names = ("x", "x_dot", "x_ddot", "x_dddot", "x_ddddot")
    for name, slope in pairwise(names):
        for t in (0.33, 1.7, 3.61):
            ends = [trajectory.update(t + side)[name] for side in (-step, step)]
            difference = (ends[1] - ends[0]) / (2 * step)
            assert trajectory.update(t)[slope] == pytest.approx(difference, abs=1e-3, rel=1e-4)
    after = trajectory.update(9.0)
    np.testing.assert_allclose(after["x"], [3.0, 2.0, 1.0], atol=1e-4)
    assert not after["x_dot"].any()
    assert after["yaw"] == pytest.approx(0.4, abs=1e-4)


def test_rotorpys_own_controller_takes_it(tmp_path):
    control = pytest.importorskip("rotorpy.controllers.quadrotor_control", reason="no RotorPy")
    from rotorpy.vehicles.hummingbird_params import quad_params

    made = export_plan(plan(), "rotorpy", tmp_path / "hop_rotorpy.py")
    wanted = trajectory_of(made.path).update(2.0)
    state = {
        "x": wanted["x"],
        "v": wanted["x_dot"],
        "q": np.array([0, 0, 0, 1.0]),
        "w": np.zeros(3),
    }
    commands = control.SE3Control(quad_params).update(2.0, state, wanted)
    assert np.isfinite(commands["cmd_motor_speeds"]).all()


def test_qgroundcontrol_reads_waypoints_that_keep_to_the_plan_in_space_and_time(tmp_path):
    made = export_plan(
        plan(), "qgroundcontrol", tmp_path / "hop.plan", origin=ORIGIN, path_error_m=0.1
    )
    document = json.loads((tmp_path / "hop.plan").read_text())
    assert (document["fileType"], document["version"]) == ("Plan", 1)
    items = document["mission"]["items"]
    assert [item["doJumpId"] for item in items] == list(range(1, len(items) + 1))
    assert document["mission"]["plannedHomePosition"] == [-33.8568, 151.2153, 58.0]
    places, times, speed = [], [0.0], None
    for item in items:
        if item["command"] == SPEED:
            speed = item["params"][1]
            continue
        assert (item["command"], item["frame"]) == (WAYPOINT, 3)
        places.append(local(*item["params"][4:]))
        if len(places) > 1:
            leg = np.linalg.norm(places[-1] - places[-2])
            times.append(times[-1] + (item["params"][0] or leg / speed))
    assert len(places) == made.parts
    assert times[-1] == pytest.approx(4.0, abs=1e-3)
    t = np.linspace(0.0, 4.0, 401)
    flown = np.column_stack([np.interp(t, times, axis) for axis in np.array(places).T])
    distance = np.linalg.norm(flown - at(t, PLACE), axis=1).max()
    assert distance <= made.position_error_m + 1e-3 <= 0.102


def local(latitude, longitude, height):
    """East, north and up of the origin by the small-angle radii of the ellipsoid (mm over 10 m)."""
    latitude_0, longitude_0 = np.radians([-33.8568, 151.2153])
    across = 1 - 0.00669437999014 * np.sin(latitude_0) ** 2
    normal, meridian = 6378137 / np.sqrt(across), 6378137 * (1 - 0.00669437999014) / across**1.5
    east = (np.radians(longitude) - longitude_0) * (normal + 58) * np.cos(latitude_0)
    return np.array([east, (np.radians(latitude) - latitude_0) * (meridian + 58), height])


def test_items_are_what_mavlink_can_carry(tmp_path):
    mavlink = pytest.importorskip("pymavlink.dialects.v20.common", reason="needs '.[test]'")
    made = export_plan(plan(), "qgroundcontrol", tmp_path / "hop.plan", origin=ORIGIN)
    link = mavlink.MAVLink(None)
    for item in json.loads((tmp_path / "hop.plan").read_text())["mission"]["items"]:
        *params, x, y, z = (np.nan if value is None else value for value in item["params"])
        whole = (round(x * 1e7), round(y * 1e7)) if item["command"] == WAYPOINT else (x, y)
        said = mavlink.MAVLink_mission_item_int_message(
            1, 1, item["doJumpId"] - 1, item["frame"], item["command"], 0, 1, *params, *whole, z
        )
        heard = link.decode(bytearray(said.pack(link)))
        assert (heard.command, heard.z) == (item["command"], pytest.approx(z, abs=1e-5))
    assert made.yaw_error_rad is None


def test_a_pause_is_a_wait_and_too_many_items_are_refused():
    origin = GeodeticOrigin(latitude=47.0, longitude=8.0, altitude=400.0)
    places = np.array([[0, 0, 5], [4, 0, 5], [4, 0, 5.01], [4, 4, 5]], dtype=float)
    legs = Legs(times=np.array([0.0, 2.0, 12.0, 14.0]), places=places)
    items = mission(legs, origin, Motion.of(plan()), 0.1)["mission"]["items"]
    waypoints = [item for item in items if item["command"] == WAYPOINT]
    assert [item["params"][0] for item in waypoints] == [0.0, 0.0, 10.0, 0.0]
    assert [item["params"][1] for item in items if item["command"] == SPEED] == [
        pytest.approx(2.0),
        pytest.approx(2.0, rel=1e-4),
    ]
    t = np.arange(600.0)
    many = Legs(times=t, places=np.column_stack([t, t, t]))
    with pytest.raises(
        ScenarioError, match=r"paper_wind: --path-error 0.1 m takes 1199 .*holds 500"
    ):
        mission(many, origin, Motion.of(plan()), 0.1)


def test_the_globe_is_an_ellipsoid():
    # A degree of latitude and of longitude at 45 degrees on WGS 84: 111.132 and 78.847 km.
    origin = GeodeticOrigin(latitude=45.0, longitude=10.0, altitude=0.0)
    steps = np.array([[100.0, 0, 0], [0, 100.0, 0], [0, 0, 100.0]])
    moved = origin.geodetic(steps) - np.array([45.0, 10.0, 0.0])
    assert moved[0, 1] == pytest.approx(100 / 78_846.8, rel=1e-4)
    assert moved[1, 0] == pytest.approx(100 / 111_132.0, rel=1e-4)
    assert moved[2] == pytest.approx([0.0, 0.0, 100.0], abs=1e-6)
    pole = GeodeticOrigin(latitude=90.0, longitude=0.0, altitude=0.0).geodetic(steps)
    assert np.isfinite(pole).all()
    assert pole[2, 2] == pytest.approx(100.0, abs=1e-6)


def test_a_report_says_the_same_as_the_plan(tmp_path):
    plan().save(tmp_path / "plan.npz")
    folder = tmp_path / "report"
    folder.mkdir()
    write_solve_report(folder, plan(), figures=Figures.NONE)
    write_summary(folder, plan_summary(plan(), wall_s={}))
    t = np.linspace(0.0, 4.0, 77)
    saved, reported = Motion.read(tmp_path / "plan.npz"), Motion.read(folder)
    for kind in ("position", "velocity", "acceleration", "yaw", "quaternions"):
        np.testing.assert_allclose(
            getattr(reported, kind)(t), getattr(saved, kind)(t), atol=1e-8, err_msg=kind
        )


def test_only_a_verified_plan_leaves(tmp_path):
    failed = replace(plan(), status=PlanStatus.NOT_CONVERGED)
    with pytest.raises(ScenarioError, match='status = "not_converged"; must be verified'):
        export_plan(failed, "px4", tmp_path / "px4.csv")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("to", "state"),
    [
        ("px4", "rigid_body.psi"),
        ("ros2", "rigid_body.phi"),
        ("crazyflie", "rigid_body.psi"),
        ("rotorpy", "rigid_body.psi"),
        ("qgroundcontrol", "rigid_body.z"),
    ],
)
def test_a_plan_without_what_a_format_needs_is_refused(tmp_path, to, state):
    held = plan().trajectories
    kept = [i for i, name in enumerate(held.state_names) if name != state]
    lacking = replace(
        plan(),
        trajectories=replace(
            held,
            states=held.states[:, kept],
            state_names=tuple(held.state_names[i] for i in kept),
        ),
    )
    options = {"origin": ORIGIN} if to in {"qgroundcontrol", "missionplanner"} else {}
    with pytest.raises(ScenarioError, match=f"the plan has no {state}, which .* needs"):
        export_plan(lacking, to, tmp_path / "out", **options)
    assert not list(tmp_path.iterdir())


def test_a_flight_beyond_the_clock_of_mavlink_is_refused():
    times = np.array([0.0, 4.3e6])
    short = Motion.of(plan())
    states = np.zeros((2, len(short.names)))
    long = replace(short, name="long", times=times, states=states, degrees=(1,))
    with pytest.raises(ScenarioError, match="time_boot_ms of MAVLink ends after"):
        offboard(long, 50.0)


def test_yaw_of_more_than_a_turn_is_wrapped_for_px4_alone():
    straight = Motion.of(plan())
    states = np.zeros((2, len(straight.names)))
    states[1, straight.names.index("rigid_body.psi")] = 7.0
    turning = replace(straight, times=np.array([0.0, 4.0]), states=states, degrees=(1,))
    yaw = offboard(turning, 50.0)["yaw"]
    assert yaw.abs().max() <= np.float32(np.pi)
    assert np.cos(yaw.iloc[-1]) == pytest.approx(np.cos(np.pi / 2 - 7.0), abs=1e-6)
    assert turning.yaw(np.array([4.0]))[0] == pytest.approx(7.0)
