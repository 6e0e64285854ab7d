"""Reading of flight logs, with checks for damaged or implausible values.

A log is a table (Parquet or CSV) with about one row per second, or the log file of an autopilot.
The mapping `identification.columns.COLUMNS` lists the columns that are read. World axes are north,
east and up.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from hashlib import sha256
from os import SEEK_END
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow import compute, parquet, types

from pyomo_quad.identification.autopilots import read_ardupilot, read_ulog
from pyomo_quad.identification.columns import (
    AIR_VELOCITY,
    COLUMNS,
    CURRENT,
    DENSITY,
    FLIGHT,
    FLYING,
    PAYLOAD,
    PHASE,
    POWER,
    TIME,
    VELOCITY,
    VOLTAGE,
    wanted_columns,
)
from pyomo_quad.scenario import ScenarioError
from pyomo_quad.scenario.fields import Sound
from pyomo_quad.scenario.messages import printable, shown
from pyomo_quad.scenario.vehicle import CARRIED

# Voltage and current, which a log without a column of power must have; power is their product.
_ELECTRIC = (VOLTAGE, CURRENT)
_TEXTS = (FLIGHT,)
# Longest gap between two rows of a flight, relative to the median time step.
_LONGEST_GAP = 10.0
# Least power of a row: sensors show a few watts below zero at zero power.
_LEAST_POWER_W = -20.0
# Greatest plausible median of a flight's values, and the unit that a greater median indicates.
_MOST: Mapping[str, tuple[float, str]] = {
    VOLTAGE: (1e3, "millivolts"),
    CURRENT: (2e3, "milliamperes"),
}
#: Bounds on a flight's median power, W/kg: a multirotor hovers at 100 to 300 W/kg.
MOST_POWER_PER_KG, LEAST_POWER_PER_KG = 5e3, 5.0
# Payload relative to the vehicle's own mass above which the column must be in grams.
_MOST_PAYLOAD = 20.0
# Plausible ranges, which the values of every row must keep.
_SPEED = Sound(-1e3, 1e3, "multirotors fly far below 1000 m/s")
_SOUND: Mapping[str, Sound] = {
    PAYLOAD: CARRIED,
    DENSITY: Sound(1e-2, 2.0, "air has about 1.5 at most, and 0.02 at 30 km"),
    POWER: Sound(-1e8, 1e8, "the largest helicopter has 2e7 W"),
    **dict.fromkeys((*VELOCITY, *AIR_VELOCITY), _SPEED),
}
# Longest step between rows, s: with a longer step the motion in between is unknown.
_LONGEST_STEP_S = 60.0
# Largest file and number of rows, whose data fit into the memory of a small computer.
_LARGEST_FILE_BYTES, _MOST_ROWS = 500_000_000, 2_000_000
_LONGEST_NAME, _LONGEST_HEADER_BYTES = 200, 1_000_000
_BATCH_ROWS = 65_536


def read_logs(file: Path) -> pd.DataFrame:
    """Read the rows in flight of a log: Parquet, CSV, PX4 `.ulg` or ArduPilot `.BIN`.

    The columns are those of `identification.columns.COLUMNS`, and voltage and current if logged. If
    the file cannot be read, lacks a column or holds impossible values, a ScenarioError is raised.
    """
    try:
        return _read_rows(file)
    except ScenarioError as error:
        raise ScenarioError(f"{error} Of a log {wanted_columns()}.") from None


def _read_rows(file: Path) -> pd.DataFrame:
    source = printable(str(file))
    whole = _read(file, source)
    known = [*COLUMNS, *(name for name in _ELECTRIC if name in whole)]
    for name in whole:
        if name not in _TEXTS and not pd.api.types.is_numeric_dtype(whole[name]):
            raise ScenarioError(f"{source}: column {name} holds text; it must hold numbers.")
    if POWER not in whole:
        whole[POWER] = whole[VOLTAGE] * whole[CURRENT]
    frame = whole[known]
    frame = frame[frame[PHASE].isin(FLYING) | frame[PHASE].isna()].reset_index(drop=True)
    if frame.empty:
        raise ScenarioError(
            f"{source}: no row flies; {PHASE} must be 1, 2 or 3 for take-off, cruise and landing."
        )
    for complaint in _complaints(frame):
        raise ScenarioError(f"{source}: {complaint}")
    numbers = [name for name in known if name not in _TEXTS]
    return frame.astype(dict.fromkeys(numbers, float))


def read_voltages(file: Path, flown: pd.DataFrame) -> pd.DataFrame:
    """Read battery voltage and current of a log's flights, including rows on the ground.

    `flown`, from `read_logs`, selects the flights. The columns are flight, time, voltage and
    current. If the file lacks one of these, the result is empty. An unreadable file raises a
    ScenarioError.
    """
    whole = _read(file, printable(str(file)))
    wanted = [FLIGHT, TIME, *_ELECTRIC]
    if not set(wanted) <= set(whole):
        return pd.DataFrame(columns=wanted)
    rows = whole.loc[whole[FLIGHT].isin(flown[FLIGHT]), wanted]
    return rows.dropna().reset_index(drop=True)


def together(logs: Sequence[tuple[Path, pd.DataFrame]]) -> pd.DataFrame:
    """Join the flights of several logs, given as file and rows, in one table.

    If two flights have the same name, or if the names differ in type, all flights are renamed: the
    name of the log's file is put before the flight's name. If two names are still equal, a
    ScenarioError is raised.
    """
    held = [frame for _, frame in logs]
    if not _names(held).is_unique or len({frame[FLIGHT].dtype for frame in held}) > 1:
        held = [
            frame.assign(**{FLIGHT: f"{file.stem} " + frame[FLIGHT].astype(str)})
            for file, frame in logs
        ]
    flights = _names(held)
    if not flights.is_unique:
        twice = printable(str(flights[flights.duplicated()].iloc[0]))
        raise ScenarioError(
            f"logs: flight {twice} is given twice; give each log once, under a name of its own."
        )
    return pd.concat(held, ignore_index=True)


def _names(frames: Sequence[pd.DataFrame]) -> "pd.Series[Any]":
    return pd.concat([frame[FLIGHT].drop_duplicates() for frame in frames])


def once_each(frame: pd.DataFrame) -> tuple[pd.DataFrame, dict[str, str]]:
    """Remove flights that are copies of other flights.

    The rows of a copy equal those of its original, with times counted from the first row. The
    second result maps the name of each copy to the name of its original.
    """
    numbers = frame[[name for name in COLUMNS if name not in _TEXTS]]
    first: dict[bytes, str] = {}
    copies: dict[str, str] = {}
    for flight, rows in frame.groupby(FLIGHT, sort=False).indices.items():
        own = numbers.iloc[rows].assign(**{TIME: lambda f: f[TIME] - f[TIME].iloc[0]})
        # In single precision, because a copy written as text may lack the last digits.
        key = sha256(own.to_numpy(dtype=np.float32).tobytes()).digest()
        if first.setdefault(key, str(flight)) != str(flight):
            copies[str(flight)] = first[key]
    if copies:
        is_copy = frame[FLIGHT].astype(str).isin(copies)
        frame = frame[~is_copy].reset_index(drop=True)
    return frame, copies


def _read(file: Path, source: str) -> pd.DataFrame:
    readers = {
        ".parquet": _read_parquet,
        ".csv": _read_csv,
        ".ulg": read_ulog,
        ".bin": read_ardupilot,
    }
    reader: Any = readers.get(file.suffix.lower())
    if reader is None:
        raise ScenarioError(
            f"{source}: is not a log; give a .parquet, .csv, PX4 .ulg or ArduPilot .BIN file."
        )
    if file.is_file() and file.stat().st_size > _LARGEST_FILE_BYTES:
        raise ScenarioError(f"{source}: larger than {_LARGEST_FILE_BYTES} bytes; split it.")
    try:
        return pd.DataFrame(reader(file))
    except ScenarioError as error:
        raise ScenarioError(f"{source}: {error}") from None
    except MemoryError:
        raise  # not as one of Arrow's errors below
    except OSError as error:
        reason = error.strerror or "not whole"
        raise ScenarioError(f"{source}: cannot be read ({printable(reason)}).") from None
    except (ValueError, pa.ArrowException, pd.errors.ParserError, pd.errors.EmptyDataError):
        raise ScenarioError(f"{source}: is damaged or cut short; copy it anew.") from None


def _wanted(names: Iterable[str]) -> dict[str, str]:
    """Map the names of the needed columns in a log to their names in `COLUMNS`.

    Voltage and current are included if the log has them; with both, the power may be missing. Any
    other missing column raises a ScenarioError.
    """
    held = set(names)
    found = {name: name for name in _ELECTRIC if name in held}
    for own, column in COLUMNS.items():
        called = next((name for name in (own, *column.other_names) if name in held), None)
        if called is not None:
            found[called] = own
        elif own != POWER or len(found.keys() & set(_ELECTRIC)) < len(_ELECTRIC):
            others = "".join(f" or {other}" for other in column.other_names)
            unit = f", in {column.unit}" if column.unit else ""
            raise ScenarioError(
                f"has no column {own} ({column.meaning}{unit}); name it {own}{others}."
            )
    return found


def _read_parquet(file: Path) -> pd.DataFrame:
    # Check sizes first: a small file may unpack to more than fits into memory, and its header may
    # state too small a number of rows.
    with parquet.ParquetFile(file) as packed:
        about = packed.metadata
        groups = [about.row_group(k) for k in range(about.num_row_groups)]
        _refuse_rows(max(about.num_rows, sum(group.num_rows for group in groups)))
        wanted = _wanted(packed.schema_arrow.names)
        kinds = {name: packed.schema_arrow.field(name).type for name in wanted}
        for name, kind in kinds.items():
            _refuse_kind(name, kind, is_text=wanted[name] in _TEXTS)
        unpacked = sum(
            group.column(k).total_uncompressed_size
            for group in groups
            for k in range(group.num_columns)
            if group.column(k).path_in_schema in wanted
        )
    if unpacked > _LARGEST_FILE_BYTES:
        raise ScenarioError(f"unpacks to more than {_LARGEST_FILE_BYTES} bytes; split it.")
    # With dictionary encoding, each distinct text takes memory once.
    texts = [name for name, kind in kinds.items() if not _is_number(kind)]
    with parquet.ParquetFile(file, read_dictionary=texts) as packed:
        batches, rows = [], 0
        for batch in packed.iter_batches(_BATCH_ROWS, columns=list(wanted)):
            rows += batch.num_rows
            _refuse_rows(rows)
            for name in texts:
                _refuse_long(compute.max(compute.binary_length(batch[name].dictionary)).as_py())
            batches.append(batch)
    if not batches:
        return pd.DataFrame({name: [] for name in wanted.values()})
    held = pa.Table.from_batches(batches)
    for name in texts:
        place = held.column_names.index(name)
        held = held.set_column(place, name, held[name].cast(pa.string()))
    return held.to_pandas().rename(columns=wanted)


def _is_number(kind: pa.DataType) -> bool:
    return bool(types.is_integer(kind) or types.is_floating(kind))


def _refuse_kind(name: str, kind: pa.DataType, *, is_text: bool) -> None:
    """Raise an error if a Parquet column holds neither numbers nor, if `is_text` is true, text."""
    held = kind.value_type if types.is_dictionary(kind) else kind
    is_string = types.is_string(held) or types.is_large_string(held)
    if _is_number(kind) or (is_text and is_string):
        return
    words = "text" if is_string else shown(str(kind))[1:-1]
    allowed = "numbers or texts" if is_text else "numbers"
    raise ScenarioError(f"column {name} holds {words}; it must hold {allowed}.")


def _refuse_rows(rows: int) -> None:
    if rows > _MOST_ROWS:
        raise ScenarioError(f"has {rows} rows; must be <= {_MOST_ROWS}: split it.")


def _refuse_long(length: int | None) -> None:
    if (length or 0) > _LONGEST_NAME:
        raise ScenarioError(
            f"{FLIGHT} has a name of {length} letters; must have at most {_LONGEST_NAME}."
        )


def _read_csv(file: Path) -> pd.DataFrame:
    with file.open("rb") as stream:
        if len(stream.readline(_LONGEST_HEADER_BYTES + 1)) > _LONGEST_HEADER_BYTES:
            raise ScenarioError(f"has a first line above {_LONGEST_HEADER_BYTES} bytes; split it.")
        if stream.seek(0, SEEK_END) > 0:
            stream.seek(-1, SEEK_END)
        if stream.read() not in b"\r\n":
            raise ScenarioError("ends within a line; copy it anew, or end its last line.")
    wanted = _wanted(map(str, pd.read_csv(file, nrows=0)))
    # `low_memory=False` reads each column in one chunk: pandas warns of chunks of different types.
    options: dict[str, Any] = {"usecols": list(wanted), "nrows": _MOST_ROWS + 1}
    frame = pd.read_csv(file, low_memory=False, **options).rename(columns=wanted)
    _refuse_rows(len(frame))
    if not pd.api.types.is_numeric_dtype(frame[FLIGHT]):
        _refuse_long(int(frame[FLIGHT].astype(str).str.len().max() if len(frame) else 0))
    return frame


def _complaints(frame: pd.DataFrame) -> Iterator[str]:
    """Yield an error message for each fault in the rows of all flights, missing numbers first."""
    for name in frame:
        missing = frame[name].isna() if name in _TEXTS else ~np.isfinite(frame[name])
        if missing.any():
            place = _place(frame, int(missing.to_numpy().argmax()))
            yield f"{name} is not a number at {place}; drop the row or fill it."
    for flight, rows in frame.groupby(FLIGHT, sort=False):
        yield from _time_complaints(str(flight), rows[TIME].to_numpy(float))
    yield from _unit_complaints(frame)
    usual = frame.groupby(FLIGHT, sort=False)[POWER].median()
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
    yield from _unsound(frame)


def _unit_complaints(frame: pd.DataFrame) -> Iterator[str]:
    """Yield a message for each flight whose voltage or current seems to be in mV or mA.

    `frame` has the rows of all flights.
    """
    for flight, rows in frame.groupby(FLIGHT, sort=False):
        for name, (most, thousandths) in _MOST.items():
            usual = float(rows[name].median()) if name in frame else 0.0
            # The median over the flight exceeds every plausible value in the expected unit.
            if abs(usual) > most:
                yield (
                    f"flight {flight}: {name} has a median of {usual:.4g}, which must be "
                    f"{thousandths}; divide it by 1000."
                )


def _unsound(frame: pd.DataFrame) -> Iterator[str]:
    """Yield an error message for each column of a log with a value outside its range in `_SOUND`.

    The message quotes the first such value of the column.
    """
    for name, sound in _SOUND.items():
        values = frame[name].to_numpy()
        is_beyond = (values < sound.low) | (values > sound.high)
        if is_beyond.any():
            row = int(is_beyond.argmax())
            yield (
                f"{name} = {values[row]:.4g} {COLUMNS[name].unit} at {_place(frame, row)}; must be "
                f"from {sound.low:g} to {sound.high:g}: {sound.because}."
            )


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
    """Raise a ScenarioError if the power seems to be in mW or kW instead of W, or the payload in g.

    The medians of each flight are tested. `mass_kg`, the mass without payload, sets the plausible
    ranges. `source` names the log in the message.
    """
    for flight, rows in frame.groupby(FLIGHT, sort=False):
        power, payload = float(rows[POWER].median()), float(rows[PAYLOAD].median())
        wrong = None
        if power > MOST_POWER_PER_KG * mass_kg:
            wrong = POWER, f"{power:.4g} W", "milliwatts; divide"
        elif power < LEAST_POWER_PER_KG * mass_kg:
            wrong = POWER, f"{power:.4g} W", "kilowatts; multiply"
        elif payload > _MOST_PAYLOAD * mass_kg:
            wrong = PAYLOAD, f"{payload:.4g} kg", "grams; divide"
        if wrong is not None:
            name, median, words = wrong
            raise ScenarioError(
                f"{printable(source)}: flight {printable(str(flight))}: {name} has a median of "
                f"{median} for a vehicle of {mass_kg:.4g} kg, which must be {words} it by 1000."
            )
