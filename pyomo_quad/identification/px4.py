"""Logs of the PX4 autopilot, as a table of one row a second."""

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


def read_ulog(file: Path) -> pd.DataFrame:
    """Return a PX4 log averaged over seconds, in the columns of `logs.COLUMNS`.

    All of it that is not on the ground counts as cruise; the payload is nought.  The wind is
    that of the autopilot's estimator.

    Raises
    ------
    ScenarioError
        If `pyulog` is missing, or the log lacks a topic.
    """
    try:
        from pyulog import ULog  # noqa: PLC0415  an extra
    except ImportError:
        raise ScenarioError(
            "PX4 logs need the package pyulog; pip install 'pyomo_quad[logs]'."
        ) from None
    try:
        with file.open("rb") as stream:
            topics = {d.name: d.data for d in ULog(stream).data_list if d.multi_id == 0}
    except OSError:
        raise
    except Exception as error:
        # A damaged log fails in as many ways as its reader has.
        raise ScenarioError("is no whole PX4 log; copy it anew.") from error
    battery = _topic(topics, _BATTERY)
    current = next((battery[n] for n in ("current_a", "current_average_a") if n in battery), None)
    if current is None or not np.any(np.asarray(current) > 0.0):
        raise ScenarioError("battery_status has no current; fit a power module and log it.")
    position = _topic(topics, _POSITION)
    wind = next((topics[name] for name in _WINDS if name in topics), None)
    if wind is None:
        raise ScenarioError("has no topic wind; let the estimator of wind run (EKF2_DRAG_CTRL).")
    return _by_second(position, battery, np.asarray(current), wind, topics)


def _topic(topics: dict[str, Topic], name: str) -> Topic:
    if name not in topics:
        raise ScenarioError(f"has no topic {name}; log it.")
    return topics[name]


def _by_second(
    position: Topic, battery: Topic, current: np.ndarray, wind: Topic, topics: dict[str, Topic]
) -> pd.DataFrame:
    times = position["timestamp"] * _MICROSECONDS

    def at_positions(topic: Topic, values: NDArray[np.float64]) -> np.ndarray:
        return np.interp(times, topic["timestamp"] * _MICROSECONDS, np.asarray(values, float))

    voltage = next(battery[n] for n in ("voltage_v", "voltage_filtered_v") if n in battery)
    north, east = (np.asarray(position[name], float) for name in ("vx", "vy"))
    landed, air = topics.get(_LANDED), topics.get(_AIR)
    is_flying = np.ones(len(times), dtype=bool)
    if landed is not None:
        is_flying = at_positions(landed, landed["landed"]) < 0.5
    density = np.full(len(times), _STANDARD_DENSITY)
    if air is not None and "rho" in air:
        density = at_positions(air, air["rho"])
    frame = pd.DataFrame(
        {
            "time_s": times - times[0],
            "phase": np.where(is_flying, 2, 0),
            "payload_kg": 0.0,
            "air_density_kg_m3": density,
            "power_W": at_positions(battery, np.asarray(voltage, float) * current),
            "vel_north_m_s": north,
            "vel_east_m_s": east,
            "vel_up_m_s": -np.asarray(position["vz"], float),
            "air_vel_north_m_s": north - at_positions(wind, wind["windspeed_north"]),
            "air_vel_east_m_s": east - at_positions(wind, wind["windspeed_east"]),
        }
    )
    frame = frame[frame["phase"] == 2]
    second = np.floor(frame["time_s"])
    averaged = frame.groupby(second).mean().reset_index(drop=True)
    averaged.insert(0, "flight", 1)
    return averaged
