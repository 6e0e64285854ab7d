"""Building blocks of declared equations: parameters from the scenario, and a smooth `max`.

A number becomes a mutable Pyomo parameter with its unit. Replacements for `max` are smooth, so that
every equation is twice differentiable.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from pyomo.core import Block, Param, sqrt, tanh
from pyomo.core.base.units_container import units
from pyomo.core.expr import NumericExpression

from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.messages import declared_place

Value = float | Mapping[Any, float] | None


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """Declaration of a parameter: name in its block, unit, and function that reads a scenario.

    `value` takes the scenario and returns a number, or a mapping from indices to numbers. Without
    a value, that is with None or an empty mapping, the parameter is not declared.
    """

    name: str
    units: object
    value: Callable[[Scenario], Value]
    doc: str


Table = Callable[[Scenario], Iterable[Parameter]]
# Name of a block -> the parameters that it declares for a scenario.
_TABLES: dict[str, Table] = {}


def fields_of(table: str, *names: str, **renamed: str) -> tuple[Parameter, ...]:
    """Return a parameter for each of several scenario fields, with unit and meaning.

    Parameters
    ----------
    table : str
        Dotted path of the table that holds the fields, empty for the scenario itself.
    **renamed : str
        Name of a parameter that differs from that of its field, and the field.
    """
    rows = []
    for name, field in (*zip(names, names, strict=True), *renamed.items()):
        path = f"{table}.{field}".removeprefix(".")
        holder, unit = declared_place(Scenario, path.split("."))
        rows.append(
            Parameter(
                name=name,
                units=units.dimensionless if unit == "1" else getattr(units, unit),
                value=attrgetter(path),
                doc=holder.model_fields[field].description or name,
            )
        )
    return tuple(rows)


def parameters_in(block_name: str) -> Callable[[Table], Table]:
    """Return a decorator that registers a function as the parameter table of a block."""

    def register(table: Table) -> Table:
        _TABLES[block_name] = table
        return table

    return register


def parameter_tables(scenario: Scenario) -> Iterator[tuple[str, tuple[Parameter, ...]]]:
    """Yield the name and the parameters of each block with registered parameters."""
    for block_name, table in _TABLES.items():
        yield block_name, tuple(table(scenario))


def declare_parameters(b: Block, scenario: Scenario) -> None:
    """Add the registered parameters of a block to it, as mutable parameters."""
    add_parameters(b, _TABLES[b.name](scenario), scenario)


def add_parameters(b: Block, table: Iterable[Parameter], scenario: Scenario) -> None:
    """Add a mutable parameter for each row of a table that has a value."""
    for row in table:
        value = row.value(scenario)
        if value is None or value == {}:
            continue
        sets = (list(value),) if isinstance(value, Mapping) else ()
        component = Param(*sets, initialize=value, mutable=True, units=row.units, doc=row.doc)
        b.add_component(row.name, component)


def parameter_items(
    block_name: str, table: Iterable[Parameter], scenario: Scenario
) -> Iterator[tuple[str, float]]:
    """Yield the full name and the value of every parameter in a table.

    Parameters
    ----------
    block_name : str
        Name of the block that holds the parameters, as ``"wind.x"``.

    Yields
    ------
    tuple of str and float
        As ``("wind.x.amplitudes[1]", 0.1)``.
    """
    for row in table:
        value = row.value(scenario)
        if isinstance(value, Mapping):
            for index, number in value.items():
                place = ",".join(map(str, index)) if isinstance(index, tuple) else str(index)
                yield f"{block_name}.{row.name}[{place}]", float(number)
        elif value is not None:
            yield f"{block_name}.{row.name}", float(value)


def positive_part(value: NumericExpression, width: NumericExpression) -> NumericExpression:
    """Return a smooth max(value, 0): convex, increasing, never negative.

    Parameters
    ----------
    value : expression
        Any quantity.
    width : expression
        Half the distance over which the corner is rounded, same unit.

    Returns
    -------
    expression
        Exceeds the true maximum by width/2 at value = 0 and by width^2/(4 |value|) far off.
    """
    return (value + sqrt(value**2 + width**2)) / 2


def floored(
    value: NumericExpression, floor: NumericExpression, width: NumericExpression
) -> NumericExpression:
    """Return a smooth max(value, floor) that never falls below the floor.

    Parameters
    ----------
    value, floor : expression
        Quantities of the same unit.
    width : expression
        As for `positive_part`.

    Returns
    -------
    expression
        The rounded maximum.
    """
    return floor + positive_part(value - floor, width)


#: Share of the width by which `saturated` may fall below its floor.
DIP = 0.14


def saturated(
    value: NumericExpression, floor: NumericExpression, width: NumericExpression
) -> NumericExpression:
    """Return a smooth max(value, floor): ``value`` well above the floor, the floor far below it.

    Parameters
    ----------
    value, floor : expression
        Quantities of the same unit.
    width : expression
        Ten times this above the floor, value and result agree to 2e-8 of the width; near the
        floor the result may dip below it by `DIP` of the width.

    Returns
    -------
    expression
        Exact to rounding in the range where an equation is meant to be used, finite outside,
        and free of overflow, which a softplus is not.
    """
    excess = value - floor
    return floor + excess * (1 + tanh(excess / width)) / 2
