"""A plan as a stream of setpoints: PX4's offboard mode, and a trajectory message of ROS 2."""

from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from pyomo_quad.exports.motion import ATTITUDE_STATES, RATE_STATES, Motion
from pyomo_quad.flight.flight import POSITION_STATES, VELOCITY_STATES
from pyomo_quad.scenario import ScenarioError

FloatArray = NDArray[np.float64]

#: Below, PX4 leaves its offboard mode [Hz]; above, no link carries the stream.
SLOWEST_STREAM_HZ, FASTEST_STREAM_HZ = 2.0, 1000.0
# MAVLink's SET_POSITION_TARGET_LOCAL_NED: MAV_FRAME_LOCAL_NED, and no field ignored.
_LOCAL_NED, _ALL_FIELDS = 1, 0
_LONGEST_STREAM_S = (2**32 - 1) / 1000.0  # time_boot_ms is an unsigned number of 32 bits
_MS_PER_S = 1000.0
_NS_PER_S = 1_000_000_000
#: The name under which a bag holds its one message.
TOPIC = "/trajectory"
_MESSAGE = "trajectory_msgs/msg/MultiDOFJointTrajectory"
_WORLD, _BODY = "map", "base_link"


def offboard(motion: Motion, rate_hz: float) -> pd.DataFrame:
    """Return SET_POSITION_TARGET_LOCAL_NED messages, one a row: x north, y east, z down.

    The plan's x is east and its y north, so its yaw counts from east and MAVLink's from north.
    Numbers are those of 32 bits that the message holds.

    Raises
    ------
    ScenarioError
        If the plan lacks a state, or the rate or the duration is beyond PX4.
    """
    motion.require((*POSITION_STATES, *VELOCITY_STATES, ATTITUDE_STATES[2]), "PX4's offboard mode")
    if not SLOWEST_STREAM_HZ < rate_hz <= FASTEST_STREAM_HZ:
        raise ScenarioError(
            f"--rate = {rate_hz:g} Hz; PX4's offboard mode must have more than "
            f"{SLOWEST_STREAM_HZ:g} Hz and at most {FASTEST_STREAM_HZ:g} Hz."
        )
    if motion.duration > _LONGEST_STREAM_S:
        raise ScenarioError(
            f"{motion.name}: the flight lasts {motion.duration:g} s; time_boot_ms of MAVLink ends "
            f"after {_LONGEST_STREAM_S:g} s."
        )
    milliseconds = np.unique(np.round(motion.samples(rate_hz) * _MS_PER_S).astype(np.int64))
    t = milliseconds / _MS_PER_S
    columns: dict[str, object] = {
        "time_boot_ms": milliseconds,
        "coordinate_frame": _LOCAL_NED,
        "type_mask": _ALL_FIELDS,
    }
    for names, values in (
        (("x", "y", "z"), motion.position(t)),
        (("vx", "vy", "vz"), motion.velocity(t)),
        (("afx", "afy", "afz"), motion.acceleration(t)),
    ):
        columns |= dict(zip(names, _north_east_down(values).T.astype(np.float32), strict=True))
    columns["yaw"] = _wrapped(np.pi / 2.0 - motion.yaw(t)).astype(np.float32)
    columns["yaw_rate"] = (-motion.yaw_rate(t)).astype(np.float32)
    return pd.DataFrame(columns)


def offboard_deviation(motion: Motion, stream: pd.DataFrame) -> tuple[float, float]:
    """Return how far a stream leaves the plan between and at its rows: place [m], yaw [rad]."""
    t = stream["time_boot_ms"].to_numpy() / _MS_PER_S
    place = _north_east_down(stream[["x", "y", "z"]].to_numpy(dtype=float))
    velocity = _north_east_down(stream[["vx", "vy", "vz"]].to_numpy(dtype=float))
    yaw = _wrapped(np.pi / 2.0 - stream["yaw"].to_numpy(dtype=float) - motion.yaw(t))
    return _between(motion, t, place, velocity), float(np.abs(yaw).max())


def write_bag(motion: Motion, rate_hz: float, folder: Path) -> int:
    """Write a ROS 2 bag of one trajectory message, and return its number of points.

    The world is x east, y north and z up, the body x forward, y left and z up (REP 103); linear
    velocities and accelerations are of the world, angular velocities of the body.

    Raises
    ------
    ScenarioError
        If the plan lacks a state, or rosbags is not installed.
    """
    motion.require(
        (*POSITION_STATES, *VELOCITY_STATES, *ATTITUDE_STATES, *RATE_STATES), "a ROS 2 trajectory"
    )
    if not 0.0 < rate_hz <= FASTEST_STREAM_HZ:
        raise ScenarioError(
            f"--rate = {rate_hz:g} Hz; must be above 0 and at most {FASTEST_STREAM_HZ:g} Hz."
        )
    try:
        from rosbags.rosbag2 import Writer  # noqa: PLC0415  an extra
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415
    except ImportError:
        raise ScenarioError(
            "--to ros2: rosbags is not installed; install it with pip install 'pyomo_quad[ros]'."
        ) from None
    types = get_typestore(Stores.ROS2_HUMBLE)
    make = types.types
    points = _points(motion, motion.samples(rate_hz), make)
    header = make["std_msgs/msg/Header"](
        stamp=make["builtin_interfaces/msg/Time"](sec=0, nanosec=0), frame_id=_WORLD
    )
    message = make[_MESSAGE](header=header, joint_names=[_BODY], points=points)
    with Writer(folder, version=Writer.VERSION_LATEST) as bag:
        topic = bag.add_connection(TOPIC, _MESSAGE, typestore=types)
        bag.write(topic, 0, types.serialize_cdr(message, _MESSAGE))
    return len(points)


def _points(motion: Motion, t: FloatArray, make: dict[str, type]) -> list[object]:
    vector, twist = make["geometry_msgs/msg/Vector3"], make["geometry_msgs/msg/Twist"]
    quaternion, transform = (
        make["geometry_msgs/msg/Quaternion"],
        make["geometry_msgs/msg/Transform"],
    )
    duration = make["builtin_interfaces/msg/Duration"]
    point = make["trajectory_msgs/msg/MultiDOFJointTrajectoryPoint"]
    turning, turning_faster = motion.values(t, RATE_STATES), motion.slopes(t, RATE_STATES)
    rows = zip(
        t.tolist(),
        motion.position(t).tolist(),
        motion.quaternions(t).tolist(),
        motion.velocity(t).tolist(),
        turning.tolist(),
        motion.acceleration(t).tolist(),
        turning_faster.tolist(),
        strict=True,
    )
    points = []
    for time, place, attitude, velocity, rates, acceleration, rates_slope in rows:
        seconds, nanoseconds = divmod(round(time * _NS_PER_S), _NS_PER_S)
        points.append(
            point(
                transforms=[transform(translation=vector(*place), rotation=quaternion(*attitude))],
                velocities=[twist(linear=vector(*velocity), angular=vector(*rates))],
                accelerations=[twist(linear=vector(*acceleration), angular=vector(*rates_slope))],
                time_from_start=duration(sec=seconds, nanosec=nanoseconds),
            )
        )
    return points


def sampled_deviation(motion: Motion, rate_hz: float) -> float:
    """Return how far a stream of exact numbers leaves the plan between its points [m]."""
    t = motion.samples(rate_hz)
    return _between(motion, t, motion.position(t), motion.velocity(t))


def _between(motion: Motion, t: FloatArray, place: FloatArray, velocity: FloatArray) -> float:
    """Return the distance from the plan of the cubics that a consumer draws between rows [m]."""
    between = np.unique(np.concatenate([t, t[:-1] + np.diff(t) / 2.0]))
    drawn = CubicHermiteSpline(t, place, velocity)(between)
    return float(np.linalg.norm(drawn - motion.position(between), axis=1).max())


def _north_east_down(values: FloatArray) -> FloatArray:
    """Turn east, north, up into north, east, down, and back."""
    return values[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])


def _wrapped(angle: FloatArray) -> FloatArray:
    """Return angles from -pi to pi."""
    return np.asarray(np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi)
