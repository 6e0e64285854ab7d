"""The formats that a plan can go to, what each may be asked, and the file that each becomes."""

import inspect
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from pyomo_quad.exports import polynomials
from pyomo_quad.exports.motion import Motion
from pyomo_quad.exports.setpoints import (
    offboard,
    offboard_deviation,
    sampled_deviation,
    write_bag,
)
from pyomo_quad.exports.waypoints import Origin, mission, origin_of, thin
from pyomo_quad.flight import Plan
from pyomo_quad.report.folder import output_file, output_folder
from pyomo_quad.scenario import ScenarioError


class Format(StrEnum):
    """Who reads a plan."""

    QGROUNDCONTROL = "qgroundcontrol"
    PX4 = "px4"
    ROS2 = "ros2"
    CRAZYFLIE = "crazyflie"
    ROTORPY = "rotorpy"


@dataclass(frozen=True, kw_only=True)
class Export:
    """What was written.

    Attributes
    ----------
    path : str
        Of the file, or of the folder of a bag.
    parts : int
        How many waypoints, setpoints, points or pieces it holds.
    what : str
        The word for these.
    position_error_m : float
        The largest distance from the plan at any time, as its reader would fly it.
    yaw_error_rad : float or None
        The same of the heading; None where the format leaves it to the autopilot.
    """

    path: str
    parts: int
    what: str
    position_error_m: float
    yaw_error_rad: float | None

    def as_mapping(self) -> dict[str, Any]:
        """Return all of it by name."""
        return asdict(self)


_Written = tuple[int, str, float, float | None]


@dataclass(frozen=True, kw_only=True)
class _Options:
    origin: Origin | None
    path_error_m: float | None
    rate_hz: float | None


@dataclass(frozen=True, kw_only=True)
class _Writer:
    """How a format is written, the end of its name, and what it may be asked."""

    write: Callable[[Motion, Path, _Options], _Written]
    ending: str
    takes: tuple[str, ...]
    path_error_m: float = 0.0
    rate_hz: float = 0.0


_DIGITS = "%.9g"  # of a number of 32 bits, none is lost
_MOST_ROTORPY_PIECES = 2000
_CRAZYFLIE_MEMORY, _BYTES_OF_A_PIECE = 4096, 132
#: Pieces that a Crazyflie's memory of trajectories holds.
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
) -> Export:
    """Write a verified plan as an autopilot, a swarm, a simulator or ROS 2 reads it.

    Parameters
    ----------
    plan : Plan, str or Path
        A plan, the file of one, or the report folder of a run.
    to : Format or str
        Who reads it.
    out : str or Path, optional
        The file to write, for ROS 2 a folder; named after the scenario in the working folder by
        default.  A file that is there is replaced.
    origin : str, optional
        Where the plan's origin lies, "LAT,LON,ALT" in degrees and metres above the sea; for
        QGroundControl, which cannot do without.
    path_error_m : float, optional
        The largest distance from the plan that waypoints and pieces may have.
    rate_hz : float, optional
        Of setpoints.

    Returns
    -------
    Export
        What was written, and how far it is from the plan.

    Raises
    ------
    ScenarioError
        If there is no verified plan, it lacks what the format needs, an option is not allowed, a
        limit of the format is exceeded, or its library is not installed.  Nothing is written.
    OutputError
        If it cannot be written there.
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
    options = _Options(
        origin=None if origin is None else origin_of(origin),
        path_error_m=path_error_m or writer.path_error_m,
        rate_hz=writer.rate_hz if rate_hz is None else rate_hz,
    )
    motion = Motion.of(plan) if isinstance(plan, Plan) else Motion.read(plan)
    path = Path(out) if out is not None else Path(f"{motion.name}{writer.ending}")
    parts, what, place, yaw = writer.write(motion, path, options)
    return Export(path=str(path), parts=parts, what=what, position_error_m=place, yaw_error_rad=yaw)


def _refuse_options(to: Format, writer: _Writer, given: list[str]) -> None:
    foreign = next((name for name in given if name not in writer.takes), None)
    if foreign is not None:
        takers = [name for name, other in _WRITERS.items() if foreign in other.takes]
        raise ScenarioError(
            f"{foreign} means nothing to {to}; it is for {' and '.join(takers)}: leave it out."
        )
    if "--origin" in writer.takes and "--origin" not in given:
        raise ScenarioError(
            f"--to {to} needs --origin LAT,LON,ALT: where on the globe the plan's origin lies, "
            "such as 47.3977,8.5456,488."
        )


def _write_text(path: Path, text: str) -> None:
    with output_file(path) as aside:
        aside.write_text(text, encoding="utf-8", newline="\n")


def _write_qgroundcontrol(motion: Motion, path: Path, options: _Options) -> _Written:
    error_m, origin = options.path_error_m or 0.0, options.origin
    if origin is None:
        raise ScenarioError("--to qgroundcontrol needs --origin LAT,LON,ALT.")
    legs = thin(motion, error_m)
    text = json.dumps(mission(legs, origin, motion.name, error_m), indent=1, allow_nan=False)
    _write_text(path, f"{text}\n")
    t = motion.samples(len(legs.times) / motion.duration * 100)
    found = np.linalg.norm(legs.at(t) - motion.position(t), axis=1).max()
    return len(legs.times), "waypoints", float(found), None


def _write_px4(motion: Motion, path: Path, options: _Options) -> _Written:
    stream = offboard(motion, options.rate_hz or 0.0)
    _write_text(path, stream.to_csv(index=False, float_format=_DIGITS, lineterminator="\n"))
    return len(stream), "setpoints", *offboard_deviation(motion, stream)


def _write_ros2(motion: Motion, path: Path, options: _Options) -> _Written:
    rate_hz = options.rate_hz or 0.0
    with output_folder(path) as aside:
        bag = aside / (path.resolve().name or motion.name)
        points = write_bag(motion, rate_hz, bag)
        for file in bag.iterdir():
            file.rename(aside / file.name)
        bag.rmdir()
    return points, "points", sampled_deviation(motion, rate_hz), 0.0


def _write_crazyflie(motion: Motion, path: Path, options: _Options) -> _Written:
    durations, coefficients = polynomials.fit(
        motion, options.path_error_m or 0.0, MOST_CRAZYFLIE_PIECES
    )
    # The vehicle holds numbers of 32 bits: what is lost by them belongs to the error.
    rows = np.column_stack([durations, coefficients.reshape(len(durations), -1)])
    rows = rows.astype(np.float32)
    names = ["duration"]
    names += [f"{axis}^{power}" for axis in ("x", "y", "z", "yaw") for power in range(8)]
    lines = [",".join(names), *(",".join(_DIGITS % value for value in row) for row in rows)]
    _write_text(path, "".join(f"{line}\n" for line in lines))
    held = rows.astype(float)
    found = polynomials.deviation(motion, held[:, 0], held[:, 1:].reshape(coefficients.shape))
    return len(rows), "pieces", *found


def _write_rotorpy(motion: Motion, path: Path, options: _Options) -> _Written:
    durations, coefficients = polynomials.fit(
        motion, options.path_error_m or 0.0, _MOST_ROTORPY_PIECES
    )
    _write_text(
        path,
        _ROTORPY_MODULE.format(
            definition=inspect.getsource(polynomials.PolynomialTrajectory),
            durations=durations.tolist(),
            coefficients=coefficients.tolist(),
        ),
    )
    return len(durations), "pieces", *polynomials.deviation(motion, durations, coefficients)


# Of the plan there are only numbers in it, no text: it is a program.
_ROTORPY_MODULE = '''"""A trajectory for RotorPy: from NAME import trajectory. It needs NumPy."""

import numpy as np
from numpy.typing import ArrayLike


{definition}

trajectory = PolynomialTrajectory(
    {durations},
    {coefficients},
)
'''

_WRITERS = {
    Format.QGROUNDCONTROL: _Writer(
        write=_write_qgroundcontrol,
        ending=".plan",
        takes=("--origin", "--path-error"),
        path_error_m=0.25,
    ),
    Format.PX4: _Writer(write=_write_px4, ending="_px4.csv", takes=("--rate",), rate_hz=50.0),
    Format.ROS2: _Writer(write=_write_ros2, ending="_ros2", takes=("--rate",), rate_hz=50.0),
    Format.CRAZYFLIE: _Writer(
        write=_write_crazyflie,
        ending="_crazyflie.csv",
        takes=("--path-error",),
        path_error_m=0.001,
    ),
    Format.ROTORPY: _Writer(
        write=_write_rotorpy, ending="_rotorpy.py", takes=("--path-error",), path_error_m=0.0001
    ),
}
