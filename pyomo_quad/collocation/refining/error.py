"""Errors of a solution between its collocation points, and their estimated effects.

The effects are those on the objective and on the final states. Derivations: see
docs/theory/refinement.md, eqs. (1) to (3).

Path equations are all constraints over time. The nominal magnitude of the objective is
`Solution.nominal_objective`. The argument `moved` has one array for each element: the errors of the
states at several times. The last of these times is the element's end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial.legendre import leggauss

from pyomo_quad.collocation.dynamics import control_limits
from pyomo_quad.collocation.limits import outside
from pyomo_quad.collocation.mesh import FloatArray, radau_rule
from pyomo_quad.collocation.program.compiled import MappedFunction
from pyomo_quad.collocation.program.definitions import definitions, with_defined
from pyomo_quad.collocation.program.ipopt import barrier_gap
from pyomo_quad.collocation.program.transcription import linearised, rate_corrections
from pyomo_quad.collocation.refining.switches import misplaced_switches

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from pyomo_quad.collocation.program.transcription import Linearised, Transcription
    from pyomo_quad.collocation.solution import Solution


def final_misses(solution: Solution, errors: FloatArray) -> FloatArray:
    """Return how much the state errors of each element change the final states.

    `errors` are those at each element's end, shape (n_elements, n_states). The linearised equations
    propagate them in open loop: see docs/theory/refinement.md, eq. (3). The result has the same
    shape. It is the absolute value of the change divided by max(1, abs(final state)).
    """
    program, mesh = solution.program, solution.mesh
    variables = program.path_variables(solution.unknowns)
    equations = linearised(program, variables, program.data.at_points())
    misses = np.zeros_like(errors)
    # The result is zero if the equations do not determine the time derivative of every state.
    if equations.rows.size != errors.shape[1]:
        return misses
    growth = np.eye(errors.shape[1])
    for e in reversed(range(mesh.elements)):
        misses[e] = growth @ errors[e]
        growth = growth @ _transition(solution, equations, e)
    final = np.maximum(1.0, np.abs(solution.trajectory.states[-1]))
    return np.asarray(np.abs(misses) / final)


def _transition(solution: Solution, equations: Linearised, e: int) -> FloatArray:
    """Return the state transition matrix of the element `e`, with the controls unchanged.

    It has the derivatives of the states at the element's end with respect to those at its start.
    """
    mesh = solution.mesh
    first, last = mesh.first_node[e], mesh.first_node[e + 1]
    slopes = radau_rule(mesh.degrees[e]).differentiation / mesh.widths[e]
    by_rate, by_state = equations.by_rate[first:last], equations.by_state[first:last]
    degree, n = last - first, by_state.shape[2]
    inner = np.einsum("kj,kab->kajb", slopes[:, 1:], by_rate)
    inner[np.arange(degree), :, np.arange(degree), :] += by_state
    outer = -np.einsum("k,kab->kab", slopes[:, 0], by_rate)
    moved = np.linalg.solve(inner.reshape(degree * n, degree * n), outer.reshape(degree * n, n))
    return np.asarray(moved[-n:])


# Violation of the limit to which a control is clipped, relative to it, that rounding may cause.
_ROUNDING = 1e-9
# Samples per collocation point at which limits are checked.
_SAMPLES = 4
# Panels of an element on which integrals are recomputed.
_PANELS = 4
# Fraction of the tolerance available to the cost of bounds between the points; the complementarity
# gap and the errors of the states use the rest.
_RESTRAINT_SHARE = 0.5
# Just inside an element's start, because the start itself belongs to the previous element.
_START = 1e-6


@dataclass(frozen=True, kw_only=True)
class Allowance:
    """Tolerances of the error estimate for a simulated flight with the controls of a solution.

    By default, the flight is in open loop: the controls are functions of time, without feedback
    from the states. `state_error` is given if feedback corrects the controls: in flight, or in a
    simulation before it.

    Attributes
    ----------
    control_breach : float
        Tolerable violation of a control's bound between the collocation points, relative to max(1,
        abs(bound)). A smaller violation enters the error estimate by its effect on the states. If a
        violation of a constant bound exceeds the tolerance, the control is clipped to the bound
        widened by the tolerance. The estimate includes the effect of clipping on the states. If a
        bound varies with time, a violation above the tolerance enters the estimate itself.
    limit_breach : float
        Tolerable violation of any other limit, relative to max(1, abs(limit)). A larger violation
        enters the error estimate itself, a smaller one by its effect on the objective.
    final_miss : float
        Tolerance on the final states, relative to max(1, abs(final state)).
    state_error : float, optional
        Tolerance on errors of the states between the points, relative to the states' magnitudes. By
        default, it is the tolerance of the refinement. With feedback, a larger value suffices. With
        such a value, residuals of algebraic equations may be ten times as large as the value.
    """

    control_breach: float = np.inf
    limit_breach: float = 0.0
    final_miss: float = np.inf
    # With feedback, errors of the states change the objective only to second order. The simulation
    # solves the algebraic equations itself.
    state_error: float | None = None


@dataclass(frozen=True, kw_only=True)
class ErrorEstimate:
    """Estimated relative errors of a solution, element by element.

    The errors `objective` to `integrals` of the n elements add up. Each entry is therefore
    extrapolated: ``min(n * error of the element, sum of the errors of all elements)``. See
    docs/theory/refinement.md, eq. (2).

    Attributes
    ----------
    states : ndarray, shape (n_elements, n_states)
        Largest error of each state, relative to `state_sizes`.
    violation : ndarray, shape (n_elements,)
        Largest violation of path equations and bounds between the collocation points. A violation
        within its tolerance in `Allowance` is replaced by its effect on states or objective.
    objective : ndarray, shape (n_elements,)
        Effect of the state errors on the objective.
    switches : ndarray, shape (n_elements,)
        Possible cost of misplaced control switches.
    costs : ndarray, shape (n_elements,)
        Twice `objective`, but relative to the objective's value instead of its nominal magnitude.
    restraint : ndarray, shape (n_elements,)
        Twice the increase of the objective by those bounds that the solve imposed between the
        points; zero if there were none.
    integrals : ndarray, shape (n_elements,)
        Largest quadrature error of objective and integrals.
    miss : ndarray, shape (n_elements,)
        Effect of the state errors on the final states.
    gap : float
        Complementarity gap, relative to the objective.
    is_clipped : ndarray of bool, shape (n_elements,)
        Whether a control is clipped in the element: see `Allowance.control_breach`.
    """

    # If the states or final states have their own tolerance, `states` or `miss` are multiplied by
    # ``tolerance / own tolerance``.
    states: FloatArray
    violation: FloatArray
    # Computed with the costates. Relative to `Solution.nominal_objective`, as are `restraint` and
    # the objective's quadrature error. Other integrals: relative to max(1, abs(integral)).
    objective: FloatArray
    # Both are relative to the objective itself, and zero while another error exceeds the tolerance.
    switches: FloatArray
    costs: FloatArray
    # Doubled, because the cost may use up only half of the tolerance.
    restraint: FloatArray
    integrals: FloatArray
    miss: FloatArray
    # A finer mesh does not reduce the gap.
    gap: float
    # A clipped control has a corner, which no polynomial degree resolves.
    is_clipped: NDArray[np.bool_]

    @property
    def per_element(self) -> FloatArray:
        """Largest error in each element, shape (n_elements,).

        It covers all attributes except `gap` and `is_clipped`.
        """
        return np.maximum.reduce(
            [
                self.states.max(axis=1, initial=0.0),
                self.violation,
                self.objective,
                self.switches,
                self.costs,
                self.restraint,
                self.integrals,
                self.miss,
            ]
        )

    @property
    def of_integrals(self) -> float:
        """Largest error of the objective and of the integrals, over all elements.

        It covers the attributes `objective`, `restraint` and `integrals`.
        """
        parts = (self.objective, self.restraint, self.integrals)
        return float(max(part.max(initial=0.0) for part in parts))

    @property
    def largest(self) -> float:
        """Largest of all errors in all elements and the relative complementarity gap.

        The refinement compares it with the tolerance.
        """
        return max(self.gap, float(self.per_element.max(initial=0.0)))


def estimate_error(
    solution: Solution, *, tolerance: float = 1.0, allowance: Allowance | None = None
) -> ErrorEstimate:
    """Estimate the errors of a solution between its collocation points, element by element.

    For the estimates, see docs/theory/refinement.md, "Error estimation".

    Parameters
    ----------
    solution : Solution
    tolerance : float
        Tolerance of the mesh refinement, with which all errors of the result are to be compared.
        The errors `switches` and `costs` are zero unless all other errors in all elements meet it.
    allowance : Allowance, optional
        Other tolerances. If its `state_error` is given, the errors of the states are multiplied by
        ``tolerance / state_error``. Errors of the final states are multiplied by ``tolerance /
        final_miss``. By default, `final_miss` is infinite, and this factor is zero.
    """
    allowance = allowance or Allowance()
    finer, free, panels = _sampled(solution, _finer_places, _dense_places, _panelled_places)
    dense = free
    if np.isfinite(allowance.control_breach):
        limits = control_limits(solution.problem, solution.instance, allowance.control_breach)
        dense, panels = (_clipped(solution.program, samples, limits) for samples in (free, panels))
    is_clipped = np.logical_or.reduceat(
        np.any(dense.variables != free.variables, axis=1), free.first_of_element
    )
    slopes = rate_corrections(solution.program, finer.variables, finer.data, finer.rows)
    moved = _state_corrections(solution, slopes)
    for e, change in _clipping_corrections(solution, free, dense, is_clipped).items():
        moved[e][-1] += change
    none = np.zeros(solution.mesh.elements)
    weight = 1.0 if allowance.state_error is None else tolerance / allowance.state_error
    found = ErrorEstimate(
        states=weight * _relative(solution, moved),
        objective=_objective_errors(solution, moved),
        switches=none,
        costs=none,
        restraint=_restraints(solution),
        violation=_breaches(solution, dense, allowance, _EQUATION_SHARE[weight < 1.0] * weight),
        integrals=_quadrature_errors(solution, panels),
        miss=_missed(solution, moved, tolerance / allowance.final_miss),
        gap=_gap(solution),
        is_clipped=is_clipped,
    )
    # Without the costs of misplaced switches, coarse elements are refined first.
    if found.per_element.max(initial=0.0) > tolerance:
        return found
    unit = _unit(solution)
    return replace(
        found,
        switches=_of_all(misplaced_switches(solution) / unit),
        costs=_UNSEEN * found.objective * solution.nominal_objective / unit,
    )


# Weight of residuals of algebraic equations relative to that of the states' errors: if the states
# count in full, and if a simulation solves the equations.
_EQUATION_SHARE = 1.0, 0.1
# Least magnitude of the objective in the relative complementarity gap, in the unit of its scaling.
_LEAST_SIZE = 1e-3


# Factor for the error of the controls, which the residual of the equations does not show.
_UNSEEN = 2.0
# Least reference of an error of the objective, in the unit of its scaling.
_LEAST_UNIT = 1e-4


def _unit(solution: Solution) -> float:
    """Return the magnitude by which errors of the objective are divided to make them relative.

    It is max(abs(objective), min(1, s), 1e-4 s), where 1 / s is the objective's scaling factor.
    """
    # The terms min(1, s) and 1e-4 s avoid a division by nearly zero.
    scaled = 1.0 / solution.scaling.objective
    return max(abs(solution.objective), min(1.0, scaled), _LEAST_UNIT * scaled)


def _gap(solution: Solution) -> float:
    """Return the complementarity gap that Ipopt's barrier leaves, relative to the objective.

    If the objective is near zero, a small reference magnitude replaces it.
    """
    program, z = solution.program, solution.unknowns
    least = min(_unit(solution), _LEAST_SIZE / solution.scaling.objective)
    size = max(program.objective_size(z), least)
    if solution.restraint is not None:
        return solution.restraint.gap / size
    return barrier_gap(program, solution.bounds, z, solution.multipliers) / size


@dataclass(frozen=True, kw_only=True)
class _Samples:
    """Variables and path equations of a solution at sample times, in the order of the elements."""

    # Rates (per fraction of the horizon), states, algebraic and static variables, one row per
    # sample.
    variables: FloatArray
    # Fraction of the horizon and parameters, one row per sample.
    data: FloatArray
    # Bodies of the path equations and path inequalities, then integrands, one row per sample.
    rows: FloatArray
    # Position of the first sample of each element, from 0.
    first_of_element: NDArray[np.intp]


@lru_cache(maxsize=64)
def _panelled(degree: int) -> tuple[FloatArray, FloatArray]:
    """Return points and weights of a quadrature rule with four equal panels in the element [0, 1].

    Each panel has a Gauss rule with `degree` + 1 points.
    """
    points, weights = leggauss(degree + 1)
    inner = (np.arange(_PANELS)[:, None] + 0.5 * (1.0 + points)) / _PANELS
    places = np.append(inner.ravel(), 1.0)
    # The last point is the element's right end, with weight 0.
    return places, np.append(np.tile(0.5 * weights / _PANELS, _PANELS), 0.0)


def densely_sampled(solution: Solution) -> _Samples:
    """Evaluate a solution's path constraints at many times between the collocation points.

    An element of degree d has 4 (d + 1) + 1 samples.
    """
    (samples,) = _sampled(solution, _dense_places)
    return samples


def _dense_places(degree: int) -> FloatArray:
    """Return the places at which limits are checked in the element (0, 1]."""
    return np.linspace(_START, 1.0, _SAMPLES * (degree + 1) + 1)


def _finer_places(degree: int) -> FloatArray:
    """Return the Radau points of degree `degree` + 1 in an element from 0 to 1."""
    return radau_rule(degree + 1).points


def _panelled_places(degree: int) -> FloatArray:
    """Return the points of the quadrature rule `_panelled` in an element from 0 to 1.

    `degree` is the degree of the element.
    """
    return _panelled(degree)[0]


def state_errors_as_interpolated(solution: Solution) -> FloatArray:
    """Return the state errors if algebraic variables are evaluated by their polynomials.

    In contrast, `estimate_error` evaluates an algebraic variable by the equation that defines it.
    The result has the shape (n_elements, n_states). Each error is relative to the largest magnitude
    of the state, from `state_sizes`.
    """
    # For example, ``r + r^3 = f`` defines r, which enters ``x' = r``. Between the collocation
    # points, r has two values: the solution of the equation, and the value of its polynomial.
    (finer,) = _sampled(solution, _finer_places, is_defined=False)
    slopes = rate_corrections(solution.program, finer.variables, finer.data, finer.rows)
    return _relative(solution, _state_corrections(solution, slopes))


def _sampled(
    solution: Solution, *grids: Callable[[int], FloatArray], is_defined: bool = True
) -> list[_Samples]:
    """Evaluate the path equations on several grids at once, and return the samples of each grid.

    A grid maps a degree to times between 0 and 1, the element's start and end. With `is_defined`,
    equations that define algebraic variables are solved. Otherwise, polynomials are evaluated.
    """
    program, mesh, path = solution.program, solution.mesh, solution.trajectory
    # The last time of each grid is 1.
    places = [grid(d) for grid in grids for d in mesh.degrees]
    ends = np.cumsum([len(p) for p in places])
    elements = np.tile(np.arange(mesh.elements), len(grids))
    starts = np.asarray(mesh.breakpoints)
    fractions = np.concatenate(
        [starts[e] + mesh.widths[e] * p for e, p in zip(elements, places, strict=True)]
    )
    # A point on a boundary belongs to the element that ends there.
    fractions[ends - 1] = starts[elements + 1]
    variables = np.hstack(
        [
            path.rates_at(fractions),
            path.states_at(fractions),
            path.algebraics_at(fractions),
            np.broadcast_to(path.statics, (fractions.size, path.statics.size)),
        ]
    )
    data = solution.problem.data_of(solution.instance, fractions).at_points()
    # Otherwise, algebraic variables that an equation defines keep the values of their polynomials.
    if is_defined:
        found = definitions(program, solution.unknowns)
        variables = with_defined(program, variables, data, found)
    rows = MappedFunction(program.compiled.path.values, fractions.size)(variables, data)[0]
    samples = []
    for firsts in np.split(np.concatenate(([0], ends[:-1])), len(grids)):
        last = ends[np.searchsorted(ends, firsts[-1], side="right")]
        held = slice(firsts[0], last)
        samples.append(
            _Samples(
                variables=variables[held],
                data=data[held],
                rows=rows[held],
                first_of_element=firsts - firsts[0],
            )
        )
    return samples


def _clipped(
    program: Transcription, samples: _Samples, limits: tuple[FloatArray, FloatArray]
) -> _Samples:
    """Return samples with the controls clipped to their limits, and equations evaluated anew.

    `limits` are lower and upper limits of the algebraic variables. They are infinite for variables
    that are not controls.
    """
    layout, variables = program.layout, samples.variables.copy()
    chosen = slice(2 * layout.n_states, 2 * layout.n_states + layout.n_algebraics)
    variables[:, chosen] = np.clip(variables[:, chosen], *limits)
    if np.array_equal(variables, samples.variables):
        return samples
    values = MappedFunction(program.compiled.path.values, len(variables))
    return replace(samples, variables=variables, rows=values(variables, samples.data)[0])


def _state_corrections(solution: Solution, slopes: FloatArray) -> list[FloatArray]:
    """Return the errors of the states in each element, integrated from the errors of the rates.

    `slopes` are the errors of the rates. Both are at the Radau points of the next higher degree:
    see docs/theory/refinement.md, eq. (1).
    """
    mesh, first, moved = solution.mesh, 0, []
    for e, degree in enumerate(mesh.degrees):
        local = slopes[first : first + degree + 1]
        # The error is zero at the element's left end. The last point is the right end.
        moved.append(mesh.widths[e] * radau_rule(degree + 1).integration @ local)
        first += degree + 1
    return moved


def _clipping_corrections(
    solution: Solution, free: _Samples, clipped: _Samples, is_clipped: NDArray[np.bool_]
) -> dict[int, FloatArray]:
    """Return how much the clipping of controls changes the states at the end of each element.

    The keys of the result are the elements in which `is_clipped` is True. `free` and `clipped` are
    dense samples with the controls before and after clipping.
    """
    if not np.any(is_clipped):
        return {}
    mesh, found = solution.mesh, {}
    # A simulation clips controls that exceed their limits between the collocation points.
    cut = rate_corrections(
        solution.program, clipped.variables, clipped.data, clipped.rows - free.rows
    )
    for e in np.flatnonzero(is_clipped).tolist():
        places, first = _dense_places(mesh.degrees[e]), clipped.first_of_element[e]
        # A clipped control is no polynomial, so the trapezoidal rule is used. It overestimates the
        # integral of a change of the rates with a peak at an element's end.
        found[e] = mesh.widths[e] * np.trapezoid(cut[first : first + places.size], places, axis=0)
    return found


def _relative(solution: Solution, moved: list[FloatArray]) -> FloatArray:
    """Return the largest error of each state in each element, shape (n_elements, n_states).

    It is relative to the state's largest magnitude, from `state_sizes`. `moved` has the errors of
    the states, from `_state_corrections`.
    """
    return np.array([np.abs(m).max(axis=0) / state_sizes(solution) for m in moved])


def state_sizes(solution: Solution) -> FloatArray:
    """Return the largest magnitude of each state over the horizon, shape (n_states,).

    Each entry is at least the state's nominal magnitude, which is 1 unless declared.
    """
    slots = solution.problem.compiled.declared.states
    nominal = np.array([s.nominal or 1.0 for s in slots])
    return np.maximum(np.abs(solution.trajectory.states).max(axis=0, initial=0.0), nominal)


def _objective_errors(solution: Solution, moved: list[FloatArray]) -> FloatArray:
    """Return the effect of each element's state errors on the objective, shape (n_elements,).

    It is relative to the objective's nominal magnitude. The effects are extrapolated by `_of_all`:
    see docs/theory/refinement.md, eq. (2). `moved` comes from `_state_corrections`.
    """
    mesh = solution.mesh
    if not solution.problem.compiled.declared.states:
        return np.zeros(mesh.elements)
    ends = solution.costates.stages[mesh.first_node[1:] - 1]
    changes = np.abs(np.sum(ends * np.array([m[-1] for m in moved]), axis=1))
    return _of_all(changes / solution.nominal_objective)


def _restraints(solution: Solution) -> FloatArray:
    """Return the cost of bounds that were imposed between the points, shape (n_elements,).

    The cost is twice their estimated increase of the objective, from `Solution.restraint`, relative
    to the objective's nominal magnitude. The result is extrapolated by `_of_all`.
    """
    if solution.restraint is None:
        return np.zeros(solution.mesh.elements)
    # Divided by this share, because the cost may use up only half of the tolerance.
    return _of_all(solution.restraint.cost / solution.nominal_objective / _RESTRAINT_SHARE)


def _of_all(shares: FloatArray) -> FloatArray:
    """Return each element's error extrapolated to the whole horizon of n elements.

    `shares` has the error of each element alone. The result for an element is ``min(n * error, sum
    of the errors of all elements)``: see docs/theory/refinement.md, eq. (2).
    """
    return np.asarray(np.minimum(len(shares) * shares, shares.sum(axis=0)))


def _quadrature_errors(solution: Solution, samples: _Samples) -> FloatArray:
    """Return the largest relative quadrature error of each element, shape (n_elements,).

    `samples` belong to the finer rule `_panelled`. An integral's error is relative to max(1,
    abs(integral)). The effect of all on the objective is relative to its nominal magnitude.
    `_of_all` extrapolates both.
    """
    program, mesh = solution.program, solution.mesh
    first = program.compiled.n_equations
    held = program.rows_at_points(solution.unknowns)[:, first:]
    if held.shape[1] == 0:
        return np.zeros(mesh.elements)
    coarse = np.add.reduceat(mesh.quadrature_weights[:, None] * held, mesh.first_node[:-1])
    weights = np.concatenate(
        [width * _panelled(d)[1] for width, d in zip(mesh.widths, mesh.degrees, strict=True)]
    )
    densities = _integrands(program, samples)
    missing = np.add.reduceat(weights[:, None] * densities, samples.first_of_element) - coarse
    prices = program.integral_weights(solution.unknowns, solution.multipliers.rows)
    own = np.maximum(1.0, np.abs(coarse.sum(axis=0)))
    shares = np.column_stack([missing @ prices / solution.nominal_objective, missing / own])
    return np.asarray(_of_all(np.abs(shares)).max(axis=1))


def _integrands(program: Transcription, samples: _Samples) -> FloatArray:
    """Return the values of all integrands at sample times, shape (n_samples, n_integrals).

    If a value is undefined, the variables are clipped to their limits. If it remains undefined, it
    is infinite.
    """
    compiled, n = program.compiled, program.layout.n_states
    densities = samples.rows[:, compiled.n_equations :]
    if np.all(np.isfinite(densities)):
        return densities
    # An integrand may be undefined where a variable is outside its limits.
    count = len(samples.variables)
    limits = MappedFunction(compiled.limits_over_time, count)(samples.data)
    low, high = (side[:, : n + program.layout.n_algebraics] for side in limits)
    variables = samples.variables.copy()
    chosen = slice(n, 2 * n + program.layout.n_algebraics)
    variables[:, chosen] = np.clip(variables[:, chosen], low, high)
    rows = MappedFunction(compiled.path.values, count)(variables, samples.data)[0]
    return np.nan_to_num(rows[:, compiled.n_equations :], nan=np.inf)


def _missed(solution: Solution, moved: list[FloatArray], weight: float) -> FloatArray:
    """Return a measure of each element's effect on the final states, shape (n_elements,).

    It is ``weight * error * contribution / largest contribution`` for the final state with the
    largest error. Contributions come from `final_misses`; the error is their sum over the elements.
    """
    # `weight` is the tolerance of the refinement divided by that of the final states.
    if weight == 0.0:
        return np.zeros(solution.mesh.elements)
    misses = final_misses(solution, np.array([m[-1] for m in moved]))
    worst = misses[:, misses.sum(axis=0).argmax()]
    # The element with the largest contribution is assigned the whole error. The refinement thus
    # refines it first.
    return np.asarray(weight * worst.sum() * worst / worst.max(initial=1e-300))


def _breaches(
    solution: Solution, samples: _Samples, allowance: Allowance, weight: float
) -> FloatArray:
    """Return the worst violation of equations and limits in each element, shape (n_elements,).

    Violations are relative. Residuals of equations are multiplied by `weight`. A limit's violation
    counts in full if it exceeds its tolerance in `allowance`, otherwise by its effect on states or
    objective.
    """
    mesh = solution.mesh
    residuals, limits, controls = (
        np.maximum.reduceat(worst, samples.first_of_element)
        for worst in violations(solution.program, samples)
    )
    # Violation times width estimates the change of the states within the element.
    most = (1.0 + _ROUNDING) * allowance.control_breach
    moved = np.where(controls > most, controls, controls * mesh.widths)
    # The sum of multipliers times the violation estimates the effect on the objective.
    earned = limits * _prices(solution) / solution.nominal_objective
    large = np.where(limits > allowance.limit_breach, limits, 0.0)
    return np.maximum.reduce([weight * residuals, large, moved, earned])


def _prices(solution: Solution) -> FloatArray:
    """Return for each element the sum of the multipliers of all bounds on states."""
    program, multipliers = solution.program, solution.multipliers
    columns = program.layout.state_columns[1:]
    on_states = (multipliers.lower[columns] + multipliers.upper[columns]).sum(axis=1)
    return np.add.reduceat(on_states, solution.mesh.first_node[:-1])


def violations(program: Transcription, samples: _Samples) -> tuple[FloatArray, ...]:
    """Return the worst violations at each sample, three arrays of shape (n_samples,).

    These are violations of algebraic equations, of limits that involve states but no rates, and of
    limits on controls or rates. They are relative to max(1, abs(bound)), and zero where satisfied.
    """
    compiled, n = program.compiled, program.layout.n_states
    variables, data = samples.variables, samples.data
    lower, upper = MappedFunction(compiled.path_bounds, len(variables))(data)
    held = samples.rows[:, : compiled.n_equations]
    every = np.arange(compiled.n_equations)
    named = compiled.path.jacobian_columns
    has_rates, has_rates_or_states = (
        np.isin(every, compiled.path.jacobian_rows[named < first]) for first in (n, 2 * n)
    )
    # Rates may jump like controls: a limit broken beside a jump moves a state by little.
    is_of_states = ~compiled.is_equality & ~has_rates & has_rates_or_states
    is_of_controls = ~compiled.is_equality & ~is_of_states
    low, high = MappedFunction(compiled.limits_over_time, len(variables))(data)
    own = outside(variables[:, n + compiled.limited], low, high)
    is_own = compiled.limited < n
    rows = outside(held, lower, upper)
    limits = np.hstack([rows[:, is_of_states], own[:, is_own]])
    controls = np.hstack([own[:, ~is_own], rows[:, is_of_controls]])
    return tuple(
        worst.max(axis=1, initial=0.0)
        for worst in (rows[:, ~has_rates & compiled.is_equality], limits, controls)
    )
