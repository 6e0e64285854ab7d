"""Lay default, library, scenario and overrides over each other, and remember who said what."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Any

from pydantic import ValidationError

from pyomo_quad.scenario.complaint import complaint, shown
from pyomo_quad.scenario.errors import ScenarioError
from pyomo_quad.scenario.library import LIBRARY_KINDS, library_entry
from pyomo_quad.scenario.limits import FASTEST_ROTOR, derived_limits
from pyomo_quad.scenario.tree import Path, leaves, merge, set_value, spell
from pyomo_quad.scenario.vehicle import Vehicle
from pyomo_quad.scenario.wind_file import read_wind_file

__all__ = ["DEFAULT_LIBRARY", "Origin", "Resolution", "resolve"]

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
    assignments: Mapping[Path, Any] = field(default_factory=dict)
    label: str = "--set"


@dataclass(frozen=True, kw_only=True)
class Resolution:
    """Complete tables, ready to validate, and where each value came from."""

    tables: Mapping[str, Any]
    provenance: Mapping[str, str]


def resolve(origin: Origin) -> Resolution:
    """Complete a scenario's tables from the library.

    Parameters
    ----------
    origin : Origin
        The scenario as written.

    Returns
    -------
    Resolution
        Tables with every field that is not a plain default.

    Raises
    ------
    ScenarioError
        If a library name, a wind file or the vehicle is not valid.
    """
    own = _with_assignments(origin, origin.document, indexed=False)
    provenance = {spell(path): "scenario" for path, _ in leaves(origin.document)}
    provenance |= {spell(path): origin.label for path in origin.assignments}
    tables: dict[str, Any] = {}
    for kind, table in LIBRARY_KINDS.items():
        tables = _add_library(origin, tables, own, provenance, (table,), kind)
    if isinstance(own.get("wind"), Mapping) and isinstance(own["wind"].get("forecast"), Mapping):
        tables = _add_library(origin, tables, own, provenance, ("wind", "forecast"), "winds")
        tables = _inherit_coupling(tables, own)
    tables = _with_assignments(origin, merge(tables, own), indexed=True)
    tables = _add_wind_series(origin, tables, provenance)
    return Resolution(tables=_add_derived_limits(origin, tables, provenance), provenance=provenance)


def whose(origin: Origin, provenance: Mapping[str, str], path: Path) -> str:
    """Name the source that a message about a field starts with.

    Parameters
    ----------
    origin : Origin
        The scenario as written.
    provenance : mapping
        Dotted field -> where it came from.
    path : tuple
        The field.

    Returns
    -------
    str
        The scenario's file, ``--set`` or a library name.
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
    place: Path,
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
    try:
        entry = library_entry(kind, name)
    except ScenarioError as error:
        reason = str(error).removeprefix("library: ")
        where = whose(origin, provenance, use)
        raise ScenarioError(f"{where}: {spell(use)} = {shown(name)}; {reason}") from None
    provenance.setdefault(spell(use), "default")
    table = LIBRARY_KINDS[kind]
    for path, value in leaves(entry.tables):
        full = (*place, *path[1:]) if path[0] == table else path
        tables = set_value(tables, full, value)
        provenance.setdefault(spell(full), f"library {name}")
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
