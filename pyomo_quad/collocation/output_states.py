"""States that nothing depends on are found here and kept out of the nonlinear program.

A state such as a battery's charge, whose equation nothing else reads and which no limit
holds, changes no optimum.  It is solved for afterwards, on the same mesh.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

import casadi

from pyomo_quad.collocation.expressions import symbol_names

if TYPE_CHECKING:
    from pyomo_quad.collocation.declarations import Declarations, PathEquation, Slot

__all__ = ["set_outputs_aside"]


def set_outputs_aside(declared: Declarations) -> Declarations:
    """Return the declarations with output states and their equations moved aside.

    A state is an output when its symbol and rate appear in one equality only, it has no
    bounds, and it is held at the start and nowhere else.  Outputs that feed only outputs
    are found by repetition.
    """
    while True:
        found = _one_output(declared)
        if found is None:
            return declared
        slot, equation = found
        start = tuple(
            c for c in declared.conditions if _names_at(declared, slot) & symbol_names(c.expression)
        )
        declared = replace(
            declared,
            states=tuple(s for s in declared.states if s is not slot),
            equations=tuple(e for e in declared.equations if e is not equation),
            conditions=tuple(c for c in declared.conditions if c not in start),
            point_symbols=tuple(p for p in declared.point_symbols if p.slot != slot.name),
            outputs=(slot, *declared.outputs),
            output_equations=(equation, *declared.output_equations),
            output_starts=(*start, *declared.output_starts),
        )


def _names_at(declared: Declarations, slot: Slot) -> frozenset[str]:
    return frozenset(p.symbol.name() for p in declared.point_symbols if p.slot == slot.name)


def _one_output(declared: Declarations) -> tuple[Slot, PathEquation] | None:
    uses = Counter[str]()
    for equation in declared.equations:
        uses.update(
            symbol_names(casadi.vertcat(equation.expression, equation.lower, equation.upper))
        )
    elsewhere = symbol_names(
        casadi.vertcat(declared.objective, *[i.integrand for i in declared.integrals])
    )
    for slot in declared.states:
        if uses[slot.rate.name()] != 1 or slot.name in elsewhere or slot.rate.name() in elsewhere:
            continue
        equation = next(
            e for e in declared.equations if slot.rate.name() in symbol_names(e.expression)
        )
        inside = slot.name in symbol_names(equation.expression)
        only_here = uses[slot.name] == int(inside)
        rates = [s.rate.name() for s in declared.states]
        one_rate = len(symbol_names(equation.expression) & set(rates)) == 1
        if (
            only_here
            and one_rate
            and equation.is_equality
            and _is_free(slot)
            and _held_at_start_only(declared, slot)
        ):
            return slot, equation
    return None


def _is_free(slot: Slot) -> bool:
    return bool(casadi.is_equal(slot.lower, casadi.SX(-casadi.inf))) and bool(
        casadi.is_equal(slot.upper, casadi.SX(casadi.inf))
    )


def _held_at_start_only(declared: Declarations, slot: Slot) -> bool:
    """Say whether conditions on the slot hold only it, at the start, as equalities."""
    names = _names_at(declared, slot)
    if names & symbol_names(declared.objective):
        return False
    points = [p for p in declared.point_symbols if p.slot == slot.name]
    if any(p.fraction != 0.0 or p.is_rate for p in points):
        return False
    fixed_at = {fraction for name, fraction in declared.fixed if name == slot.name}
    if not (points or fixed_at) or fixed_at - {0.0}:
        return False
    everything = {p.symbol.name() for p in declared.point_symbols} | {
        s.name for s in declared.statics
    }
    return all(
        symbol_names(c.expression) & everything <= names
        for c in declared.conditions
        if symbol_names(c.expression) & names
    )
