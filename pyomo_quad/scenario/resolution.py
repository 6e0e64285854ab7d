"""Default, library, files, scenario and overrides laid over each other, with their origin."""

import csv
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cache
from importlib import resources
from itertools import pairwise
from math import isfinite
from pathlib import Path
from pathlib import Path as FilePath
from types import MappingProxyType
from typing import Any, NoReturn

from pydantic import BaseModel, ValidationError

from pyomo_quad.scenario.air import in_the_air
from pyomo_quad.scenario.document import read_toml
from pyomo_quad.scenario.fields import initial_of, number_in_text
from pyomo_quad.scenario.messages import (
    ScenarioError,
    complaint,
    declared_place,
    field_paths,
    shown,
)
from pyomo_quad.scenario.mission import FREE
from pyomo_quad.scenario.tables import (
    FASTEST_ROTOR,
    derived_limits,
)
from pyomo_quad.scenario.tree import FieldPath, leaves, merge, set_value, spell
from pyomo_quad.scenario.vehicle import Vehicle
from pyomo_quad.scenario.wind import LARGEST_WIND, LATEST_TIME, STRONGEST_GUST

# Folder of the library -> table of the scenario that it fills.
LIBRARY_KINDS: Mapping[str, str] = MappingProxyType(
    {"vehicles": "vehicle", "batteries": "battery", "winds": "wind"}
)

_FIELDS, _VALUE, _SOURCE = "fields", "value", "source"
_LABELS = (_VALUE, _SOURCE)
_SECTIONS: Mapping[str, tuple[str, ...]] = {"vehicles": (_FIELDS, "limits")}
# What tells a file of one's own from a name of the library.
_SUFFIX = ".toml"


@dataclass(frozen=True, kw_only=True)
class LibraryEntry:
    """One named set of the library.

    Attributes
    ----------
    kind, name : str
        Folder and name.
    tables : mapping
        Scenario tables that the entry fills, ``{"vehicle": {...}, "limits": {...}}``.
    sources : mapping
        Dotted scenario field -> where its number comes from.
    """

    kind: str
    name: str
    tables: Mapping[str, Mapping[str, Any]]
    sources: Mapping[str, str]

    def values(self) -> dict[str, Any]:
        """Return the numbers that have a source.

        Returns
        -------
        dict
            Dotted scenario field -> value.
        """
        everything = {spell(path): value for path, value in leaves(self.tables)}
        return {field: everything[field] for field in self.sources}


def library_names(kind: str) -> tuple[str, ...]:
    """List the names of one kind.

    Parameters
    ----------
    kind : str
        ``vehicles``, ``batteries`` or ``winds``.

    Returns
    -------
    tuple of str
        Sorted names.

    Raises
    ------
    ScenarioError
        If there is no such kind.
    """
    if kind not in LIBRARY_KINDS:
        raise ScenarioError(
            f"library: unknown kind {kind!r}; must be one of {_listed(LIBRARY_KINDS)}."
        )
    folder = resources.files("pyomo_quad.scenario").joinpath("library", kind)
    return tuple(
        sorted(
            file.name.removesuffix(_SUFFIX)
            for file in folder.iterdir()
            if file.name.endswith(_SUFFIX)
        )
    )


@cache
def library_entry(kind: str, name: str) -> LibraryEntry:
    """Read one named set.

    Parameters
    ----------
    kind : str
        ``vehicles``, ``batteries`` or ``winds``.
    name : str
        A name that `library_names` lists.

    Returns
    -------
    LibraryEntry
        Its tables and the source of each number.

    Raises
    ------
    ScenarioError
        If there is no such kind or name.
    """
    names = library_names(kind)
    if name not in names:
        near = get_close_matches(name, names, n=1)
        hint = f"did you mean {near[0]}?" if near else "choose one of these."
        raise ScenarioError(
            f"library: no {LIBRARY_KINDS[kind]} named {name[:60]!r}; "
            f"there are {_listed(names)}; {hint}"
        )
    folder = resources.files("pyomo_quad.scenario").joinpath("library", kind)
    written = tomllib.loads(folder.joinpath(f"{name}{_SUFFIX}").read_text(encoding="utf-8"))
    return _entry(kind, name, written, {})


def _entry(
    kind: str, name: str, written: Mapping[str, Any], base: Mapping[str, Any]
) -> LibraryEntry:
    """Return the entry that sections of numbers, bare or with their sources, make over a base."""
    table = LIBRARY_KINDS[kind]
    tables: dict[str, Any] = set_value(base, (table, "use"), name)
    sources: dict[str, str] = {}
    for path, value in leaves(written):
        section, *field = path
        is_labelled = field[-1] in _LABELS
        place = field[:-1] if is_labelled else field
        target: FieldPath = (table if section == _FIELDS else section, *place)
        if is_labelled and field[-1] == _SOURCE:
            sources[spell(target)] = value
        else:
            tables = set_value(tables, target, value)
    return LibraryEntry(
        kind=kind, name=name, tables=MappingProxyType(tables), sources=MappingProxyType(sources)
    )


def read_entry(kind: str, name: str, folder: Path) -> LibraryEntry:
    """Read a set of one's own from a file written as the library's are.

    It has the sections `fields` and, for a vehicle, `limits`, with each number bare or as a table
    of `value` and `source`; `use` at its top names the set of the library that gives the rest.

    Raises
    ------
    ScenarioError
        If the file cannot be read, or has anything else in it.
    """
    written = dict(read_toml(folder / name))
    use = written.pop("use", None)
    if use is not None and not isinstance(use, str):
        raise ScenarioError(f"{name}: use = {shown(use)}; must be text in quotes.")
    sections = _SECTIONS.get(kind, (_FIELDS,))
    for section, content in written.items():
        if section not in sections:
            raise ScenarioError(
                f"{name}: unknown key {shown(section)[1:-1]}; a file of {kind} has "
                f"{' and '.join(f'[{known}]' for known in sections)}, and perhaps use."
            )
        if not isinstance(content, Mapping):
            raise ScenarioError(f"{name}: {section} = {shown(content)}; must be a table.")
    return _entry(kind, name, written, {} if use is None else library_entry(kind, use).tables)


def _listed(names: object) -> str:
    return ", ".join(str(name) for name in names)  # type: ignore[attr-defined]


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


# The named sets that a scenario gets when it names none.
DEFAULT_LIBRARY: Mapping[str, str] = {
    "vehicle": "dji_phantom_2",
    "battery": "phantom_2_pack",
    "wind": "calm",
}

# A forecast is a wind of its own, told to the same vehicle.
_INHERITED_BY_FORECAST = ("coupling", "acceleration_coefficient", "frequency_unit")


@dataclass(frozen=True, kw_only=True)
class Origin:
    """What a scenario was made from.

    Attributes
    ----------
    source : str
        Name of the scenario for messages, its file as a rule.
    folder : Path
        Where relative file names start.
    document : mapping
        The scenario's own tables, before library and overrides.
    assignments : mapping
        Path -> value, the overrides in order.
    label : str
        What the overrides are called in messages and provenance.
    """

    source: str
    folder: FilePath
    document: Mapping[str, Any]
    assignments: Mapping[FieldPath, Any] = field(default_factory=dict)
    label: str = "--set"
    is_resolved: bool = False


@dataclass(frozen=True, kw_only=True)
class Resolution:
    """Complete tables, ready to validate, and where each value came from."""

    tables: Mapping[str, Any]
    provenance: Mapping[str, str]


def resolve(origin: Origin, model: type[BaseModel]) -> Resolution:
    """Complete the tables of a scenario, whose fields the model declares, from the library.

    Raises
    ------
    ScenarioError
        If a library name, a wind file or the vehicle is not valid.
    """
    own = _with_assignments(origin, origin.document, indexed=False)
    provenance = {spell(path): "scenario" for path, _ in leaves(origin.document)}
    provenance |= {spell(path): origin.label for path in origin.assignments}
    tables = {} if origin.is_resolved else _initial_values(model)
    for kind, table in LIBRARY_KINDS.items():
        tables = _add_library(origin, tables, own, provenance, (table,), kind)
    if isinstance(own.get("wind"), Mapping) and isinstance(own["wind"].get("forecast"), Mapping):
        tables = _add_library(origin, tables, own, provenance, ("wind", "forecast"), "winds")
        tables = _inherit_coupling(tables, own)
    tables = _with_assignments(origin, merge(tables, own), indexed=True)
    tables = _add_wind_series(origin, tables, provenance)
    tables = in_the_air(tables, origin.document if origin.is_resolved else None, provenance)
    return Resolution(tables=_add_derived_limits(origin, tables, provenance), provenance=provenance)


def _initial_values(model: type[BaseModel]) -> dict[str, Any]:
    """Return what files mean that say nothing, where stored scenarios mean something else."""
    tables: dict[str, Any] = {}
    for path in field_paths(model):
        table, _ = declared_place(model, path[:-1])
        initial = initial_of(table, str(path[-1]))
        if initial is not None:
            tables = set_value(tables, path, initial)
    return tables


def whose(origin: Origin, provenance: Mapping[str, str], path: FieldPath) -> str:
    """Name the source that a message about a field starts with."""
    for length in range(len(path), 0, -1):
        said = provenance.get(spell(path[:length]))
        if said is not None:
            return origin.source if said == "scenario" else said
    under = f"{spell(path)}."
    if any(said == origin.label and name.startswith(under) for name, said in provenance.items()):
        return origin.label
    return origin.source


def _with_assignments(
    origin: Origin, tables: Mapping[str, Any], *, indexed: bool
) -> dict[str, Any]:
    changed = dict(tables)
    for path, value in origin.assignments.items():
        if any(isinstance(step, int) for step in path) is not indexed:
            continue
        try:
            changed = set_value(changed, path, value)
        except LookupError:
            raise ScenarioError(
                f"{origin.label}: {spell(path)} = {shown(value)}; there is no such place "
                f"to set; give the whole list or table, or see the fields with `pyomo-quad check`."
            ) from None
    return changed


def _add_library(
    origin: Origin,
    tables: dict[str, Any],
    own: Mapping[str, Any],
    provenance: dict[str, str],
    place: FieldPath,
    kind: str,
) -> dict[str, Any]:
    written: Any = own
    for step in place:
        written = written.get(step, {}) if isinstance(written, Mapping) else {}
    is_named = isinstance(written, Mapping) and "use" in written
    name = written["use"] if is_named else DEFAULT_LIBRARY[LIBRARY_KINDS[kind]]
    if not isinstance(name, str):
        return tables  # validation says it better
    use = (*place, "use")
    if origin.is_resolved and use not in origin.assignments:
        return tables
    is_file = name.endswith(_SUFFIX)
    try:
        entry = read_entry(kind, name, origin.folder) if is_file else library_entry(kind, name)
    except ScenarioError as error:
        reason = str(error).removeprefix("library: ")
        where = whose(origin, provenance, use)
        raise ScenarioError(f"{where}: {spell(use)} = {shown(name)}; {reason}") from None
    provenance.setdefault(spell(use), "default")
    table = LIBRARY_KINDS[kind]
    said = f"file {shown(name)[1:-1]}" if is_file else f"library {name}"
    for path, value in leaves(entry.tables):
        full = (*place, *path[1:]) if path[0] == table else path
        tables = set_value(tables, full, value)
        provenance.setdefault(spell(full), said)
    return tables


def _inherit_coupling(tables: dict[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    for name in _INHERITED_BY_FORECAST:
        if name in own["wind"]:
            tables = set_value(tables, ("wind", "forecast", name), own["wind"][name])
    return tables


def _add_wind_series(
    origin: Origin, tables: dict[str, Any], provenance: dict[str, str]
) -> dict[str, Any]:
    for place in (("wind",), ("wind", "forecast")):
        wind: Any = tables
        for step in place:
            wind = wind.get(step) if isinstance(wind, Mapping) else None
        if not isinstance(wind, Mapping) or not isinstance(wind.get("file"), str):
            continue
        where = f"{whose(origin, provenance, (*place, 'file'))}: {spell((*place, 'file'))}"
        mission = tables.get("mission")
        duration = mission.get("duration") if isinstance(mission, Mapping) else None
        if duration == FREE:
            _refuse(
                where + f" = {shown(wind['file'])}",
                "a measured wind needs a fixed mission.duration; give one in s, or another wind",
            )
        offset = wind.get("time_offset", 0.0)
        series = read_wind_file(origin.folder / wind["file"], where, duration, offset)
        tables = set_value(tables, (*place, "series"), series)
        for column in series:
            provenance[spell((*place, "series", column))] = f"file {shown(wind['file'])[1:-1]}"
    return tables


def _add_derived_limits(
    origin: Origin, tables: dict[str, Any], provenance: Mapping[str, str]
) -> dict[str, Any]:
    limits = tables.get("limits")
    if not isinstance(limits, Mapping):
        return tables
    speed = limits.get("rotor_speed_max")
    if (
        not isinstance(speed, int | float)
        or isinstance(speed, bool)
        or not 0 < speed <= FASTEST_ROTOR
    ):
        return tables
    try:
        vehicle = Vehicle.model_validate(tables["vehicle"])
    except ValidationError as error:
        path, line = complaint(error, Vehicle, ("vehicle",))
        raise ScenarioError(f"{whose(origin, provenance, path)}: {line}") from None
    return {**tables, "limits": {**derived_limits(vehicle, float(speed)), **limits}}
