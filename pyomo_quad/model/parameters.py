"""Building blocks of declared equations: parameters from the scenario, and a smooth `max`.

A number becomes a mutable Pyomo parameter with its unit. Replacements for `max` are smooth, so that
every equation is twice differentiable.
"""

from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pyomo.core import Block, Param, sqrt, tanh
from pyomo.core.expr import NumericExpression

from pyomo_quad.scenario import Scenario

Value = float | Mapping[Any, float]


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One declared parameter: its name in the block, its unit, and how to read it from a scenario.

    `value` takes the scenario and returns a number, or a mapping when `index` is given.
    """

    name: str
    units: object
    value: Callable[[Scenario], Value]
    doc: str
    index: tuple[Hashable, ...] = ()


def declare_parameters(b: Block, table: tuple[Parameter, ...], scenario: Scenario) -> None:
    """Add one mutable parameter to a block for each row of a table."""
    for row in table:
        sets = (list(row.index),) if row.index else ()
        component = Param(
            *sets, initialize=row.value(scenario), mutable=True, units=row.units, doc=row.doc
        )
        b.add_component(row.name, component)


def parameter_items(
    block_name: str, table: tuple[Parameter, ...], scenario: Scenario
) -> Iterator[tuple[str, float]]:
    """Yield the full component name and the value of every number in a table.

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
                yield f"{block_name}.{row.name}[{place}]", number
        else:
            yield f"{block_name}.{row.name}", value


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
    """Return `value` while it is well above the floor, and the floor far below it.

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
