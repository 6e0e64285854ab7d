"""Building blocks of model equations: parameters from the scenario, and smooth maxima.

A number of a scenario becomes a mutable Pyomo parameter with its unit. To solve the model with
another number, only the value of the parameter is changed. The function max is replaced by smooth
functions, so that every equation is twice differentiable.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from pyomo.core import Block, Param, sqrt, tanh
from pyomo.core.base.component_namer import index_repr
from pyomo.core.base.units_container import units
from pyomo.core.expr import NumericExpression

from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.messages import declared_place

# Value of a parameter: a number, numbers by index, or None for a parameter that is left out.
Value = float | Mapping[Any, float] | None


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """Declaration of a parameter of a model block, whose value comes from a scenario.

    Attributes
    ----------
    name : str
        Name of the parameter in its block.
    units : Pyomo unit
        Unit of the parameter.
    value : callable
        Takes a scenario and returns a number, or a mapping from indices to numbers. If the result
        is None or empty, the parameter is not declared.
    doc : str
        Meaning of the parameter.
    """

    name: str
    units: object
    value: Callable[[Scenario], Value]
    doc: str


# Function that returns the parameters which a block has for a scenario.
Table = Callable[[Scenario], Iterable[Parameter]]
# Name of a block -> the parameters that it declares for a scenario.
_TABLES: dict[str, Table] = {}


def fields_of(table: str, *names: str, **renamed: str) -> tuple[Parameter, ...]:
    """Return the declaration of a model parameter for each of several scenario fields.

    `table` is the dotted path of the fields' table, empty for the scenario itself. A parameter has
    the unit, meaning and name of its field. With ``parameter_name="field_name"``, its name differs.
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
    """Return a decorator that registers a function under the name of a model block.

    The function takes a scenario and returns the declarations of the block's parameters.
    """

    def register(table: Table) -> Table:
        _TABLES[block_name] = table
        return table

    return register


def parameter_tables(scenario: Scenario) -> Iterator[tuple[str, tuple[Parameter, ...]]]:
    """Yield the name of each model block, and the declarations of its parameters.

    The declarations are the result of the block's function that has the decorator `parameters_in`.
    Blocks without such a function are left out.
    """
    for block_name, table in _TABLES.items():
        yield block_name, tuple(table(scenario))


def declare_parameters(b: Block, scenario: Scenario) -> None:
    """Add to the model block `b` its mutable Pyomo parameters, with their values in the scenario.

    The decorator `parameters_in` registers a function for the name of each block. The function for
    the name of `b` returns the declarations of the parameters, see `Parameter`.
    """
    add_parameters(b, _TABLES[b.name](scenario), scenario)


def add_parameters(b: Block, table: Iterable[Parameter], scenario: Scenario) -> None:
    """Add to the block `b` a mutable Pyomo parameter for each declaration in `table`.

    The parameters get their values from the scenario. A parameter without a value in the scenario
    is left out.
    """
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
    """Yield full name and value of every parameter in a table of declarations, for a scenario.

    `table` has the declarations of the block `block_name`. An example is
    ``("wind.x.amplitudes[1]", 0.1)`` for the block "wind.x", with the value in the declared unit. A
    parameter without a value in the scenario is left out.
    """
    for row in table:
        value = row.value(scenario)
        if isinstance(value, Mapping):
            for index, number in value.items():
                # Pyomo's own spelling: texts with a dot are quoted.
                yield f"{block_name}.{row.name}{index_repr(index)}", float(number)
        elif value is not None:
            yield f"{block_name}.{row.name}", float(value)


def positive_part(value: NumericExpression, width: NumericExpression) -> NumericExpression:
    """Return a smooth max(value, 0): convex, increasing, never negative.

    `width` is half the width over which the kink is rounded, in the unit of `value`. The result
    exceeds max(value, 0) by width/2 at value = 0, and by about width^2/(4 abs(value)) far away.
    """
    return (value + sqrt(value**2 + width**2)) / 2


def floored(
    value: NumericExpression, floor: NumericExpression, width: NumericExpression
) -> NumericExpression:
    """Return a smooth max(value, floor) that never falls below the floor.

    It exceeds the exact maximum by width/2 where `value` equals `floor`, and by less elsewhere. See
    `positive_part` for the width.
    """
    return floor + positive_part(value - floor, width)


#: Largest distance by which `saturated` falls below its floor, relative to its width.
DIP = 0.14


def saturated(
    value: NumericExpression, floor: NumericExpression, width: NumericExpression
) -> NumericExpression:
    """Return a smooth max(value, floor) that equals the value, up to rounding, far above the floor.

    At value = floor + 10 width, result and value differ by 2e-8 width. Near the floor, the result
    may fall below it by up to 0.14 width (`DIP`). Unlike a softplus, it does not overflow.
    """
    excess = value - floor
    return floor + excess * (1 + tanh(excess / width)) / 2
