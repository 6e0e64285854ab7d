"""The structural index of a DAE: how often its equations must be differentiated in time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import linear_sum_assignment

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.reading.writer import symbol_names

if TYPE_CHECKING:
    from pyomo_quad.collocation.reading.symbols import Declarations

# The highest that is solved as it stands: a control that an equation among states implies.
_HIGHEST = 2
_ABSENT = -1e6
_ORDERS = {2: "second", 3: "third", 4: "fourth", 5: "fifth"}


@dataclass(frozen=True, kw_only=True)
class StructuralIndex:
    """Index of the equations over time, and how often each that needs it is differentiated."""

    index: int
    differentiated: dict[str, int]


def structural_index(declared: Declarations) -> StructuralIndex:
    """Return the index, 0 of an ODE, by Pryce's signature matrix.

    Controls are unknowns as any other algebraic variable is, so that an equation among states that
    a control must keep counts as one that the model without choice would have.  Source: Pryce
    (2001), BIT Numerical Mathematics 41, 364-394.
    """
    equations = [e for e in declared.equations if e.is_equality]
    names = [s.name for s in (*declared.states, *declared.algebraics)]
    rates = {s.rate.name(): s.name for s in declared.states}
    orders = np.full((len(equations), len(names)), _ABSENT)
    for i, equation in enumerate(equations):
        held = symbol_names(equation.expression)
        for j, name in enumerate(names):
            orders[i, j] = 0.0 if name in held else _ABSENT
        for rate in held & rates.keys():
            orders[i, names.index(rates[rate])] = 1.0
    if not equations or len(equations) > len(names):
        return StructuralIndex(index=0, differentiated={})
    rows, columns = linear_sum_assignment(orders, maximize=True)
    if np.any(orders[rows, columns] == _ABSENT):
        return StructuralIndex(index=0, differentiated={})
    counts = np.zeros(len(equations))
    for _ in range(len(equations) + 1):
        highest = np.max(orders + counts[:, None], axis=0)
        counts[rows] = highest[columns] - orders[rows, columns]
    found = dict(zip((e.name for e in equations), counts.astype(int).tolist(), strict=True))
    # A variable of which no rate is determined is algebraic.
    is_dae = bool(np.any(highest == 0.0))
    return StructuralIndex(
        index=int(counts.max()) + is_dae,
        differentiated={name: count for name, count in found.items() if count},
    )


def refuse_high_index(declared: Declarations) -> None:
    """Refuse a DAE whose index is above 2.

    Raises
    ------
    TranscriptionError
        Naming the equation to be differentiated, and how often.
    """
    found = structural_index(declared)
    if found.index <= _HIGHEST:
        return
    name = max(found.differentiated, key=lambda key: found.differentiated[key])
    count = found.differentiated[name]
    raise TranscriptionError(
        f"{name}: makes the model a DAE of index {found.index}; at most {_HIGHEST} is supported. "
        f"Write its {_ORDERS.get(count, f'{count}th')} time derivative in its place, with the "
        "rates that the other equations give, and impose the equation itself and its lower "
        "derivatives as conditions at the start."
    )
