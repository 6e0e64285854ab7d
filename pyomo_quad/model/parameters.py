"""How a number of the scenario becomes a mutable Pyomo parameter with its unit."""

from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pyomo.core import Block, Param

from pyomo_quad.scenario import Scenario

Value = float | Mapping[Any, float]


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One declared number: its name in the block, its unit, and where the scenario has it.

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
