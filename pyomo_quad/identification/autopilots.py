"""Readers of autopilot logs: PX4 (`.ulg`) and ArduPilot (`.BIN`).

The readers return a table with the columns of `identification.columns.COLUMNS`. Each row is the
average over a second of flight. Each log is one flight, named after its file. The autopilot's land
detector tells which rows are airborne; without it, all are. The phase of flight in every airborne
row is cruise, and the payload is 0. If the log has no barometer, the air density at sea level is
assumed.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pyomo_quad.arrays import FloatArray
from pyomo_quad.identification.columns import (
    AIR_VELOCITY,
    CRUISE,
    DENSITY,
    FLIGHT,
    PAYLOAD,
    PHASE,
    POWER,
    TIME,
    VELOCITY,
)
from pyomo_quad.scenario import ScenarioError
from pyomo_quad.scenario.wind import SEA_LEVEL_DENSITY

# Logs of the PX4 autopilot: unit of time, topics, and fields. Where a name has changed, the name in
# the newest firmware comes first.
Topic = dict[str, FloatArray]
_MICROSECONDS = 1e-6
_POSITION, _BATTERY, _LANDED = "vehicle_local_position", "battery_status", "vehicle_land_detected"
_WINDS = ("wind", "wind_estimate")
_AIR = "vehicle_air_data"
_TOPICS = (_POSITION, _BATTERY, _LANDED, *_WINDS, _AIR)
_CURRENTS, _VOLTAGES = ("current_a", "current_average_a"), ("voltage_v", "voltage_filtered_v")


@contextmanager
def _reader_errors(autopilot: str, package: str) -> Iterator[None]:
    """Turn errors of another package's log reader into a ScenarioError, and suppress its output."""
    try:
        with redirect_stdout(StringIO()):
            yield
    except ImportError:
        raise ScenarioError(
            f"{autopilot} logs need the package {package}; pip install 'pyomo_quad[logs]'."
        ) from None
    except (OSError, MemoryError):
        raise
    # Readers such as `pyulog` raise exceptions of many types for damaged logs.
    except Exception as error:
        raise ScenarioError(f"is not a complete {autopilot} log; copy it again.") from error


def _seconds_aloft(
    seconds: FloatArray,
    is_flying: NDArray[np.bool_],
    density: FloatArray,
    power: FloatArray,
    velocity: Sequence[FloatArray],
    wind: Sequence[FloatArray],
) -> pd.DataFrame:
    """Average the samples of a log over each second in flight.

    `velocity` has the components of the velocity over ground, toward north, east and up [m/s].
    `wind` has the components of the wind velocity, toward north and east [m/s]. The result lacks
    the flight's name.
    """
    air = (speed - blowing for speed, blowing in zip(velocity, wind, strict=False))
    frame = pd.DataFrame(
        {
            TIME: seconds,
            PHASE: np.where(is_flying, CRUISE, 0),
            PAYLOAD: 0.0,
            DENSITY: density,
            POWER: power,
            **dict(zip(VELOCITY, velocity, strict=True)),
            **dict(zip(AIR_VELOCITY, air, strict=True)),
        }
    )
    frame = frame[frame[PHASE] == CRUISE]
    return frame.groupby(np.floor(frame[TIME])).mean().reset_index(drop=True)


def read_ulog(file: Path) -> pd.DataFrame:
    """Read a PX4 log (`.ulg`) as averages over each second of flight.

    The wind is the autopilot's estimate. A ScenarioError is raised if the package `pyulog` is
    missing, or if the log is damaged or lacks the battery current or a required topic or field.
    """
    with _reader_errors("PX4", "pyulog"), file.open("rb") as stream:
        from pyulog import ULog  # noqa: PLC0415  an extra

        read = ULog(stream, message_name_filter_list=list(_TOPICS)).data_list
        topics = {d.name: d.data for d in read if d.multi_id == 0}
    battery = topics.get(_BATTERY, {})
    currents = [name for name in _CURRENTS if name in battery and np.any(battery[name] > 0.0)]
    if battery and not currents:
        raise ScenarioError("battery_status has no current; fit a power module and log it.")
    averaged = _by_second(topics, currents)
    averaged.insert(0, FLIGHT, file.stem)
    return averaged


def _field(topics: dict[str, Topic], topic: str, *names: str) -> FloatArray:
    """Return the values of a field (column) of a topic (table) in a PX4 log, in the order of time.

    `names` are the field's names in different versions of PX4. A missing field raises a
    ScenarioError.
    """
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
    density = np.full(len(times), SEA_LEVEL_DENSITY)
    if "rho" in topics.get(_AIR, {}):
        density = at_positions(_AIR, "rho")
    wind_speeds = (at_positions(wind, f"windspeed_{axis}") for axis in ("north", "east"))
    velocity = (north, east, -down)
    return _seconds_aloft(times - times[0], is_flying, density, power, velocity, tuple(wind_speeds))


# Logs of ArduPilot: types of messages, and numbers of the land detector's events.
_EKF, _EKF_WIND, _EKF_BATTERY, _BAROMETER, _EVENT = "XKF1", "XKF2", "BAT", "BARO", "EV"
_MESSAGES = (_EKF, _EKF_WIND, _EKF_BATTERY, _BAROMETER, _EVENT)
_LANDED_EVENT, _FLYING_EVENT = 18, 28
# Gas constant of dry air, J/(kg K), and 0 degrees Celsius in K.
_GAS, _FREEZING = 287.05, 273.15
_USUAL_CELSIUS = 15.0


def read_ardupilot(file: Path) -> pd.DataFrame:
    """Read an ArduPilot log (`.BIN`) as averages over each second of flight.

    Motion and wind are estimates of the first instance of the Kalman filter EKF3. Without an
    estimate of the wind, the air is taken to be calm. A missing `pymavlink` or a damaged or
    incomplete log raises a ScenarioError.
    """
    with file.open("rb"):
        pass  # raise the operating system's own error if the file cannot be read
    rows: dict[str, list[dict[str, float]]] = {name: [] for name in _MESSAGES}
    with _reader_errors("ArduPilot", "pymavlink"):
        from pymavlink.DFReader import DFReader_binary  # noqa: PLC0415  an extra

        log = DFReader_binary(str(file))
        with closing(log.filehandle), log.data_map:
            while (message := log.recv_match(type=list(_MESSAGES))) is not None:
                rows[message.get_type()].append(message.to_dict())
    if not any(rows.values()):
        raise ScenarioError("is not a complete ArduPilot log; copy it again.")
    averaged = _ardupilot_by_second({name: pd.DataFrame(held) for name, held in rows.items()})
    averaged.insert(0, FLIGHT, file.stem)
    return averaged


def _first_of(message: pd.DataFrame, name: str, *needed: str) -> pd.DataFrame:
    """Return the rows of an ArduPilot message table from the sensor or filter of lowest number.

    `name` is the type of the message, such as "BARO", for the error text. If a field of `needed` is
    missing, a ScenarioError is raised.
    """
    if not {"TimeUS", *needed} <= set(message):
        raise ScenarioError(
            f"has no message {name} with {', '.join(needed)}; log it (LOG_BITMASK)."
        )
    # Several sensors, or several instances of the filter, may write the same kind of message.
    for number in ("C", "I", "Inst"):
        if number in message:
            return message[message[number] == message[number].min()]
    return message


def _ardupilot_by_second(messages: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    motion = _first_of(messages[_EKF], _EKF, "VN", "VE", "VD")
    battery = _first_of(messages[_EKF_BATTERY], _EKF_BATTERY, "Volt", "Curr")
    times = motion["TimeUS"].to_numpy(float)

    def at(message: pd.DataFrame, values: pd.Series) -> FloatArray:
        return np.interp(times, message["TimeUS"].to_numpy(float), values.to_numpy(float))

    if not (battery["Curr"] > 0.0).any():
        raise ScenarioError("BAT has no current; fit a power module and log it.")
    wind_north = wind_east = np.zeros(len(times))
    if len(messages[_EKF_WIND]):
        wind = _first_of(messages[_EKF_WIND], _EKF_WIND, "VWN", "VWE")
        wind_north, wind_east = at(wind, wind["VWN"]), at(wind, wind["VWE"])
    density = np.full(len(times), SEA_LEVEL_DENSITY)
    if len(messages[_BAROMETER]):
        air = _first_of(messages[_BAROMETER], _BAROMETER, "Press")
        ground = air.get("GndTemp", pd.Series(_USUAL_CELSIUS, index=air.index))
        celsius = ground.where(ground != 0.0, _USUAL_CELSIUS)
        density = at(air, air["Press"] / (_GAS * (celsius + _FREEZING)))
    north, east, down = (motion[name].to_numpy(float) for name in ("VN", "VE", "VD"))
    return _seconds_aloft(
        (times - times[0]) * _MICROSECONDS,
        _is_flying(messages[_EVENT], times),
        density,
        at(battery, battery["Volt"] * battery["Curr"]),
        (north, east, -down),
        (wind_north, wind_east),
    )


def _is_flying(events: pd.DataFrame, times: FloatArray) -> NDArray[np.bool_]:
    """Return whether the vehicle flies at each time, by the land detector of an ArduPilot log.

    `times` are in microseconds. Without events of the land detector, the result is always True.
    """
    if not {"TimeUS", "Id"} <= set(events):
        return np.ones(len(times), dtype=bool)
    told = events[events["Id"].isin((_LANDED_EVENT, _FLYING_EVENT))]
    if told.empty:
        return np.ones(len(times), dtype=bool)
    latest = np.searchsorted(told["TimeUS"].to_numpy(float), times, side="right") - 1
    aloft = (told["Id"] == _FLYING_EVENT).to_numpy()
    # Before the first event, the state was the opposite of the state that this event reports.
    return np.where(latest >= 0, aloft[np.maximum(latest, 0)], ~aloft[0])
