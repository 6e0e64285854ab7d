"""Pyomo's suffixes `dual`, `rc` and `costate`: derivatives of the objective from multipliers.

The derivatives are with respect to:

- the constant sides of constraints (`dual`);
- the bounds of variables (`rc`, reduced costs);
- the states (`costate`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from pyomo.core import Constraint, Var
from pyomo.core.base.suffix import active_import_suffix_generator

from pyomo_quad.collocation.mesh import interpolate
from pyomo_quad.collocation.program.bounds import limits_of
from pyomo_quad.collocation.reading.model_source import LiveModel

if TYPE_CHECKING:
    from collections.abc import Callable

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.solution import Solution


@dataclass(frozen=True, kw_only=True)
class Sensitivities:
    """Derivatives of the declared objective with respect to constraints, bounds or states.

    Attributes
    ----------
    over_time : dict
        Name of a component over time -> function of a time in the model's continuous set. For
        constraints and bounds, its values are per unit of time.
    once : dict
        Name of a component that does not depend on time -> derivative.
    """

    over_time: dict[str, Callable[[float], float]] = field(default_factory=dict)
    once: dict[str, float] = field(default_factory=dict)

    def add(self, name: str, price: Callable[[float], float]) -> None:
        """Add the derivative with respect to a component over time, as a function of time.

        `price` is the function: time -> derivative of the objective. If a function is stored for
        the component `name`, the two are summed.
        """
        held = self.over_time.get(name)
        if held is None:
            self.over_time[name] = price
        else:
            # Each side of a limit has its own function. Only one side can be active at a time; the
            # function of the other side is then zero.
            self.over_time[name] = lambda time: held(time) + price(time)


def load_suffixes(*solutions: Solution) -> None:
    """Fill the suffixes `dual`, `rc` and `costate` of a model that imports them.

    For constraints and bounds over time, the derivatives are per unit of time. Several horizons
    need one solution each, and one for the coupling constraints. For a pickled problem, nothing is
    filled.
    """
    source = solutions[0].problem.source
    # A pickled problem has lost its model.
    if not isinstance(source, LiveModel):
        return
    wanted = dict(active_import_suffix_generator(source.model))
    kinds = {"dual": Constraint, "rc": Var, "costate": Var}
    for name in wanted.keys() & kinds.keys():
        wanted[name].clear()
    for solution in solutions if wanted.keys() & kinds.keys() else ():
        for name, prices in _suffixes(solution).items():
            if name in wanted:
                own = solution.problem.source
                if isinstance(own, LiveModel):
                    own.load_suffix(wanted[name], kinds[name], prices.over_time, prices.once)


def _suffixes(solution: Solution) -> dict[str, Sensitivities]:
    """Return the derivatives of the objective for the suffixes "dual", "rc" and "costate"."""
    problem = solution.problem
    dual, reduced = _sensitivities(solution)
    costates = Sensitivities()
    if problem.has_horizon and problem.compiled.declared.states:
        names = [s.name for s in problem.compiled.declared.states]
        sign = -1.0 if solution.program.is_negated else 1.0
        at = {name: _costate(solution, k, sign) for k, name in enumerate(names)}
        costates = Sensitivities(over_time=at)
    return {"dual": dual, "rc": reduced, "costate": costates}


def _costate(solution: Solution, state: int, sign: float) -> Callable[[float], float]:
    """Return the costate of a state for the declared objective, as a function of time.

    `state` is the index of the state. `sign` is -1 if the objective is maximised, and 1 otherwise.
    """
    return lambda time: sign * float(solution.costates.at(_fraction(solution, time))[0, state])


def _function(solution: Solution, density: FloatArray) -> Callable[[float], float]:
    """Return the multiplier of a constraint or bound per unit of time, as a function of time.

    `density` has the values at the collocation points, shape (n_points,).
    """

    def at(time: float) -> float:
        fractions = _fraction(solution, time)
        return float(
            interpolate(solution.mesh, density[:, None], fractions, with_start=False)[0, 0]
        )

    return at


def _fraction(solution: Solution, time: float) -> FloatArray:
    """Return a time of the model's continuous set as a fraction of the set's range, shape (1,)."""
    first, last = solution.problem.values.declared_horizon
    return np.array([(time - first) / (last - first)])


def _sensitivities(solution: Solution) -> tuple[Sensitivities, Sensitivities]:
    """Return the derivatives of the objective with respect to constraints, and to bounds.

    The first result is for the suffix `dual`, and the second for `rc`.
    """
    program, multipliers = solution.program, solution.multipliers
    declared = program.compiled.declared
    sign = -1.0 if program.is_negated else 1.0
    dual, reduced = Sensitivities(), Sensitivities()
    # The derivative with respect to the constant side of a constraint is its negative multiplier.
    rows = -sign * multipliers.rows
    if program.mesh is not None:
        over_time = rows[: program.first_condition_row].reshape(program.n_points, -1)
        for equation, held in zip(declared.equations, over_time.T, strict=True):
            dual.add(equation.name, _function(solution, held / _widths(solution)))
    conditions = rows[program.first_condition_row : program.first_integral_row]
    for condition, held in zip(declared.conditions, conditions.tolist(), strict=True):
        dual.once[condition.name] = held
    _assign_bounds(solution, sign, dual, reduced)
    return dual, reduced


def _widths(solution: Solution) -> FloatArray:
    """Return the duration that each collocation point represents, shape (n_points,).

    A multiplier divided by this duration is per unit of time.
    """
    mesh = solution.mesh
    # `span_at` is the derivative of physical time with respect to the fraction of the horizon: the
    # length of the horizon. If the solve determines times inside the horizon, each phase between
    # them has its own derivative.
    return np.asarray(solution.timeline.span_at(mesh.point_fractions) * mesh.quadrature_weights)


def _assign_bounds(
    solution: Solution, sign: float, dual: Sensitivities, reduced: Sensitivities
) -> None:
    """Add the derivatives of the objective with respect to bounds to `dual` or `reduced`.

    `dual` gets the bounds that constraints on a single variable impose, `reduced` those in the
    declarations of variables. `sign` is -1 if the objective is maximised, and 1 otherwise.
    """
    program, bounds = solution.program, solution.bounds
    compiled = program.compiled
    first = len(compiled.declared.states) + len(compiled.declared.algebraics)
    simple = (*compiled.limits[first:], *compiled.simple_point_bounds)
    slopes = {bound.name: bound.slope for bound in simple}
    # A variable bounded at one time only has a limit with that member's own name.
    find = solution.problem.model.find_component
    of_constraints = slopes.keys() - {
        b.name for b in compiled.simple_point_bounds if getattr(find(b.name), "ctype", None) is Var
    }
    left = {"lower": np.array(solution.multipliers.lower), "upper": -solution.multipliers.upper}
    start_data = solution.problem.data_at_starts(solution.instance)
    for limit in limits_of(program, start_data, solution.instance.fixed):
        total = np.zeros(limit.columns.size)
        for side, rest in left.items():
            # If two declarations impose the same bound, the first of them gets the multiplier.
            is_own = getattr(limit, side) == getattr(bounds, side)[limit.columns]
            total += np.where(is_own, rest[limit.columns], 0.0)
            rest[limit.columns[is_own]] = 0.0
        prices = sign * total / slopes.get(limit.name, 1.0)
        table = dual if limit.name in of_constraints else reduced
        if program.mesh is not None and prices.size >= program.n_points > 1:
            own = prices[-program.n_points :]
            table.add(limit.name, _function(solution, own / _widths(solution)))
        elif prices.size == 1:
            table.once[limit.name] = float(prices[0])
