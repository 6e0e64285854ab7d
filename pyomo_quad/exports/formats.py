"""Export of plans: file formats, their options, and the deviation of a file from the plan.

Files for PX4's offboard mode contain a stream of setpoints, and files for ROS 2 a trajectory
message. Files for ground stations contain a mission of a few geodetic waypoints with speeds. Files
for Crazyflie swarms and for the simulator RotorPy contain polynomial pieces.
"""

import inspect
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.interpolate import CubicHermiteSpline

from pyomo_quad.arrays import FloatArray
from pyomo_quad.exports.ground_station import (
    WAYPOINT_FILE_HEADER,
    Legs,
    mission,
    thin,
    waypoint_file,
)
from pyomo_quad.exports.motion import (
    ATTITUDE_STATES,
    RATE_STATES,
    Motion,
    PolynomialTrajectory,
    fit_pieces,
    piece_deviation,
)
from pyomo_quad.flight import Plan
from pyomo_quad.flight.flight import POSITION_STATES, VELOCITY_STATES
from pyomo_quad.report.folder import MARK, final_folder, output_file, output_folder
from pyomo_quad.scenario import ScenarioError
from pyomo_quad.scenario.earth import GLOBE, GeodeticOrigin
from pyomo_quad.scenario.fields import number_in_text
from pyomo_quad.scenario.messages import shown

#: Rates [Hz] below which PX4 leaves its offboard mode, and above which no link carries the stream.
SLOWEST_STREAM_HZ, FASTEST_STREAM_HZ = 2.0, 1000.0
# Values of MAVLink's message SET_POSITION_TARGET_LOCAL_NED: MAV_FRAME_LOCAL_NED, no field ignored.
_LOCAL_NED, _ALL_FIELDS = 1, 0
_LONGEST_STREAM_S = (2**32 - 1) / 1000.0  # time_boot_ms is an unsigned number of 32 bits
_MS_PER_S = 1000.0
_NS_PER_S = 1_000_000_000
#: Topic of the single message in a bag.
TOPIC = "/trajectory"
_MESSAGE = "trajectory_msgs/msg/MultiDOFJointTrajectory"
_WORLD, _BODY = "map", "base_link"


def offboard(motion: Motion, rate_hz: float) -> pd.DataFrame:
    """Make the stream of setpoints for PX4's offboard mode: one MAVLink message per row.

    Columns are the fields of SET_POSITION_TARGET_LOCAL_NED. Axes are north, east, down; yaw is
    clockwise from north. Units are SI; the time is in ms. A missing state or a violated limit of
    PX4 raises a ScenarioError.
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
    # In the plan, x is east, y is north, and yaw is counter-clockwise from east. The message has
    # numbers of 32 bits.
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
    """Return the largest deviation of a stream of setpoints from the plan: position [m], yaw [rad].

    `stream` comes from `offboard`. Between the setpoints, its position is a cubic spline (see
    `_between`). The yaw is compared at the setpoints only.
    """
    t = stream["time_boot_ms"].to_numpy() / _MS_PER_S
    place = _north_east_down(stream[["x", "y", "z"]].to_numpy(dtype=float))
    velocity = _north_east_down(stream[["vx", "vy", "vz"]].to_numpy(dtype=float))
    yaw = _wrapped(np.pi / 2.0 - stream["yaw"].to_numpy(dtype=float) - motion.yaw(t))
    return _between(motion, t, place, velocity), float(np.abs(yaw).max())


def write_bag(motion: Motion, rate_hz: float, folder: Path) -> int:
    """Write a plan as a ROS 2 bag with a single trajectory message; return its number of points.

    The axes follow REP 103. `folder` must not exist. `rate_hz` is the number of points per second.
    A ScenarioError is raised if the plan lacks a state of position, velocity, attitude or body
    rates; if the Python package rosbags is not installed; or if `rate_hz` is not above 0 and at
    most `FASTEST_STREAM_HZ`.
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
    names = ("Vector3", "Twist", "Quaternion", "Transform")
    vector, twist, quaternion, transform = (make[f"geometry_msgs/msg/{name}"] for name in names)
    duration = make["builtin_interfaces/msg/Duration"]
    point = make["trajectory_msgs/msg/MultiDOFJointTrajectoryPoint"]
    # World axes are x east, y north, z up; body axes x forward, y left, z up (REP 103). Linear
    # velocities and accelerations are in world axes, angular ones in body axes.
    columns = (
        *(motion.position(t), motion.quaternions(t), motion.velocity(t)),
        *(motion.values(t, RATE_STATES), motion.acceleration(t), motion.slopes(t, RATE_STATES)),
    )
    points = []
    for time, *row in zip(t.tolist(), *(column.tolist() for column in columns), strict=True):
        place, attitude, velocity, rates, acceleration, rates_slope = row
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
    """Return the largest distance [m] between a plan and a cubic spline through samples of it.

    The spline has the plan's position and velocity at each sample. The distance is the deviation of
    a ROS 2 trajectory from its plan.
    """
    t = motion.samples(rate_hz)
    return _between(motion, t, motion.position(t), motion.velocity(t))


def _between(motion: Motion, t: FloatArray, place: FloatArray, velocity: FloatArray) -> float:
    """Return the largest distance [m] between a plan and a cubic spline through setpoints.

    The spline has the positions [m] and velocities [m/s] of the setpoints, shape (n, 3), at times
    t [s].
    """
    # The distance is computed at the setpoints and halfway between them.
    between = np.unique(np.concatenate([t, t[:-1] + np.diff(t) / 2.0]))
    drawn = CubicHermiteSpline(t, place, velocity)(between)
    return float(np.linalg.norm(drawn - motion.position(between), axis=1).max())


def _north_east_down(values: FloatArray) -> FloatArray:
    """Convert vectors, the rows of `values`, from east, north, up to north, east, down, or back."""
    return values[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])


def _wrapped(angle: FloatArray) -> FloatArray:
    """Wrap angles [rad] to the range from -pi to pi."""
    return np.asarray(np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi)


def origin_of(text: str) -> GeodeticOrigin:
    """Return latitude [deg], longitude [deg] and altitude [m] from a text with commas.

    An example is "47.3977,8.5456,488". The text is the value of the command-line option
    ``--origin``. If it is not three numbers or not a position on the globe, a ScenarioError is
    raised.
    """
    try:
        given = dict(zip(GLOBE, map(number_in_text, text.split(",")), strict=True))
    except ValueError:
        raise ScenarioError(
            f"--origin {shown(text)}: must be LAT,LON,ALT in degrees and metres above the sea, "
            "such as 47.3977,8.5456,488."
        ) from None
    for name, (low, high, unit) in GLOBE.items():
        if not low <= given[name] <= high:
            raise ScenarioError(
                f"--origin: {name} = {given[name]:g} {unit}; must be from {low:g} to {high:g} "
                f"{unit}."
            )
    return GeodeticOrigin(**given)


class Format(StrEnum):
    """File format of an exported plan, named after the program or autopilot that reads the file."""

    QGROUNDCONTROL = "qgroundcontrol"
    MISSION_PLANNER = "missionplanner"
    PX4 = "px4"
    ROS2 = "ros2"
    CRAZYFLIE = "crazyflie"
    ROTORPY = "rotorpy"


@dataclass(frozen=True, kw_only=True)
class Export:
    """Result of an export: the written file and its deviation from the plan.

    Attributes
    ----------
    path : str
        Path of the file, or of the folder of a ROS 2 bag.
    parts : int
        Number of waypoints, setpoints, trajectory points or polynomial pieces.
    what : str
        Name of the counted parts, such as "setpoints".
    position_error_m : float
        Largest distance, at equal times, between the plan and a vehicle that follows the file
        exactly.
    yaw_error_rad : float or None
        Largest deviation from the plan's heading; None if the autopilot chooses the heading.
    is_paper_plan : bool
        Whether the plan has no margins from its limits, because the scenario does not state
        `mission.risk`. A controller that corrects disturbances may then break a limit.
    """

    path: str
    parts: int
    what: str
    position_error_m: float
    yaw_error_rad: float | None
    is_paper_plan: bool = False

    def as_mapping(self) -> dict[str, Any]:
        """Return the attributes of the result as a dictionary."""
        return asdict(self)


_Written = tuple[int, str, float, float | None]


@dataclass(frozen=True)
class _Writer:
    """Properties of an export format: function that writes files, file name, and options."""

    # (motion, path of the file, value of `option`, origin if `is_on_globe`) -> number of parts,
    # their name, largest distance from the plan [m], largest deviation from the plan's heading
    # [rad]. The last is None if the autopilot chooses the heading.
    write: Callable[..., _Written]
    # Ending of the default file name.
    ending: str
    # Command-line option that sets the accuracy, ``--path-error`` or ``--rate``, and its default.
    option: str
    default: float
    # Whether positions are latitudes and longitudes.
    is_on_globe: bool = False

    @property
    def takes(self) -> tuple[str, ...]:
        """Names of the command-line options that the format accepts."""
        return ("--origin", self.option) if self.is_on_globe else (self.option,)


_DIGITS = "%.9g"  # nine digits distinguish all floating-point numbers of 32 bits
_MOST_ROTORPY_PIECES = 2000  # limits the written file to 64 000 coefficients
_CRAZYFLIE_MEMORY, _BYTES_OF_A_PIECE = 4096, 132
#: Number of pieces that fit into a Crazyflie's trajectory memory.
MOST_CRAZYFLIE_PIECES = _CRAZYFLIE_MEMORY // _BYTES_OF_A_PIECE
_SMALLEST_PATH_ERROR_M, _LARGEST_PATH_ERROR_M = 1e-6, 1000.0


def export_plan(
    plan: Plan | str | Path,
    to: Format | str,
    out: str | Path | None = None,
    *,
    origin: str | None = None,
    path_error_m: float | None = None,
    rate_hz: float | None = None,
    is_code_allowed: bool = False,
) -> Export:
    """Write a verified plan in the format of an autopilot, a swarm, a simulator or ROS 2.

    The plan is first verified again by simulation, because a file may wrongly claim that its plan
    is verified.

    Parameters
    ----------
    plan : Plan, str or Path
        A plan, the file of a saved plan, or the report folder of a run.
    to : Format or str
        Format of the export.
    out : str or Path, optional
        File to write, for ROS 2 a folder; by default named after the scenario, in the working
        folder. Only files of an earlier export are replaced. A device or a FIFO, such as
        ``/dev/stdout``, is possible.
    origin : str, optional
        Position of the plan's origin on earth, "LAT,LON,ALT" [deg, deg, m above the sea]; by
        default that of the mission. Missions of ground stations need an origin.
    path_error_m : float, optional
        For waypoints or polynomial pieces: largest permitted distance [m] from the plan. Each
        format has its own default.
    rate_hz : float, optional
        Setpoints or trajectory points per second, for PX4 and ROS 2; 50 by default.
    is_code_allowed : bool, optional
        Whether to run the Python model builder that the scenario names, if it names one.

    Returns
    -------
    Export
        The written file, with its deviation from the plan.

    Raises
    ------
    ScenarioError
        In each of these cases, without any output:

        - There is no verified plan, or the simulation does not confirm the plan.
        - The plan lacks a state that the format needs, or exceeds a limit of the format.
        - An option is invalid, missing, or not allowed for the format.
        - The output would replace the exported plan itself.
        - The library that writes the format is not installed.
    OutputError
        If the output cannot be written.

    Examples
    --------
    >>> made = export_plan(plan, "px4", "hop_px4.csv", rate_hz=20.0)
    >>> made.parts, made.what
    (81, 'setpoints')
    >>> made.position_error_m < 1e-3
    True
    """
    if to not in list(Format):
        raise ScenarioError(f"--to {to}: must be one of {', '.join(Format)}.")
    to = Format(to)
    writer = _WRITERS[to]
    given = {"--origin": origin, "--path-error": path_error_m, "--rate": rate_hz}
    _refuse_options(to, writer, [name for name, value in given.items() if value is not None])
    if path_error_m is not None and not (
        _SMALLEST_PATH_ERROR_M <= path_error_m <= _LARGEST_PATH_ERROR_M
    ):
        raise ScenarioError(
            f"--path-error = {path_error_m:g} m; must be from {_SMALLEST_PATH_ERROR_M:g} to "
            f"{_LARGEST_PATH_ERROR_M:g} m."
        )
    given_origin = None if origin is None else origin_of(origin)
    if isinstance(plan, Plan):
        motion = Motion.of(plan, is_code_allowed=is_code_allowed)
    else:
        motion = Motion.read(plan, is_code_allowed=is_code_allowed)
    path = Path(out) if out is not None else Path(f"{motion.name}{writer.ending}")
    if not isinstance(plan, Plan):
        _refuse_source(path, Path(plan))
    amount = path_error_m if rate_hz is None else rate_hz
    place = (_origin(motion, given_origin, to),) if writer.is_on_globe else ()
    parts, what, far, yaw = writer.write(
        motion, path, writer.default if amount is None else amount, *place
    )
    return Export(
        path=str(path),
        parts=parts,
        what=what,
        position_error_m=far,
        yaw_error_rad=yaw,
        is_paper_plan=motion.is_paper_plan,
    )


def _refuse_options(to: Format, writer: _Writer, given: list[str]) -> None:
    foreign = next((name for name in given if name not in writer.takes), None)
    if foreign is not None:
        takers = [name for name, other in _WRITERS.items() if foreign in other.takes]
        raise ScenarioError(
            f"{foreign} is not an option of {to}, only of {' and '.join(takers)}; leave it out."
        )


def _origin(motion: Motion, given: GeodeticOrigin | None, to: Format) -> GeodeticOrigin:
    """Return `given`, or the mission's origin on earth if `given` is None.

    Raises
    ------
    ScenarioError
        If neither the user nor the mission states the position.
    """
    origin = given or motion.mission.mission.origin
    if origin is None:
        raise ScenarioError(
            f"--to {to} needs --origin LAT,LON,ALT: the position of the plan's origin, such as "
            "47.3977,8.5456,488, where the mission has no mission.origin."
        )
    return origin


def _refuse_source(path: Path, source: Path) -> None:
    """Raise an error if the export to `path` would overwrite the exported plan itself.

    `source` is the file or report folder from which the plan was read.
    """
    read, written = final_folder(source), final_folder(path)
    if written == read or written in read.parents:
        raise ScenarioError(f"--out {path}: holds the plan that is exported; choose another --out.")


def _write_text(path: Path, text: str, mark: str = MARK) -> None:
    with output_file(path, mark) as aside:
        aside.write_text(text, encoding="utf-8", newline="\n")


def _write_mission(
    spelled: Callable[[dict[str, Any]], str],
    mark: str,
    motion: Motion,
    path: Path,
    error_m: float,
    origin: GeodeticOrigin,
) -> _Written:
    """Write a plan as a ground station's mission: waypoints joined by straight legs.

    The legs are at most `error_m` [m] from the plan. `spelled` converts a QGroundControl mission to
    text. An existing file is replaced only if it contains `mark`. For the result, see `_Writer`.
    """
    legs = thin(motion, error_m)
    _write_text(path, spelled(mission(legs, origin, motion, error_m)), mark)
    # None: the file leaves the heading between waypoints to the autopilot.
    return len(legs.times), "waypoints", _deviation(legs, motion), None


def _as_json(held: dict[str, Any]) -> str:
    return json.dumps(held, indent=1, allow_nan=False) + "\n"


def _deviation(legs: Legs, motion: Motion) -> float:
    """Return the largest distance [m], at equal times, between a plan and straight legs."""
    t = motion.samples(len(legs.times) / motion.duration * 100)
    return float(np.linalg.norm(legs.at(t) - motion.position(t), axis=1).max())


def _write_px4(motion: Motion, path: Path, rate_hz: float) -> _Written:
    stream = offboard(motion, rate_hz)
    text = stream.to_csv(index=False, float_format=_DIGITS, lineterminator="\n")
    _write_text(path, text, mark=",".join(stream.columns))
    return len(stream), "setpoints", *offboard_deviation(motion, stream)


def _write_ros2(motion: Motion, path: Path, rate_hz: float) -> _Written:
    with output_folder(path) as aside:
        bag = aside / (path.resolve().name or motion.name)
        points = write_bag(motion, rate_hz, bag)
        for file in bag.iterdir():
            file.rename(aside / file.name)
        bag.rmdir()
    return points, "points", sampled_deviation(motion, rate_hz), 0.0


def _write_crazyflie(motion: Motion, path: Path, error_m: float) -> _Written:
    durations, coefficients = fit_pieces(motion, error_m, MOST_CRAZYFLIE_PIECES)
    # The vehicle stores numbers of 32 bits, whose rounding the deviation includes.
    rows = np.column_stack([durations, coefficients.reshape(len(durations), -1)])
    rows = rows.astype(np.float32)
    # Readers ignore the names of columns. Other programs write no unit of the duration.
    names = ["duration_s"]
    names += [f"{axis}^{power}" for axis in ("x", "y", "z", "yaw") for power in range(8)]
    header = ",".join(names)
    lines = [header, *(",".join(_DIGITS % value for value in row) for row in rows)]
    _write_text(path, "".join(f"{line}\n" for line in lines), mark=header)
    held = rows.astype(float)
    found = piece_deviation(motion, held[:, 0], held[:, 1:].reshape(coefficients.shape))
    return len(rows), "pieces", *found


def _write_rotorpy(motion: Motion, path: Path, error_m: float) -> _Written:
    durations, coefficients = fit_pieces(motion, error_m, _MOST_ROTORPY_PIECES)
    _write_text(
        path,
        _ROTORPY_MODULE.format(
            title=_ROTORPY_TITLE,
            definition=inspect.getsource(PolynomialTrajectory),
            durations=durations.tolist(),
            coefficients=coefficients.tolist(),
        ),
        mark=_ROTORPY_TITLE,
    )
    return len(durations), "pieces", *piece_deviation(motion, durations, coefficients)


# The file is a program. It contains numbers of the plan, but none of its text, which could be code.
_ROTORPY_TITLE = "A trajectory for RotorPy: from NAME import trajectory. It needs NumPy."
_ROTORPY_MODULE = '''"""{title}"""

import numpy as np
from numpy.typing import ArrayLike


{definition}

trajectory = PolynomialTrajectory(
    {durations},
    {coefficients},
)
'''

_PATH_ERROR, _RATE = "--path-error", "--rate"
_WRITERS = {
    Format.QGROUNDCONTROL: _Writer(
        partial(_write_mission, _as_json, MARK), ".plan", _PATH_ERROR, 0.25, is_on_globe=True
    ),
    Format.MISSION_PLANNER: _Writer(
        partial(_write_mission, waypoint_file, WAYPOINT_FILE_HEADER),
        ".waypoints",
        _PATH_ERROR,
        0.25,
        is_on_globe=True,
    ),
    Format.PX4: _Writer(_write_px4, "_px4.csv", _RATE, 50.0),
    Format.ROS2: _Writer(_write_ros2, "_ros2", _RATE, 50.0),
    Format.CRAZYFLIE: _Writer(_write_crazyflie, "_crazyflie.csv", _PATH_ERROR, 0.001),
    Format.ROTORPY: _Writer(_write_rotorpy, "_rotorpy.py", _PATH_ERROR, 0.0001),
}
