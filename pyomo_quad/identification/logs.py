"""Logs of flights: the columns they need, and what is refused before anything is computed.

A log is a table, Parquet or CSV, of one row a second or so, or a PX4 `.ulg`.  Its columns are
those of `COLUMNS`; others are passed over.  World axes here are north, east and up.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from os import SEEK_END
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

from pyomo_quad.scenario import ScenarioError
from pyomo_quad.scenario.messages import printable
from pyomo_quad.scenario.wind import SEA_LEVEL_DENSITY


@dataclass(frozen=True, kw_only=True)
class Column:
    """One column of a log: its unit, what else it may be called, and what it holds."""

    unit: str
    meaning: str
    other_names: tuple[str, ...] = ()


FLIGHT, TIME, PHASE, POWER = "flight", "time_s", "phase", "power_W"
PAYLOAD, DENSITY = "payload_kg", "air_density_kg_m3"
VELOCITY = ("vel_north_m_s", "vel_east_m_s", "vel_up_m_s")
AIR_VELOCITY = ("air_vel_north_m_s", "air_vel_east_m_s")
VOLTAGE, CURRENT = "voltage_V", "current_A"
COLUMNS: Mapping[str, Column] = {
    FLIGHT: Column(unit="", meaning="number or name of the flight", other_names=("flight_id",)),
    TIME: Column(unit="s", meaning="time, rising within a flight", other_names=("time", "t")),
    PHASE: Column(unit="", meaning="1 take-off, 2 cruise, 3 landing; other rows are passed over"),
    PAYLOAD: Column(unit="kg", meaning="mass carried", other_names=("payload",)),
    DENSITY: Column(unit="kg/m^3", meaning="density of the air", other_names=("air_density",)),
    POWER: Column(
        unit="W",
        meaning="power drawn from the pack",
        other_names=("power", f"{VOLTAGE} with {CURRENT}"),
    ),
    VELOCITY[0]: Column(unit="m/s", meaning="velocity over ground", other_names=("vn_m_s",)),
    VELOCITY[1]: Column(unit="m/s", meaning="velocity over ground", other_names=("ve_m_s",)),
    VELOCITY[2]: Column(unit="m/s", meaning="climb", other_names=("vu_m_s",)),
    AIR_VELOCITY[0]: Column(
        unit="m/s", meaning="velocity through the air as read, times vehicle.anemometer_factor"
    ),
    AIR_VELOCITY[1]: Column(
        unit="m/s", meaning="velocity through the air as read, times vehicle.anemometer_factor"
    ),
}
FLYING = (1, 2, 3)
CRUISE = 2
_TEXTS = (FLIGHT,)
# A row this many times later than usual has lost the flight between.
_LONGEST_GAP = 10.0
# Sensors read a few watts below nought with all off.
_LEAST_POWER_W = -20.0
# Beyond these a number is in thousandths of its unit, whatever flies.
_MOST: Mapping[str, tuple[float, str]] = {
    VOLTAGE: (1e3, "millivolts"),
    CURRENT: (2e3, "milliamperes"),
}
_MOST_POWER_PER_KG, _LEAST_POWER_PER_KG = 5e3, 5.0
# s; rows farther apart than this tell no flight.
_LONGEST_STEP_S = 60.0
_LARGEST_FILE_BYTES, _MOST_ROWS = 500_000_000, 2_000_000
# Logs of the PX4 autopilot: unit, topics and fields, the newest firmware's name first.
Topic = dict[str, NDArray[np.float64]]
_MICROSECONDS = 1e-6
_POSITION, _BATTERY, _LANDED = "vehicle_local_position", "battery_status", "vehicle_land_detected"
_WINDS = ("wind", "wind_estimate")
_AIR = "vehicle_air_data"
_CURRENTS, _VOLTAGES = ("current_a", "current_average_a"), ("voltage_v", "voltage_filtered_v")


def read_logs(file: Path) -> pd.DataFrame:
    """Return the flying rows of all flights of a log, with the columns of `COLUMNS`.

    Raises
    ------
    ScenarioError
        If the file cannot be read, lacks a column, or holds what no flight can have done.
    """
    source = printable(str(file))
    whole = _renamed(_read(file, source))
    if POWER not in whole and {VOLTAGE, CURRENT} <= set(whole):
        whole[POWER] = whole[VOLTAGE] * whole[CURRENT]
    for name, column in COLUMNS.items():
        if name not in whole:
            others = "".join(f" or {other}" for other in column.other_names)
            unit = f", in {column.unit}" if column.unit else ""
            raise ScenarioError(
                f"{source}: has no column {name} ({column.meaning}{unit}); name it {name}{others}."
            )
    known = [*COLUMNS, *(name for name in (VOLTAGE, CURRENT) if name in whole)]
    frame = whole[known]
    for name in known:
        if name not in _TEXTS and not pd.api.types.is_numeric_dtype(frame[name]):
            raise ScenarioError(f"{source}: column {name} holds text; it must hold numbers.")
    frame = frame[frame[PHASE].isin(FLYING) | frame[PHASE].isna()].reset_index(drop=True)
    if frame.empty:
        raise ScenarioError(
            f"{source}: no row flies; {PHASE} must be 1, 2 or 3 for take-off, cruise and landing."
        )
    for complaint in _complaints(frame):
        raise ScenarioError(f"{source}: {complaint}")
    numbers = [name for name in known if name not in _TEXTS]
    return frame.astype(dict.fromkeys(numbers, float))


def together(logs: Sequence[tuple[Path, pd.DataFrame]]) -> pd.DataFrame:
    """Return the flights of several logs as one; where names meet, each log's own stands before.

    Raises
    ------
    ScenarioError
        If one flight is there twice.
    """
    held = [frame for _, frame in logs]
    flights = pd.concat([frame[FLIGHT].drop_duplicates() for frame in held])
    if not flights.is_unique or len({frame[FLIGHT].dtype for frame in held}) > 1:
        held = [
            frame.assign(**{FLIGHT: f"{file.stem} " + frame[FLIGHT].astype(str)})
            for file, frame in logs
        ]
    flights = pd.concat([frame[FLIGHT].drop_duplicates() for frame in held])
    if not flights.is_unique:
        twice = printable(str(flights[flights.duplicated()].iloc[0]))
        raise ScenarioError(
            f"logs: flight {twice} is there twice; give each log once, under a name of its own."
        )
    return pd.concat(held, ignore_index=True)


def _read(file: Path, source: str) -> pd.DataFrame:
    readers = {".parquet": _read_parquet, ".csv": _read_csv, ".ulg": _read_ulog}
    reader: Any = readers.get(file.suffix.lower())
    if reader is None:
        raise ScenarioError(f"{source}: is no log; give a .parquet, .csv or .ulg file.")
    if file.is_file() and file.stat().st_size > _LARGEST_FILE_BYTES:
        raise ScenarioError(f"{source}: larger than {_LARGEST_FILE_BYTES} bytes; split it.")
    try:
        return pd.DataFrame(reader(file))
    except ScenarioError as error:
        raise ScenarioError(f"{source}: {error}") from None
    except OSError as error:
        reason = error.strerror or "not whole"
        raise ScenarioError(f"{source}: cannot be read ({printable(reason)}).") from None
    except (ValueError, pa.ArrowException, pd.errors.ParserError, pd.errors.EmptyDataError):
        raise ScenarioError(f"{source}: is damaged or cut short; copy it anew.") from None


def _read_parquet(file: Path) -> pd.DataFrame:
    # A small file may unpack to more than any memory holds.
    with parquet.ParquetFile(file) as packed:
        if packed.metadata.num_rows > _MOST_ROWS:
            raise ScenarioError(
                f"has {packed.metadata.num_rows} rows; must be <= {_MOST_ROWS}: split it."
            )
    return pd.read_parquet(file)


def _read_csv(file: Path) -> pd.DataFrame:
    frame = pd.read_csv(file)
    with file.open("rb") as stream:
        stream.seek(-1, SEEK_END)
        if stream.read() not in b"\r\n":
            raise ScenarioError("ends within a line; copy it anew, or end its last line.")
    return frame


def _renamed(frame: pd.DataFrame) -> pd.DataFrame:
    names = {
        other: name
        for name, column in COLUMNS.items()
        for other in column.other_names
        if other in frame and name not in frame
    }
    return frame.rename(columns=names)


def _complaints(frame: pd.DataFrame) -> Iterator[str]:
    """Yield what is wrong with the rows, the plainest first."""
    for name in frame:
        missing = frame[name].isna() if name in _TEXTS else ~np.isfinite(frame[name])
        if missing.any():
            place = _place(frame, int(missing.to_numpy().argmax()))
            yield f"{name} is no number at {place}; drop the row or fill it."
    for flight, rows in frame.groupby(FLIGHT, sort=False):
        yield from _time_complaints(str(flight), rows[TIME].to_numpy(float))
    for name, (most, thousandths) in _MOST.items():
        if name in frame and frame[name].abs().median() > most:
            yield (
                f"{name} has a median of {frame[name].median():.4g}, which must be {thousandths}; "
                f"divide it by 1000."
            )
    usual = frame[POWER].groupby(frame[FLIGHT], sort=False).median()
    if usual.min() <= 0.0:
        yield (
            f"{POWER} of flight {usual.idxmin()} has a median of {usual.min():.4g} W; must be "
            "positive in flight: is the current logged?"
        )
    power = frame[POWER].to_numpy()
    lowest = int(np.argmin(power))
    if power[lowest] < _LEAST_POWER_W:
        yield (
            f"{POWER} = {power[lowest]:.4g} W at {_place(frame, lowest)}; must be positive in "
            "flight: turn the current's sign."
        )
    if frame[DENSITY].min() <= 0.0 or frame[PAYLOAD].min() < 0.0:
        yield f"{DENSITY} must be > 0 and {PAYLOAD} >= 0."


def _place(frame: pd.DataFrame, row: int) -> str:
    return f"{frame[TIME].iloc[row]:g} s of flight {frame[FLIGHT].iloc[row]}"


def _time_complaints(flight: str, times: np.ndarray) -> Iterator[str]:
    if times.size < 2:
        yield f"flight {flight} has a single row; drop it."
        return
    steps = np.diff(times)
    usual = float(np.median(steps))
    back, longest = int(np.argmin(steps)), int(np.argmax(steps))
    if steps[back] <= 0.0:
        yield (
            f"{TIME} of flight {flight} goes from {times[back]:g} to {times[back + 1]:g} s; "
            "times must rise within a flight."
        )
    elif usual > _LONGEST_STEP_S:
        yield (
            f"{TIME} of flight {flight} rises by {usual:.4g} s a row, which must be milliseconds; "
            "divide it by 1000."
        )
    elif steps[longest] > _LONGEST_GAP * usual:
        yield (
            f"flight {flight} has a gap of {steps[longest]:g} s after {times[longest]:g} s; steps "
            f"must be <= {_LONGEST_GAP * usual:g} s: fill the gap, or split the flight there."
        )


def refuse_wrong_units(frame: pd.DataFrame, mass_kg: float, source: str) -> None:
    """Refuse a power that is a thousand times what carries the vehicle's weight, or a thousandth.

    Raises
    ------
    ScenarioError
        If the median power is that of milliwatts or kilowatts.
    """
    median = float(frame[POWER].median())
    wrong = None
    if median > _MOST_POWER_PER_KG * mass_kg:
        wrong = "milliwatts; divide"
    elif median < _LEAST_POWER_PER_KG * mass_kg:
        wrong = "kilowatts; multiply"
    if wrong is not None:
        raise ScenarioError(
            f"{printable(source)}: {POWER} has a median of {median:.4g} W for {mass_kg:.4g} kg, "
            f"which must be {wrong} it by 1000."
        )


def _read_ulog(file: Path) -> pd.DataFrame:
    """Return a PX4 log averaged over seconds, in the columns of `COLUMNS`.

    It is one flight, named as its file.  All of it that is not on the ground counts as cruise; the
    payload is nought, and the air that of sea level where there is no barometer.  The wind is that
    of the autopilot's estimator.

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
    averaged = _by_second(topics, currents)
    averaged.insert(0, FLIGHT, file.stem)
    return averaged


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
    density = np.full(len(times), SEA_LEVEL_DENSITY)
    if "rho" in topics.get(_AIR, {}):
        density = at_positions(_AIR, "rho")
    frame = pd.DataFrame(
        {
            TIME: times - times[0],
            PHASE: np.where(is_flying, CRUISE, 0),
            PAYLOAD: 0.0,
            DENSITY: density,
            POWER: power,
            VELOCITY[0]: north,
            VELOCITY[1]: east,
            VELOCITY[2]: -down,
            AIR_VELOCITY[0]: north - at_positions(wind, "windspeed_north"),
            AIR_VELOCITY[1]: east - at_positions(wind, "windspeed_east"),
        }
    )
    frame = frame[frame[PHASE] == CRUISE]
    second = np.floor(frame[TIME])
    return frame.groupby(second).mean().reset_index(drop=True)
