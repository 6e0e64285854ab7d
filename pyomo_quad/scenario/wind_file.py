"""A measured wind from a CSV file: read as plain numbers, checked before anything is solved."""

import csv
from itertools import pairwise
from math import isfinite
from pathlib import Path
from typing import NoReturn

from pyomo_quad.scenario.complaint import shown
from pyomo_quad.scenario.errors import ScenarioError
from pyomo_quad.scenario.fields import number_in_text
from pyomo_quad.scenario.wind import LARGEST_WIND, LATEST_TIME, STRONGEST_GUST

__all__ = ["WIND_COLUMNS", "read_wind_file"]

WIND_COLUMNS = ("time_s", "wind_x_m_per_s", "wind_y_m_per_s")

_LARGEST_FILE_BYTES = 20_000_000
_MOST_ROWS = 200_000
_FEWEST_ROWS = 4  # a cubic spline needs as many
# A step this many times longer than the usual one is a gap that a spline would make up wind for.
_GAP_STEPS = 5.0


def read_wind_file(
    file: Path, where: str, duration: object, time_offset: object
) -> dict[str, tuple[float, ...]]:
    """Read and check a wind time series.

    Parameters
    ----------
    file : Path
        CSV file with the columns `WIND_COLUMNS`.
    where : str
        What a message starts with: the scenario and the field that names the file.
    duration, time_offset : object
        Duration of the mission and wind time at its start, s; anything that is not a number is
        left to the schema to refuse.

    Returns
    -------
    dict
        `times`, `wind_x` and `wind_y`, tuples of equal length.

    Raises
    ------
    ScenarioError
        If the file cannot be read, or has gaps, unsorted times, missing or non-finite numbers, or
        does not cover the mission.
    """
    place = f"{where} = {shown(file.name)}"
    rows = _read_rows(file, place)
    times, wind_x, wind_y = zip(*rows, strict=True)
    steps = [later - earlier for earlier, later in pairwise(times)]
    usual = sorted(steps)[len(steps) // 2]
    for row, step in enumerate(steps):
        if step <= 0:
            _refuse(place, f"time {times[row + 1]:g} s follows {times[row]:g} s; times must rise")
        if step > _GAP_STEPS * usual:
            _refuse(
                place,
                f"gap of {step:g} s after {times[row]:g} s; "
                f"steps must be <= {_GAP_STEPS * usual:g} s, fill the gap",
            )
    if isinstance(duration, int | float) and isinstance(time_offset, int | float):
        start, end = time_offset, time_offset + duration
        if times[0] > start or times[-1] < end:
            _refuse(
                place,
                f"wind from {times[0]:g} to {times[-1]:g} s does not cover the mission "
                f"from {start:g} to {end:g} s; give a longer file or shorten mission.duration",
            )
    return {"times": times, "wind_x": wind_x, "wind_y": wind_y}


def _read_rows(file: Path, place: str) -> list[tuple[float, float, float]]:
    try:
        if file.stat().st_size > _LARGEST_FILE_BYTES:
            _refuse(place, f"larger than {_LARGEST_FILE_BYTES} bytes; thin the series out")
        with file.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream)
            header = tuple(cell.strip() for cell in next(reader, []))
            if header != WIND_COLUMNS:
                _refuse(place, f"first line must be {','.join(WIND_COLUMNS)}")
            rows = [_read_row(cells, reader.line_num, place) for cells in reader if cells]
    except OSError as error:
        _refuse(place, f"cannot be read ({error.strerror or error}); give an existing CSV file")
    except (UnicodeDecodeError, csv.Error, ValueError) as error:
        if isinstance(error, ScenarioError):
            raise
        _refuse(place, "is not a CSV text file; save it as comma-separated UTF-8 text")
    if not _FEWEST_ROWS <= len(rows) <= _MOST_ROWS:
        _refuse(place, f"{len(rows)} rows; must have {_FEWEST_ROWS} to {_MOST_ROWS}")
    return rows


def _read_row(cells: list[str], line: int, place: str) -> tuple[float, float, float]:
    try:
        time, wind_x, wind_y = (number_in_text(cell) for cell in cells)
    except ValueError:
        _refuse(place, f"line {line} must hold {len(WIND_COLUMNS)} numbers")
    if not all(isfinite(number) for number in (time, wind_x, wind_y)):
        _refuse(place, f"line {line} holds a number that is not finite; remove or fill it")
    strongest = max(abs(wind_x), abs(wind_y))
    if strongest > LARGEST_WIND:
        _refuse(
            place,
            f"line {line} has a wind of {strongest:g} m/s; must be within {LARGEST_WIND:g} m/s: "
            f"{STRONGEST_GUST}",
        )
    if abs(time) > LATEST_TIME:
        _refuse(place, f"line {line} is of {time:g} s; times must be within {LATEST_TIME:g} s")
    return time, wind_x, wind_y


def _refuse(place: str, reason: str) -> NoReturn:
    raise ScenarioError(f"{place}; {reason}.") from None
