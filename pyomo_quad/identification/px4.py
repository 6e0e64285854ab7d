"""Logs of the PX4 autopilot, as a table of one row a second."""

from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pyomo_quad.scenario import ScenarioError

Topic = dict[str, NDArray[np.float64]]

_MICROSECONDS = 1e-6
# Where a log has no barometer: the standard atmosphere at sea level.
_STANDARD_DENSITY = 1.225
_POSITION, _BATTERY, _LANDED = "vehicle_local_position", "battery_status", "vehicle_land_detected"
_WINDS = ("wind", "wind_estimate")
_AIR = "vehicle_air_data"
# Fields by their names, the newest firmware's first.
_CURRENTS, _VOLTAGES = ("current_a", "current_average_a"), ("voltage_v", "voltage_filtered_v")


def read_ulog(file: Path) -> pd.DataFrame:
    """Return a PX4 log averaged over seconds, in the columns of `logs.COLUMNS`.

    All of it that is not on the ground counts as cruise; the payload is nought.  The wind is
    that of the autopilot's estimator.

    Raises
    ------
    ScenarioError
        If `pyulog` is missing, or the log lacks a topic or a field.
    """
    try:
        from pyulog import ULog  # noqa: PLC0415  an extra
    except ImportError:
        raise ScenarioError(
            "PX4 logs need the package pyulog; pip install 'pyomo_quad[logs]'."
        ) from None
    try:
        # The reader prints what it finds broken.
        with file.open("rb") as stream, redirect_stdout(StringIO()):
            topics = {d.name: d.data for d in ULog(stream).data_list if d.multi_id == 0}
    except OSError:
        raise
    except Exception as error:
        # A damaged log fails in as many ways as its reader has.
        raise ScenarioError("is no whole PX4 log; copy it anew.") from error
    battery = topics.get(_BATTERY, {})
    currents = [name for name in _CURRENTS if name in battery and np.any(battery[name] > 0.0)]
    if battery and not currents:
        raise ScenarioError("battery_status has no current; fit a power module and log it.")
    return _by_second(topics, currents)


def _field(topics: dict[str, Topic], topic: str, *names: str) -> NDArray[np.float64]:
    """Return the field of a topic that has the first of some names."""
    if topic not in topics:
        raise ScenarioError(f"has no topic {topic}; log it.")
    for name in names:
        if name in topics[topic]:
            return np.asarray(topics[topic][name], dtype=float)
    raise ScenarioError(f"{topic} has no {' or '.join(names)}; log it.")


def _by_second(topics: dict[str, Topic], currents: list[str]) -> pd.DataFrame:
    times = _field(topics, _POSITION, "timestamp") * _MICROSECONDS

    def at_positions(topic: str, *names: str) -> np.ndarray:
        values = _field(topics, topic, *names)
        return np.interp(times, topics[topic]["timestamp"] * _MICROSECONDS, values)

    power = at_positions(_BATTERY, *_VOLTAGES) * at_positions(_BATTERY, *currents)
    wind = next((name for name in _WINDS if name in topics), None)
    if wind is None:
        raise ScenarioError("has no topic wind; let the estimator of wind run (EKF2_DRAG_CTRL).")
    north, east, down = (_field(topics, _POSITION, name) for name in ("vx", "vy", "vz"))
    is_flying = np.ones(len(times), dtype=bool)
    if _LANDED in topics:
        is_flying = at_positions(_LANDED, "landed") < 0.5
    density = np.full(len(times), _STANDARD_DENSITY)
    if "rho" in topics.get(_AIR, {}):
        density = at_positions(_AIR, "rho")
    frame = pd.DataFrame(
        {
            "time_s": times - times[0],
            "phase": np.where(is_flying, 2, 0),
            "payload_kg": 0.0,
            "air_density_kg_m3": density,
            "power_W": power,
            "vel_north_m_s": north,
            "vel_east_m_s": east,
            "vel_up_m_s": -down,
            "air_vel_north_m_s": north - at_positions(wind, "windspeed_north"),
            "air_vel_east_m_s": east - at_positions(wind, "windspeed_east"),
        }
    )
    frame = frame[frame["phase"] == 2]
    second = np.floor(frame["time_s"])
    averaged = frame.groupby(second).mean().reset_index(drop=True)
    averaged.insert(0, "flight", 1)
    return averaged
