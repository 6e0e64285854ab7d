"""The named vehicles, batteries and winds that come with the package, each number with a source."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from importlib import resources
from types import MappingProxyType
from typing import Any

from pyomo_quad.scenario.errors import ScenarioError
from pyomo_quad.scenario.tree import Path, leaves, set_value, spell

__all__ = ["LIBRARY_KINDS", "LibraryEntry", "library_entry", "library_names"]

# Folder of the library -> table of the scenario that it fills.
LIBRARY_KINDS: Mapping[str, str] = MappingProxyType(
    {"vehicles": "vehicle", "batteries": "battery", "winds": "wind"}
)


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
            file.name.removesuffix(".toml")
            for file in folder.iterdir()
            if file.name.endswith(".toml")
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
    written = tomllib.loads(folder.joinpath(f"{name}.toml").read_text(encoding="utf-8"))
    table = LIBRARY_KINDS[kind]
    tables: dict[str, Any] = {table: {"use": name}}
    sources: dict[str, str] = {}
    for path, value in leaves(written):
        section, *field, column = path
        target: Path = (table if section == "fields" else section, *field)
        if column == "value":
            tables = set_value(tables, target, value)
        else:
            sources[spell(target)] = value
    return LibraryEntry(
        kind=kind, name=name, tables=MappingProxyType(tables), sources=MappingProxyType(sources)
    )


def _listed(names: object) -> str:
    return ", ".join(str(name) for name in names)  # type: ignore[attr-defined]
