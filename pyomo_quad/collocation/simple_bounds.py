"""Relations that hold a single variable linearly are bounds, not equations.

Boundary conditions such as ``x[0] == start`` and limits such as ``omega[j, t] <= limit``
leave the nonlinear program's rows this way; fixed variables leave its columns too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi

from pyomo_quad.collocation.declarations import PathEquation, PointCondition
from pyomo_quad.collocation.expressions import symbol_names

__all__ = ["SimpleBound", "split_simple_bounds"]


@dataclass(frozen=True, kw_only=True)
class SimpleBound:
    """Limits of one variable; `variable` is the symbol's name."""

    name: str
    variable: str
    lower: Any
    upper: Any


def split_simple_bounds(
    relations: tuple[Any, ...], variables: dict[str, Any], candidates: frozenset[str]
) -> tuple[tuple[Any, ...], tuple[SimpleBound, ...]]:
    """Separate relations that are bounds on one candidate variable from the others.

    Parameters
    ----------
    relations : tuple of PathEquation or PointCondition
    variables : dict
        Every variable symbol by name; anything else in a relation is a parameter.
    candidates : frozenset of str
        Variables that may be bounded in the nonlinear program.
    """
    others, bounds = [], []
    for relation in relations:
        bound = _as_simple_bound(relation, variables, candidates)
        if bound is None:
            others.append(relation)
        else:
            bounds.append(bound)
    return tuple(others), tuple(bounds)


def _as_simple_bound(
    relation: PathEquation | PointCondition, variables: dict[str, Any], candidates: frozenset[str]
) -> SimpleBound | None:
    if isinstance(relation, PathEquation) and relation.is_equality:
        return None
    held = symbol_names(relation.expression) & set(variables)
    if len(held) != 1 or not held <= candidates:
        return None
    (name,) = held
    symbol = variables[name]
    coefficient = casadi.simplify(casadi.jacobian(relation.expression, symbol))
    if not coefficient.is_constant() or coefficient.is_zero():
        return None
    offset = casadi.substitute(relation.expression, symbol, casadi.SX(0))
    sides = [(side - offset) / coefficient for side in (relation.lower, relation.upper)]
    lower, upper = sides if float(coefficient) > 0.0 else reversed(sides)
    return SimpleBound(name=relation.name, variable=name, lower=lower, upper=upper)
