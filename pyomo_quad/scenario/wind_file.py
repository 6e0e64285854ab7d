"""Reading of measured winds over time, height or both from CSV files.

The argument `place` is a text that names the scenario field and the file. Error messages begin with
it.
"""

import csv
from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import isfinite
from pathlib import Path

from pyomo_quad.scenario.fields import number_in_text
from pyomo_quad.scenario.messages import ScenarioError, refuse, shown
from pyomo_quad.scenario.wind import LARGEST_WIND, LATEST_TIME, STRONGEST_GUST

WIND_COLUMNS = ("time_s", "wind_x_m_per_s", "wind_y_m_per_s")
HEIGHT_COLUMN = "height_m"
_TIME_COLUMN, *_WIND_SPEEDS = WIND_COLUMNS
# Possible columns before those of the wind: time, height, or both.
_KEYS = ((_TIME_COLUMN,), (HEIGHT_COLUMN,), (_TIME_COLUMN, HEIGHT_COLUMN))

_LARGEST_FILE_BYTES = 20_000_000
_MOST_ROWS = 200_000
_FEWEST_ROWS = 4  # a cubic spline needs as many
_FEWEST_HEIGHTS, _MOST_HEIGHTS = 2, 40
_FARTHEST_HEIGHT = 1e5
# A time step longer than the median step by this factor is refused as a gap, in which the spline
# would invent wind.
_GAP_STEPS = 5.0
_Rows = list[tuple[float, ...]]


def read_wind_file(
    file: Path, where: str, longest: tuple[str, object], time_offset: object
) -> dict[str, tuple[float, ...]]:
    """Read and check a measured wind over time, height or both, from a CSV file.

    The result holds the fields of `wind.series`.

    Parameters
    ----------
    file : Path
        The CSV file.
    where : str
        Beginning of error messages: the scenario field that names the file.
    longest : tuple of str and object
        Dotted path and value [s] of the field that limits the mission's duration. The wind must
        cover this duration.
    time_offset : object
        Time in the file [s] at which the mission starts.

    Raises
    ------
    ScenarioError
        If the wind is not valid.
    """
    place = f"{where} = {shown(file.name)}"
    keys, rows = _read_rows(file, place)
    columns = dict(zip((*keys, "wind_x", "wind_y"), zip(*rows, strict=True), strict=True))
    # The winds are listed time by time, and at each time by rising height.
    series = {"times": (), "wind_x": columns["wind_x"], "wind_y": columns["wind_y"]}
    if HEIGHT_COLUMN in keys:
        series["heights"] = _heights(columns, place)
    if _TIME_COLUMN not in keys:
        return series
    series["times"] = columns[_TIME_COLUMN][:: len(series.get("heights", "1"))]
    _check_times(series["times"], place)
    field, duration = longest
    # Both values are as written by the user, and are validated later.
    if isinstance(duration, int | float) and isinstance(time_offset, int | float):
        check_cover(series["times"], time_offset, field, duration, place)
    return series


def _heights(columns: Mapping[str, tuple[float, ...]], place: str) -> tuple[float, ...]:
    """Return the heights [m] of a measured wind, which must rise and be the same at every time.

    Raises a ScenarioError, which begins with `place`, if the heights are not valid.
    """
    every = columns[HEIGHT_COLUMN]
    times = columns.get(_TIME_COLUMN, (0.0,) * len(every))
    heights = every[: times.count(times[0])]
    for lower, higher in pairwise(heights):
        if higher <= lower:
            refuse(place, f"height {higher:g} m follows {lower:g} m; heights must rise")
    if not _FEWEST_HEIGHTS <= len(heights) <= _MOST_HEIGHTS:
        refuse(place, f"{len(heights)} heights; must have {_FEWEST_HEIGHTS} to {_MOST_HEIGHTS}")
    blocks = range(0, len(every), len(heights))
    for first in blocks:
        block = slice(first, first + len(heights))
        if every[block] != heights or len(set(times[block])) > 1:
            refuse(
                place,
                f"the rows of {times[first]:g} s are not for the heights of {times[0]:g} s; every "
                "time must have the same heights, in the same order",
            )
    return heights


def _check_times(times: tuple[float, ...], place: str) -> None:
    if len(times) < _FEWEST_ROWS:
        refuse(place, f"{len(times)} times; must have at least {_FEWEST_ROWS}")
    steps = [later - earlier for earlier, later in pairwise(times)]
    usual = sorted(steps)[len(steps) // 2]
    for row, step in enumerate(steps):
        if step <= 0:
            refuse(place, f"time {times[row + 1]:g} s follows {times[row]:g} s; times must rise")
        if step > _GAP_STEPS * usual:
            refuse(
                place,
                f"gap of {step:g} s after {times[row]:g} s; "
                f"steps must be <= {_GAP_STEPS * usual:g} s, fill the gap",
            )


def check_cover(
    times: Sequence[float], start: float, field: str, duration: float, place: str
) -> None:
    """Raise a ScenarioError if a measured wind does not cover the whole mission.

    The measurement has the `times`, and the mission lasts from the time `start` to `start` +
    `duration` [s]. The message begins with `place`. It names `field`, the path of the field that
    limits the duration.
    """
    if times[0] > start or times[-1] - start < duration:
        refuse(
            place,
            f"wind from {times[0]:g} to {times[-1]:g} s does not cover the mission from "
            f"{start:g} to {start + duration:g} s; give a longer file or shorten {field}",
        )


def _read_rows(file: Path, place: str) -> tuple[tuple[str, ...], _Rows]:
    """Read a CSV file of measured wind: names of its first columns, and all rows.

    The first columns are time, height or both; those of the wind follow. Raises a ScenarioError,
    which begins with `place`, if the file is not valid.
    """
    try:
        if file.stat().st_size > _LARGEST_FILE_BYTES:
            refuse(place, f"larger than {_LARGEST_FILE_BYTES} bytes; thin the series out")
        with file.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream)
            header = tuple(cell.strip() for cell in next(reader, []))
            keys = next((keys for keys in _KEYS if header == (*keys, *_WIND_SPEEDS)), None)
            if keys is None:
                refuse(
                    place,
                    f"first line must be {','.join(WIND_COLUMNS)}, with {HEIGHT_COLUMN} in place "
                    f"of or after {_TIME_COLUMN} for a wind by height",
                )
            rows = [_read_row(keys, cells, reader.line_num, place) for cells in reader if cells]
    except OSError as error:
        refuse(place, f"cannot be read ({error.strerror or error}); give an existing CSV file")
    except (UnicodeDecodeError, csv.Error, ValueError) as error:
        if isinstance(error, ScenarioError):
            raise
        refuse(place, "is not a CSV text file; save it as comma-separated UTF-8 text")
    fewest = _FEWEST_ROWS if _TIME_COLUMN in keys else _FEWEST_HEIGHTS
    if not fewest <= len(rows) <= _MOST_ROWS:
        refuse(place, f"{len(rows)} rows; must have {fewest} to {_MOST_ROWS}")
    return keys, rows


def _read_row(keys: tuple[str, ...], cells: list[str], line: int, place: str) -> tuple[float, ...]:
    count = len(keys) + len(_WIND_SPEEDS)
    try:
        numbers = tuple(number_in_text(cell) for cell in cells)
    except ValueError:
        numbers = ()
    if len(numbers) != count:
        refuse(place, f"line {line} must hold {count} numbers")
    if not all(isfinite(number) for number in numbers):
        refuse(place, f"line {line} holds a number that is not finite; remove or fill it")
    strongest = max(map(abs, numbers[-len(_WIND_SPEEDS) :]))
    if strongest > LARGEST_WIND:
        refuse(
            place,
            f"line {line} has a wind of {strongest:g} m/s; must be within {LARGEST_WIND:g} m/s: "
            f"{STRONGEST_GUST}",
        )
    for key, number in zip(keys, numbers, strict=False):
        most, unit = (LATEST_TIME, "s") if key == _TIME_COLUMN else (_FARTHEST_HEIGHT, "m")
        if abs(number) > most:
            kind = key.partition("_")[0]
            refuse(
                place,
                f"line {line} has a {kind} of {number:g} {unit}; {kind}s must be "
                f"within {most:g} {unit}",
            )
    return numbers
