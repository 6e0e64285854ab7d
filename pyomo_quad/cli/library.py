"""`pyomo-quad library`: the named vehicles, batteries and winds, each number with its source."""

import json
from typing import Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from pyomo_quad.cli.consoles import result_console
from pyomo_quad.cli.exit_codes import ExitCode
from pyomo_quad.cli.options import AsJson
from pyomo_quad.scenario import (
    LIBRARY_KINDS,
    LibraryEntry,
    field_unit,
    library_entry,
    library_names,
)

__all__ = ["library"]


def library(
    kind: Annotated[
        str | None, typer.Argument(metavar="[KIND]", help="vehicles, batteries or winds.")
    ] = None,
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="One of the names.")] = None,
    *,
    as_json: AsJson = False,
) -> int:
    """List the library, or show one of its entries with the source of each number."""
    if kind is not None and name is not None:
        _show_entry(library_entry(kind, name), as_json=as_json)
        return ExitCode.VERIFIED
    kinds = LIBRARY_KINDS if kind is None else [kind]
    names = {kind: list(library_names(kind)) for kind in kinds}
    if as_json:
        print(json.dumps(names, indent=2))
    else:
        for kind_shown, listed in names.items():
            print(f"{kind_shown}: {', '.join(listed)}")
    return ExitCode.VERIFIED


def _show_entry(entry: LibraryEntry, *, as_json: bool) -> None:
    values = entry.values()
    if as_json:
        rows = {
            path: {"value": value, "unit": field_unit(path), "source": entry.sources[path]}
            for path, value in values.items()
        }
        print(json.dumps({"kind": entry.kind, "name": entry.name, "fields": rows}, indent=2))
        return
    table = Table(title=f"{entry.kind} / {entry.name}", title_justify="left", box=SIMPLE_HEAD)
    for column in ("field", "value", "unit", "source"):
        table.add_column(column, overflow="fold")
    for path, value in values.items():
        table.add_row(path, escape(str(value)), field_unit(path), escape(entry.sources[path]))
    result_console().print(table)
