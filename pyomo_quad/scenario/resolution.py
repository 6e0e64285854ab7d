"""Completion of a scenario's tables from initial values, library, data files and overrides.

A field has its initial value if a user's scenario file omits it, and its default if a stored
scenario omits it. Both are declared in the Pydantic class of the table (argument `model`). The
library is the package's collection of entries of three kinds: vehicles, batteries and winds.
Overrides are values that replace values of the scenario file.

The origin of each value is recorded, in words, by the dotted path of the field (`provenance`). TOML
documents may come from untrusted sources. They are therefore read as data only, and their size and
depth are limited.
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

from pyomo_quad.scenario.battery import Battery
from pyomo_quad.scenario.earth import GeodeticOrigin
from pyomo_quad.scenario.fields import (
    FieldPath,
    depth,
    initial_of,
    is_number,
    leaves,
    merge,
    set_value,
    spell,
    table_at,
    value_at,
)
from pyomo_quad.scenario.footprints import in_convex_parts, read_footprints
from pyomo_quad.scenario.messages import (
    ScenarioError,
    declared_place,
    field_paths,
    listed,
    printable,
    shown,
)
from pyomo_quad.scenario.mission import FREE
from pyomo_quad.scenario.spellings import in_plain_terms, origin_of_mission
from pyomo_quad.scenario.tables import (
    DERIVED_LIMITS,
    FASTEST_ROTOR,
    Limits,
    derived_limits,
)
from pyomo_quad.scenario.unit_keys import in_declared_units
from pyomo_quad.scenario.vehicle import Vehicle
from pyomo_quad.scenario.wind import Wind, with_air_density, with_coupling
from pyomo_quad.scenario.wind_file import check_cover, read_wind_file

LARGEST_FILE_BYTES = 1_000_000
DEEPEST_NESTING = 8
# Comments and strings of TOML, closed or not. Possessive quantifiers avoid backtracking, so that
# the search takes time in proportion to the length of the text.
_TEXT = re.compile(
    r"""#[^\n]*+|\"{3}(?:[^"\\]++|\\.|"(?!""))*+(?:\"{3})?|'{3}(?:[^']++|'(?!''))*+(?:'{3})?"""
    r"""|"(?:[^"\\\n]++|\\.)*+"?|'[^'\n]*+'?""",
    re.DOTALL,
)
# A key of more than 32 parts: `tomllib` takes time that grows with the square of their number.
_LONG_KEY = re.compile(r"(?<![^.,=\n\[\]{}])(?:[^.,=\n\[\]{}]*+\.){32}")


def read_toml(file: Path) -> dict[str, Any]:
    """Read the nested tables of a TOML file that may come from an untrusted source.

    Raises ScenarioError if the file cannot be read, is too large, is nested too deep or is not
    TOML.
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
    except ValueError as error:
        reason = printable(" ".join(str(error).split())[:120])
        raise ScenarioError(f"{source}: not valid TOML ({reason}); correct it.") from None
    refuse_deep(tables, source)
    return tables


def parse_toml(text: str) -> dict[str, Any]:
    """Parse the text of a TOML document, which may come from an untrusted source.

    Raises ValueError if the text is not TOML, is nested deeper than the parser can recurse, or has
    a key with more than 32 parts.
    """
    try:
        if _LONG_KEY.search(_TEXT.sub("''", text)) is None:
            return tomllib.loads(text)
    except RecursionError:
        pass
    raise ValueError("nested too deep")


def refuse_deep(tables: Mapping[str, Any], source: str) -> None:
    """Raise a ScenarioError if tables are nested deeper than any valid scenario.

    Parameters
    ----------
    tables : mapping
        Nested tables.
    source : str
        Beginning of the error message: the name of the file.
    """
    if depth(tables, DEEPEST_NESTING) > DEEPEST_NESTING:
        raise ScenarioError(
            f"{source}: nested deeper than {DEEPEST_NESTING} levels; a scenario is a shallow file."
        )


# Table of the scenario that each folder of the library fills.
LIBRARY_KINDS: Mapping[str, str] = MappingProxyType(
    {"vehicles": "vehicle", "batteries": "battery", "winds": "wind"}
)

#: Models of the scenario's tables that the library completes.
_TABLES: Mapping[str, type[BaseModel]] = MappingProxyType(
    {"vehicle": Vehicle, "limits": Limits, "battery": Battery, "wind": Wind}
)

_FIELDS, _VALUE, _SOURCE, _BATTERY = "fields", "value", "source", "battery"
_LABELS = (_VALUE, _SOURCE)
_VEHICLES = "vehicles"
_SECTIONS: Mapping[str, tuple[str, ...]] = {_VEHICLES: (_FIELDS, "limits")}
# Suffix that distinguishes a user's own file from a name of the library.
_SUFFIX = ".toml"


@dataclass(frozen=True, kw_only=True)
class LibraryEntry:
    """Vehicle, battery or wind of the library, or a user's own file with the same structure.

    Attributes
    ----------
    kind : str
        Kind of the entry: ``vehicles``, ``batteries`` or ``winds``.
    name : str
        Name in the library, or name of the user's file.
    tables : mapping
        Scenario tables that the entry fills, ``{"vehicle": {...}, "limits": {...}}``.
    sources : mapping
        Source (publication, data sheet) of each number, by dotted scenario field.
    base : LibraryEntry or None
        Library entry with the values that a user's own file leaves out, or None.
    battery : str
        Default battery pack of a vehicle: a name of the library, or a file in the folder of the
        vehicle file. Empty if no pack is known.
    """

    kind: str
    name: str
    tables: Mapping[str, Mapping[str, Any]]
    sources: Mapping[str, str]
    base: "LibraryEntry | None" = None
    battery: str = ""

    def values(self) -> dict[str, Any]:
        """Return the values for which the entry states a source, by dotted path of the field."""
        everything = {spell(path): value for path, value in leaves(self.tables)}
        return {field: everything[field] for field in self.sources}


def library_names(kind: str) -> tuple[str, ...]:
    """List the names of all vehicles, batteries or winds of the library.

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

    Examples
    --------
    >>> "dji_phantom_2" in library_names("vehicles")
    True
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
    """Read a vehicle, battery or wind of the library.

    Parameters
    ----------
    kind : str
        ``vehicles``, ``batteries`` or ``winds``.
    name : str
        A name that `library_names` lists.

    Returns
    -------
    LibraryEntry
        Tables of the scenario that the entry fills, and the source of each number.

    Raises
    ------
    ScenarioError
        If there is no such kind or name.

    Examples
    --------
    >>> entry = library_entry("vehicles", "dji_phantom_2")
    >>> entry.values()["vehicle.mass"]
    1.3
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
    """Make a library entry of a kind, such as ``vehicles``, from the content `written` of its file.

    In the file, a number stands alone or with its source. `base`, an attribute of the result, has
    the values that a user's file omits.
    """
    table = LIBRARY_KINDS[kind]
    tables: dict[str, Any] = {table: {"use": name}}
    sources: dict[str, str] = {}
    battery = written.get(_BATTERY, "" if base is None else base.battery)
    for path, value in leaves({key: held for key, held in written.items() if key != _BATTERY}):
        section, *field = path
        is_labelled = field[-1] in _LABELS
        place = field[:-1] if is_labelled else field
        target: FieldPath = (table if section == _FIELDS else section, *place)
        if is_labelled and field[-1] == _SOURCE:
            sources[spell(target)] = value
        else:
            tables = set_value(tables, target, value)
    for section, content in tables.items():
        rewritten = in_declared_units(content, _TABLES[section])
        if rewritten.complaints:
            raise ScenarioError(listed([f"{name}: {line}" for line in rewritten.complaints]))
        tables[section] = rewritten.tables
        for of_field, said in rewritten.spellings.items():
            key = said.partition(" = ")[0]
            source = sources.pop(f"{section}.{key}", f"given as {key}")
            sources[spell((section, *of_field))] = source
    return LibraryEntry(
        kind=kind,
        name=name,
        tables=MappingProxyType(tables),
        sources=MappingProxyType(sources),
        base=base,
        battery=battery,
    )


def read_entry(kind: str, name: str, folder: Path) -> LibraryEntry:
    """Read a user's own vehicle, battery or wind from a file like those of the library.

    `kind` is ``vehicles``, ``batteries`` or ``winds``. The file is `name` in `folder`. Its key
    `use` may name a library entry with the values that the file omits. This entry is the attribute
    `base` of the result. Raises ScenarioError if the file is not valid.
    """
    written = dict(read_toml(folder / name))
    lines = list(_shape_complaints(kind, written))
    if lines:
        raise ScenarioError(listed([f"{name}: {line}" for line in lines]))
    use = written.pop("use", None)
    return _entry(kind, name, written, None if use is None else library_entry(kind, use))


def _shape_complaints(kind: str, written: Mapping[str, Any]) -> Iterator[str]:
    """Yield an error message for each section or key that is not allowed in a library file."""
    sections = _SECTIONS.get(kind, (_FIELDS,))
    tops = ("use", _BATTERY) if kind == _VEHICLES else ("use",)
    for section, content in written.items():
        if section in tops:
            if not isinstance(content, str):
                yield f"{section} = {shown(content)}; must be text in quotes."
        elif section not in sections:
            yield (
                f"unknown key {shown(section)[1:-1]}; a file of {kind} has "
                f"{' and '.join(f'[{known}]' for known in sections)}, and perhaps "
                f"{' or '.join(tops)}."
            )
        elif not isinstance(content, Mapping):
            yield f"{section} = {shown(content)}; must be a table."
        else:
            yield from _label_complaints(content, (section,))


def _label_complaints(table: Mapping[str, Any], place: FieldPath) -> Iterator[str]:
    """Yield an error message for each number in a library file that has a wrong form.

    `place` is the path of `table`. A number is plain, or a table with the keys `value` and
    `source`.
    """
    is_labelled = len(place) > 1 and not set(_LABELS).isdisjoint(table)
    for key, content in table.items():
        where = shown(spell((*place, key)))[1:-1]
        if (key in _LABELS) != is_labelled:
            yield (
                f"unknown key {where}; a number stands alone or as a table of its {_VALUE} and "
                f"{_SOURCE}."
            )
        elif is_labelled and isinstance(content, Mapping):
            yield f"{where} = a table; must be a number or a text."
        elif is_labelled and key == _SOURCE and not isinstance(content, str):
            yield f"{where} = {shown(content)}; must be text in quotes."
        elif isinstance(content, Mapping):
            yield from _label_complaints(content, (*place, key))


def _listed(names: object) -> str:
    return ", ".join(str(name) for name in names)  # type: ignore[attr-defined]


# Library entries of a scenario that names none. The battery is that of the vehicle.
DEFAULT_LIBRARY: Mapping[str, str] = {"vehicle": "dji_phantom_2", "wind": "calm"}

# Field that limits a free duration; and duration [s] that a wind file must cover where no limit is
# given.
_LONGEST = ("mission", "duration_max")
_SHORTEST_S = 1e-3

# Fields that a forecast takes over from the actual wind unless it gives them: they belong to the
# vehicle, to the notation, or to the uncertainty of forecasts.
_INHERITED_BY_FORECAST = (
    "acceleration_coefficient",
    "frequency_unit",
    "speed_deviation",
    "direction_deviation",
)


@dataclass(frozen=True, kw_only=True)
class ScenarioSource:
    """Scenario as a user has written it: tables of the file, and overrides of fields.

    Attributes
    ----------
    source : str
        Name of the scenario in messages.
    folder : Path
        Folder to which relative file names refer.
    document : mapping
        The scenario's own tables, without overrides.
    assignments : mapping
        Value of each overridden field, by path, in the order of the overrides.
    label : str
        Name of the overrides, such as ``--set``.
    is_resolved : bool
        Whether the tables are complete, as in a stored scenario.
    """

    source: str
    folder: FilePath
    document: Mapping[str, Any]
    assignments: Mapping[FieldPath, Any] = field(default_factory=dict)
    label: str = "--set"
    is_resolved: bool = False


@dataclass(frozen=True, kw_only=True)
class Resolution:
    """Complete tables of a scenario, with the origin of each value and the errors found.

    Attributes
    ----------
    tables : mapping
        The tables, complete except for `unfilled`.
    provenance : mapping
        Origin of each value, by dotted path.
    complaints : tuple of str
        An error message for each value that could not be determined.
    unfilled : tuple
        Paths of tables and fields that an error may leave incomplete. The validation must not
        report them a second time.
    """

    tables: Mapping[str, Any]
    provenance: Mapping[str, str]
    complaints: tuple[str, ...] = ()
    unfilled: tuple[FieldPath, ...] = ()


def resolve(origin: ScenarioSource, model: type[BaseModel]) -> Resolution:
    """Complete the tables of a scenario from initial values, library, data files and overrides.

    `model` is the class of the scenario, which declares initial values. The validation later adds
    defaults. ScenarioError is raised for an invalid override, place on earth, wind direction (key
    `from`), or file of zones or terrain. Other errors are in `Resolution.complaints`.
    """
    # Overrides of list items need the complete lists, and are applied later.
    own = _with_assignments(origin, origin.document, indexed=False)
    provenance = {spell(path): "scenario" for path, _ in leaves(origin.document)}
    provenance |= {spell(path): origin.label for path in origin.assignments}
    # A stored scenario may lack a field because the field had its default, or because an old
    # version of the package did not have it. In both cases the field must get its default.
    tables = {} if origin.is_resolved else _initial_values(model)
    filled = _Filled(origin=origin, own=own, provenance=provenance, tables=tables)
    for kind, table in LIBRARY_KINDS.items():
        filled.add_library((table,), kind)
    if isinstance(value_at(own, "wind", "forecast"), Mapping):
        filled.add_library(("wind", "forecast"), "winds")
        for name in _INHERITED_BY_FORECAST:
            if name in own["wind"]:
                filled.put(("wind", "forecast", name), own["wind"][name])
    tables = _with_assignments(origin, merge(filled.tables, own), indexed=True)
    filled.tables = in_plain_terms(tables, own, provenance, origin.source)
    filled.add_footprints()
    filled.add_terrain()
    try:
        filled.add_wind_series()
        filled.add_wind_fields()
    except ScenarioError as error:
        filled.complain(str(error), ("wind",))
    tables = with_air_density(
        filled.tables, origin.document if origin.is_resolved else None, provenance
    )
    filled.tables = with_coupling(tables, own, provenance)
    filled.add_motor_constants()
    return Resolution(
        tables=_add_derived_limits(filled.tables),
        provenance=provenance,
        complaints=tuple(filled.complaints),
        # An error may leave the derived limits, such as `limits.thrust_max`, incomplete.
        unfilled=(*filled.unfilled, *(("limits", name) for name in DERIVED_LIMITS)),
    )


def _initial_values(model: type[BaseModel]) -> dict[str, Any]:
    """Return the initial values of a scenario's fields as nested tables.

    The class `model` of the scenario declares them. They are the values of fields that a user's
    scenario file omits.
    """
    tables: dict[str, Any] = {}
    for path in field_paths(model):
        table, _ = declared_place(model, path[:-1])
        initial = initial_of(table, str(path[-1]))
        if initial is not None:
            tables = set_value(tables, path, initial)
    return tables


def message_origin(origin: ScenarioSource, provenance: Mapping[str, str], path: FieldPath) -> str:
    """Return the origin of a field's value, as the beginning of a message.

    The result is the scenario's name in `origin`, a library entry, or an option such as ``--set``.
    The scenario's name replaces the recorded origin "scenario", or a missing one.
    """
    for length in range(len(path), 0, -1):
        said = provenance.get(spell(path[:length]))
        if said is not None:
            return origin.source if said == "scenario" else said
    under = f"{spell(path)}."
    if any(said == origin.label and name.startswith(under) for name, said in provenance.items()):
        return origin.label
    return origin.source


def _with_assignments(
    origin: ScenarioSource, tables: Mapping[str, Any], *, indexed: bool
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


@dataclass
class _Filled:
    """Tables of a scenario during their completion, with the errors found so far.

    `own` holds only the user's values. `unfilled` lists the paths of tables and fields that an
    error leaves incomplete.
    """

    origin: ScenarioSource
    own: Mapping[str, Any]
    provenance: dict[str, str]
    tables: dict[str, Any]
    complaints: list[str] = field(default_factory=list)
    unfilled: list[FieldPath] = field(default_factory=list)
    #: Name of the vehicle's battery pack, and name of the vehicle.
    _pack: tuple[str, str] | None = None

    def complain(self, line: str, *places: FieldPath) -> None:
        """Record an error message, and the paths of the tables that the error leaves incomplete.

        `line` is the message, and `places` are the paths.
        """
        self.complaints.append(line)
        self.unfilled.extend(places)

    def add_library(self, place: tuple[str, ...], kind: str) -> None:
        """Add the library entry or user's file that the key `use` of a table names.

        `place` is the path of the table, and `kind` that of the entry: ``vehicles``, ``batteries``
        or ``winds``. Without the key, a default entry is added. The default battery is the
        vehicle's own pack.
        """
        use = (*place, "use")
        # A stored scenario already contains the values of its library entries. An entry is added
        # only if an override sets the key.
        if self.origin.is_resolved and use not in self.origin.assignments:
            return
        written = table_at(self.own, *place)
        name = written["use"] if "use" in written else self._default(kind, place)
        left_open = (place, *((("battery",), ("limits",)) if kind == _VEHICLES else ()))
        if not isinstance(name, str):
            self.unfilled.extend(left_open)
            return  # validation gives a better message
        is_file = name.endswith(_SUFFIX)
        folder = self.origin.folder
        try:
            entry = read_entry(kind, name, folder) if is_file else library_entry(kind, name)
        except ScenarioError as error:
            where = message_origin(self.origin, self.provenance, use)
            said = f"{where}: {spell(use)} = {shown(name)}; "
            for line in str(error).splitlines():
                self.complain(said + line.removeprefix("library: "), *left_open)
            return
        if kind == _VEHICLES:
            self._pack = (_beside(name, entry.battery) if is_file else entry.battery), name
        self.provenance.setdefault(spell(use), "default")
        self._lay(entry, place, name if is_file else "")

    def _default(self, kind: str, place: FieldPath) -> str | None:
        table = LIBRARY_KINDS[kind]
        if table != _BATTERY:
            return DEFAULT_LIBRARY[table]
        pack, vehicle = self._pack or ("", "")
        if not pack and vehicle:
            self.complain(
                f"{self.origin.source}: battery.use is missing; the vehicle {shown(vehicle)} "
                f"names no pack of its own; give battery.use, one of "
                f"{_listed(library_names(kind))} or a file NAME.toml.",
                place,
            )
        return pack or None

    def _lay(self, entry: LibraryEntry, place: FieldPath, file: str) -> None:
        said: dict[str, str] = {}
        for layer in filter(None, (entry.base, entry)):
            is_own = bool(file) and layer is entry
            source = f"file {shown(file)[1:-1]}" if is_own else f"library {layer.name}"
            for path, value in leaves(layer.tables):
                full = (*place, *path[1:]) if path[0] == LIBRARY_KINDS[entry.kind] else path
                self.tables = set_value(self.tables, full, value)
                said[spell(full)] = source
        self.provenance.update(said | self.provenance)

    def put(self, path: FieldPath, value: object, said: str = "") -> None:
        """Set the value of a scenario field, and record the origin of the value.

        `said` is the origin in words. If it is empty, no origin is recorded.
        """
        self.tables = set_value(self.tables, path, value)
        if said:
            self.provenance[spell(path)] = said

    def put_read(self, place: FieldPath, parts: Mapping[str, Any], file: str) -> None:
        """Set a table whose fields were read from a data file, and record the file as origin."""
        self.put(place, parts)
        said = f"file {shown(file)[1:-1]}"
        self.provenance |= {spell((*place, part)): said for part in parts}

    def naming(self, path: FieldPath, file: str) -> str:
        """Return the beginning of messages about a data file: scenario, field and file name."""
        return (
            f"{message_origin(self.origin, self.provenance, path)}: {spell(path)} = {shown(file)}"
        )

    def on_earth(self) -> GeodeticOrigin | None:
        """Return the position of x = y = z = 0 on earth; None without `mission.origin`."""
        return origin_of_mission(self.tables, self.origin.source)

    def add_footprints(self) -> None:
        """Complete the keep-out zones of the table `airspace`.

        Zones of the GeoJSON file `airspace.file` are added. Then every zone with a concave polygon
        is divided into convex parts.
        """
        airspace = self.tables.get("airspace")
        if not isinstance(airspace, Mapping):
            return
        zones, file = airspace.get("keep_out", ()), airspace.get("file")
        is_listed = isinstance(zones, list | tuple)
        # A stored scenario already contains the zones of the file.
        if isinstance(file, str) and is_listed and not self.origin.is_resolved:
            where = self.naming(("airspace", "file"), file)
            read = read_footprints(self.origin.folder / file, where, self.on_earth())
            airspace = {**airspace, "keep_out": [*zones, *read]}
            self.provenance["airspace.keep_out"] = f"file {shown(file)[1:-1]}"
        self.put(("airspace",), in_convex_parts(airspace))

    def add_terrain(self) -> None:
        """Add the heights of the ground from the file that `airspace.terrain` names.

        A missing field `airspace.floor`, the least height above the ground, becomes
        `airspace.clearance`, the least distance from keep-out zones. If this field is missing, too,
        the floor is 0.
        """
        airspace, path = table_at(self.tables, "airspace"), ("airspace", "terrain")
        file, clearance = airspace.get("terrain"), airspace.get("clearance", 0.0)
        if not isinstance(file, str):
            return
        if "floor" not in airspace and is_number(clearance):
            said = "airspace.clearance over airspace.terrain"
            self.put(("airspace", "floor"), clearance, said)
        if self.is_recorded(("airspace",), "terrain", "ground"):
            return
        # This module imports pandas, which scenarios without terrain do not need.
        from pyomo_quad.scenario.terrain_file import read_terrain  # noqa: PLC0415

        where = self.naming(path, file)
        ground = read_terrain(self.origin.folder / file, where, self.on_earth())
        self.put_read(("airspace", "ground"), ground, file)

    def is_recorded(self, place: FieldPath, named: str, content: str) -> bool:
        """Return whether a stored scenario already contains the content of a data file.

        A recorded file is not read again. The field `named` has the file's name, and the field
        `content` has its content.
        """
        fields = (*place, named), (*place, content)
        # After an override of the file's name or content, the record no longer counts.
        is_overridden = any(
            path[: len(field)] == field[: len(path)]
            for path in self.origin.assignments
            for field in fields
        )
        has_content = value_at(self.tables, *place, content) is not None
        # The file itself may be impossible to find: its name is relative to the folder of the
        # original scenario file, which is not stored.
        return self.origin.is_resolved and has_content and not is_overridden

    def winds(self, named: str) -> Iterator[tuple[tuple[str, ...], Mapping[str, Any]]]:
        """Yield path and content of each of the tables `wind`, `wind.forecast` that names a file.

        The field `named` is ``file`` (measured wind over time) or ``field`` (wind over places).
        """
        for place in (("wind",), ("wind", "forecast")):
            wind = table_at(self.tables, *place)
            if isinstance(wind.get(named), str):
                yield place, wind

    def add_wind_fields(self) -> None:
        """Add the winds over places from the files named by `wind.field` and `wind.forecast.field`.

        The data become the tables `wind.grid` and `wind.forecast.grid`.
        """
        for place, wind in self.winds("field"):
            if self.is_recorded(place, "field", "grid"):
                continue
            # This module imports pandas, which scenarios without a wind field do not need.
            from pyomo_quad.scenario.wind_field import read_wind_field  # noqa: PLC0415

            where = self.naming((*place, "field"), wind["field"])
            grid = read_wind_field(self.origin.folder / wind["field"], where, self.on_earth())
            self.put_read((*place, "grid"), grid, wind["field"])

    def add_wind_series(self) -> None:
        """Add the measured winds from the files named by `wind.file` and `wind.forecast.file`.

        The data become the tables `wind.series` and `wind.forecast.series`. For a free duration
        without upper limit, `mission.duration_max` becomes the earliest end of a wind.
        """
        field, longest = _longest(self.tables)
        known: list[tuple[float, str]] = []
        for place, wind in self.winds("file"):
            path, offset = (*place, "file"), wind.get("time_offset", 0.0)
            where = f"{message_origin(self.origin, self.provenance, path)}: {spell(path)}"
            duration = _SHORTEST_S if longest is None else longest
            if self.is_recorded(place, "file", "series"):
                series, file = wind["series"], shown(FilePath(wind["file"]).name)
                # An override may have made the mission longer than the recorded wind.
                if series["times"] and is_number(duration) and is_number(offset):
                    check_cover(
                        series["times"], offset, spell(field), duration, f"{where} = {file}"
                    )
            else:
                told = (spell(field), duration)
                series = read_wind_file(self.origin.folder / wind["file"], where, told, offset)
                self.put_read((*place, "series"), series, wind["file"])
            if series["times"] and isinstance(offset, int | float):
                known.append((series["times"][-1] - offset, f"file {shown(wind['file'])[1:-1]}"))
        # A free duration without upper limit gets the earliest end of a wind as its limit. The ends
        # are counted from the start of the mission.
        if field == _LONGEST and longest is None and known:
            self.put(field, *min(known))

    def add_motor_constants(self) -> None:
        """Derive a missing torque or voltage constant of the motors from the other constant.

        The product of the two constants is 1 in SI units.
        """
        vehicle = table_at(self.tables, "vehicle")
        names = ("torque_constant", "voltage_constant")
        for missing, given in (names, names[::-1]):
            number = vehicle.get(given)
            if vehicle.get(missing) is None and is_number(number) and number > 0:
                self.put(("vehicle", missing), 1 / number, f"1 / {given}")


def _beside(file: str, pack: str) -> str:
    """Return a battery pack's library name, or the path of its file.

    `pack` is the name, or a path ending in ``.toml`` relative to the folder of the vehicle's file.
    `file`, the vehicle's file, and the result are relative to the scenario's folder.
    """
    return (FilePath(file).parent / pack).as_posix() if pack.endswith(_SUFFIX) else pack


def _longest(tables: Mapping[str, Any]) -> tuple[tuple[str, str], object]:
    """Return path and value [s] of the field that limits the mission's duration.

    The field is `mission.duration`, or `mission.duration_max` for a free duration. A missing value
    is None.
    """
    is_free = value_at(tables, "mission", "duration") == FREE
    field = _LONGEST if is_free else ("mission", "duration")
    return field, value_at(tables, *field)


def _add_derived_limits(tables: dict[str, Any]) -> dict[str, Any]:
    limits = table_at(tables, "limits")
    speed = limits.get("rotor_speed_max")
    if not is_number(speed) or not 0 < speed <= FASTEST_ROTOR:
        return tables
    try:
        vehicle = Vehicle.model_validate(tables.get("vehicle"))
    except ValidationError:
        return tables  # validation of the scenario gives a better message
    return {**tables, "limits": {**derived_limits(vehicle, float(speed)), **limits}}
