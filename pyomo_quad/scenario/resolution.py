"""Default, library, files, scenario and overrides laid over each other, with their origin.

A TOML document comes from a stranger: data only, bounded in size and depth.
"""

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cache
from importlib import resources
from pathlib import Path
from pathlib import Path as FilePath
from types import MappingProxyType
from typing import Any

from pydantic import BaseModel, ValidationError

from pyomo_quad.scenario.fields import (
    FieldPath,
    depth,
    initial_of,
    leaves,
    merge,
    set_value,
    spell,
)
from pyomo_quad.scenario.footprints import in_convex_parts, read_footprints
from pyomo_quad.scenario.messages import (
    ScenarioError,
    complaint,
    declared_place,
    field_paths,
    printable,
    shown,
)
from pyomo_quad.scenario.mission import FREE
from pyomo_quad.scenario.spellings import in_plain_terms, origin_of_mission
from pyomo_quad.scenario.tables import (
    FASTEST_ROTOR,
    derived_limits,
)
from pyomo_quad.scenario.vehicle import Vehicle
from pyomo_quad.scenario.wind import in_the_air, with_coupling
from pyomo_quad.scenario.wind_field import read_wind_field
from pyomo_quad.scenario.wind_series import read_wind_file

LARGEST_FILE_BYTES = 1_000_000
DEEPEST_NESTING = 8
# More brackets open at once, or a key of more parts, is an attack on the parser: it takes them one
# inside the other, or all anew for each.
_MOST_OPEN = 64
_MOST_KEY_PARTS = 32
# Comments, texts closed or not, and the signs that nest or join; no part is read twice.
_SIGNS = re.compile(
    r"""#[^\n]*+|\"{3}(?:[^"\\]++|\\.|"(?!""))*+(?:\"{3})?|'{3}(?:[^']++|'(?!''))*+(?:'{3})?"""
    r"""|"(?:[^"\\\n]++|\\.)*+"?|'[^'\n]*+'?|[\[\]{}.,=\n]""",
    re.DOTALL,
)


def read_toml(file: Path) -> dict[str, Any]:
    """Read a TOML file that may come from a stranger.

    Raises
    ------
    ScenarioError
        If it is missing, too large, nested too deep or not TOML.
    """
    source = printable(str(file))
    try:
        with file.open("rb") as stream:
            content = stream.read(LARGEST_FILE_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ScenarioError(
            f"{source}: cannot be read ({reason}); give an existing TOML file."
        ) from None
    if len(content) > LARGEST_FILE_BYTES:
        raise ScenarioError(
            f"{source}: larger than {LARGEST_FILE_BYTES} bytes; a scenario is a short file."
        )
    try:
        tables = parse_toml(content.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        reason = printable(" ".join(str(error).split())[:120])
        raise ScenarioError(f"{source}: not valid TOML ({reason}); correct it.") from None
    refuse_deep(tables, source)
    return tables


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML, once it is known not to nest so deep that the parser would suffer."""
    open_brackets, key_parts = 0, 1
    for sign in _SIGNS.finditer(text):
        match sign[0]:
            case "[" | "{":
                open_brackets, key_parts = open_brackets + 1, 1
            case "]" | "}":
                open_brackets, key_parts = max(open_brackets - 1, 0), 1
            case ".":
                key_parts += 1
            case "," | "=" | "\n":
                key_parts = 1
        if open_brackets > _MOST_OPEN or key_parts > _MOST_KEY_PARTS:
            raise ValueError("nested too deep")
    return tomllib.loads(text)


def refuse_deep(tables: Mapping[str, Any], source: str) -> None:
    """Refuse tables that nest deeper than any scenario."""
    if depth(tables, DEEPEST_NESTING) > DEEPEST_NESTING:
        raise ScenarioError(
            f"{source}: nested deeper than {DEEPEST_NESTING} levels; a scenario is a shallow file."
        )


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
    base : LibraryEntry or None
        The set that gives what a file of one's own leaves out.
    """

    kind: str
    name: str
    tables: Mapping[str, Mapping[str, Any]]
    sources: Mapping[str, str]
    base: "LibraryEntry | None" = None

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
    return _entry(kind, name, written, None)


def _entry(
    kind: str, name: str, written: Mapping[str, Any], base: LibraryEntry | None
) -> LibraryEntry:
    """Return the entry of sections of numbers, bare or with their sources.

    Only its own tables are in it; those of the base lie below.
    """
    table = LIBRARY_KINDS[kind]
    tables: dict[str, Any] = {table: {"use": name}}
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
        kind=kind,
        name=name,
        tables=MappingProxyType(tables),
        sources=MappingProxyType(sources),
        base=base,
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
        _refuse_labels(name, content, (section,))
    return _entry(kind, name, written, None if use is None else library_entry(kind, use))


def _refuse_labels(name: str, table: Mapping[str, Any], place: FieldPath) -> None:
    """Refuse numbers with a label other than their value and source."""
    is_labelled = len(place) > 1 and not set(_LABELS).isdisjoint(table)
    for key, content in table.items():
        where = shown(spell((*place, key)))[1:-1]
        if (key in _LABELS) != is_labelled:
            raise ScenarioError(
                f"{name}: unknown key {where}; a number stands alone or as a table of its "
                f"{_VALUE} and {_SOURCE}."
            )
        if is_labelled and isinstance(content, Mapping):
            raise ScenarioError(f"{name}: {where} = a table; must be a number or a text.")
        if is_labelled and key == _SOURCE and not isinstance(content, str):
            raise ScenarioError(f"{name}: {where} = {shown(content)}; must be text in quotes.")
        if isinstance(content, Mapping):
            _refuse_labels(name, content, (*place, key))


def _listed(names: object) -> str:
    return ", ".join(str(name) for name in names)  # type: ignore[attr-defined]


# The named sets that a scenario gets when it names none.
DEFAULT_LIBRARY: Mapping[str, str] = {
    "vehicle": "dji_phantom_2",
    "battery": "phantom_2_pack",
    "wind": "calm",
}

# How long a free duration may be, and the shortest that there is, in s.
_LONGEST: FieldPath = ("mission", "duration_max")
_SHORTEST_S = 1e-3

# A forecast is a wind of its own, told to the same vehicle.
_INHERITED_BY_FORECAST = ("acceleration_coefficient", "frequency_unit")


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
        tables = _inherit_by_forecast(tables, own)
    tables = _with_assignments(origin, merge(tables, own), indexed=True)
    tables = in_plain_terms(tables, own, provenance, model, origin.source)
    tables = _add_footprints(origin, tables, provenance)
    tables = _add_wind_series(origin, tables, provenance)
    tables = _add_wind_fields(origin, tables, provenance)
    tables = in_the_air(tables, origin.document if origin.is_resolved else None, provenance)
    tables = with_coupling(tables, own, provenance)
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
    said: dict[str, str] = {}
    for layer in filter(None, (entry.base, entry)):
        is_own = is_file and layer is entry
        source = f"file {shown(name)[1:-1]}" if is_own else f"library {layer.name}"
        for path, value in leaves(layer.tables):
            full = (*place, *path[1:]) if path[0] == LIBRARY_KINDS[kind] else path
            tables = set_value(tables, full, value)
            said[spell(full)] = source
    provenance.update(said | provenance)
    return tables


def _inherit_by_forecast(tables: dict[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    for name in _INHERITED_BY_FORECAST:
        if name in own["wind"]:
            tables = set_value(tables, ("wind", "forecast", name), own["wind"][name])
    return tables


def _add_footprints(
    origin: Origin, tables: dict[str, Any], provenance: dict[str, str]
) -> dict[str, Any]:
    """Add the zones of a file, and divide polygons that are not convex."""
    airspace = tables.get("airspace")
    if not isinstance(airspace, Mapping):
        return tables
    zones = airspace.get("keep_out", ())
    file = airspace.get("file")
    if isinstance(file, str) and isinstance(zones, list | tuple) and not origin.is_resolved:
        where = f"{whose(origin, provenance, ('airspace', 'file'))}: airspace.file = {shown(file)}"
        read = read_footprints(
            origin.folder / file, where, origin_of_mission(tables, origin.source)
        )
        airspace = {**airspace, "keep_out": [*zones, *read]}
        provenance["airspace.keep_out"] = f"file {shown(file)[1:-1]}"
    return {**tables, "airspace": in_convex_parts(airspace)}


def _winds(tables: Mapping[str, Any], named: str) -> Iterator[tuple[FieldPath, Mapping[str, Any]]]:
    """Yield the wind and its forecast where they name a file in a field."""
    for place in (("wind",), ("wind", "forecast")):
        wind: Any = tables
        for step in place:
            wind = wind.get(step) if isinstance(wind, Mapping) else None
        if isinstance(wind, Mapping) and isinstance(wind.get(named), str):
            yield place, wind


def _add_wind_fields(
    origin: Origin, tables: dict[str, Any], provenance: dict[str, str]
) -> dict[str, Any]:
    for place, wind in _winds(tables, "field"):
        path = (*place, "field")
        where = f"{whose(origin, provenance, path)}: {spell(path)} = {shown(wind['field'])}"
        on_earth = origin_of_mission(tables, origin.source)
        grid = read_wind_field(origin.folder / wind["field"], where, on_earth)
        tables = set_value(tables, (*place, "grid"), grid)
        for part in grid:
            provenance[spell((*place, "grid", part))] = f"file {shown(wind['field'])[1:-1]}"
    return tables


def _add_wind_series(
    origin: Origin, tables: dict[str, Any], provenance: dict[str, str]
) -> dict[str, Any]:
    field, longest = _longest(tables)
    known: list[tuple[float, str]] = []
    for place, wind in _winds(tables, "file"):
        where = f"{whose(origin, provenance, (*place, 'file'))}: {spell((*place, 'file'))}"
        offset = wind.get("time_offset", 0.0)
        told = (spell(field), _SHORTEST_S if longest is None else longest)
        series = read_wind_file(origin.folder / wind["file"], where, told, offset)
        tables = set_value(tables, (*place, "series"), series)
        said = f"file {shown(wind['file'])[1:-1]}"
        for column in series:
            provenance[spell((*place, "series", column))] = said
        if series["times"] and isinstance(offset, int | float):
            known.append((series["times"][-1] - offset, said))
    if field == _LONGEST and longest is None and known:
        # A free duration ends where the wind is not known any more.
        last, provenance[spell(field)] = min(known)
        tables = set_value(tables, field, last)
    return tables


def _longest(tables: Mapping[str, Any]) -> tuple[FieldPath, object]:
    """Return the field that says how long a mission may take, and what it says."""
    mission = tables.get("mission")
    told = mission if isinstance(mission, Mapping) else {}
    field = _LONGEST if told.get("duration") == FREE else ("mission", "duration")
    return field, told.get(field[-1])


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
