"""Costates from the multipliers of a solution, by the covector mapping, and their errors.

Derivation and sign rule: see docs/theory/transcription.md, eqs. (9) to (13).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import legendre

from pyomo_quad.collocation.mesh import (
    FloatArray,
    Mesh,
    Timeline,
    by_element,
    interpolation_matrix,
    radau_rule,
)
from pyomo_quad.collocation.program.bounds import limits_at_points
from pyomo_quad.collocation.program.transcription import linearised

if TYPE_CHECKING:
    from pyomo_quad.collocation.program.nonlinear import Bounds, Multipliers
    from pyomo_quad.collocation.program.transcription import Transcription

# Magnitude, as a fraction of objective / state size, below which a costate counts as zero.
_LEAST = 1e-9
# Fraction of a limit's pull in an element that a smooth polynomial does not explain, above which
# the pull may be an impulse.
_ROUGH = 0.02


@dataclass(frozen=True, kw_only=True)
class Costates:
    """Element polynomials of the costates, through the left end and the collocation points.

    Shapes: starts (n_elements, n_states), just after each left end, where a costate may jump;
    at_points, stages (n_points, n_states); hamiltonian (n_points,); sizes (n_states,).

    The multipliers at the points approximate the costates directly (`stages`), but at one order
    less than the states. Integrating the adjoint equations with these values through each element,
    from its left end, where the costate is accurate, restores the order (`at_points`). `sizes` are
    the largest magnitudes of the costates; a costate that is nearly zero gets a fraction of the
    objective instead.
    """

    mesh: Mesh
    starts: FloatArray
    at_points: FloatArray
    stages: FloatArray
    hamiltonian: FloatArray
    sizes: FloatArray

    @property
    def per_element(self) -> tuple[FloatArray, ...]:
        """Costates of each element, shape (degree + 1, n_states), left end first."""
        inner = np.split(self.at_points, self.mesh.first_node[1:-1])
        return tuple(np.vstack(held) for held in zip(self.starts, inner, strict=True))

    def at(self, fractions: FloatArray) -> FloatArray:
        """Return the costates at fractions of the horizon, shape (n, n_states)."""
        mesh, first = self.mesh, self.mesh.first_node
        found = np.empty((len(fractions), self.starts.shape[1]))
        for e, positions, local in by_element(mesh, fractions):
            held = np.vstack([self.starts[e], self.at_points[first[e] : first[e + 1]]])
            found[positions] = interpolation_matrix(radau_rule(mesh.degrees[e]).nodes, local) @ held
        return found


@lru_cache(maxsize=64)
def _roughness(degree: int) -> FloatArray:
    """Return the matrix from nodal values to the residuals of a polynomial fit of degree - 2."""
    smooth = legendre.legvander(2.0 * radau_rule(degree).nodes - 1.0, max(degree - 2, 0))
    return np.asarray(np.eye(degree + 1) - smooth @ np.linalg.pinv(smooth))


def _by_degree(mesh: Mesh) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Return each polynomial degree, with the indices of its elements and of their points.

    Shapes (k,) and (k, degree), where k elements of the mesh have that degree.
    """
    degrees = np.asarray(mesh.degrees)
    groups = []
    for degree in sorted(set(mesh.degrees)):
        chosen = np.flatnonzero(degrees == degree)
        groups.append((degree, chosen, mesh.first_node[chosen, None] + np.arange(degree)))
    return groups


def costates_of(
    program: Transcription,
    z: FloatArray,
    multipliers: Multipliers,
    *,
    bounds: Bounds,
    timeline: Timeline,
    objective: float,
) -> Costates:
    """Map the multipliers of a solution to costates and Hamiltonian (covector mapping).

    Parameters
    ----------
    program : Transcription
        The nonlinear program on one mesh.
    z : ndarray
        Its unknowns at the solution.
    multipliers : Multipliers
        Multipliers as Ipopt returns them for the unscaled program.
    bounds : Bounds
        Bounds of the unknowns and rows. The multiplier of a state's bound at a single
        time acts at that time, and is left out of the element before it.
    timeline : Timeline
        Physical times of the horizon.
    objective : float
        Magnitude of the objective's terms, the reference of the smallest costate that counts.
    """
    mesh = program.mesh or Mesh.uniform(1, 1)
    by_rate, by_state = _products(program, z, program.path_weights(z, multipliers.rows))
    by_state += _pull_of_bounds(program, multipliers, bounds)
    weights = mesh.quadrature_weights[:, None]
    stages, slopes = -by_rate / weights, -by_state / weights
    starts, at_points = np.empty((mesh.elements, by_rate.shape[1])), np.empty_like(stages)
    for degree, chosen, points in _by_degree(mesh):
        rule, widths = radau_rule(degree), mesh.widths[chosen, None]
        starts[chosen] = np.einsum("j,ejs->es", rule.differentiation[:, 0], by_rate[points])
        starts[chosen] /= widths
        grown = widths[:, None] * (rule.integration @ slopes[points])
        at_points[points] = starts[chosen, None] + grown
    states = z[program.layout.state_columns]
    density = program.lagrangian_density(z, multipliers.rows)
    rates = program.layout.slope_matrix @ states
    spans = timeline.span_at(mesh.point_fractions)
    size = np.abs(states).max(axis=0, initial=0.0)
    least = _LEAST * objective / np.where(size > 0.0, size, 1.0)
    return Costates(
        mesh=mesh,
        starts=starts,
        at_points=at_points,
        stages=stages,
        hamiltonian=(density + np.sum(stages * rates, axis=1)) / spans,
        sizes=np.maximum(np.abs(np.vstack([starts, at_points])).max(axis=0), least),
    )


def _products(
    program: Transcription, z: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return weighted sums of row derivatives by rates and states, shape (n_points, n_states)."""
    n, rows = program.layout.n_states, np.arange(weights.shape[1])
    slopes = program.path_slopes(
        program.path_variables(z), program.data.at_points(), rows, np.arange(2 * n)
    )
    products = np.einsum("kr,krc->kc", weights, slopes)
    return products[:, :n], products[:, n:]


def _pull_of_bounds(program: Transcription, multipliers: Multipliers, bounds: Bounds) -> FloatArray:
    """Return the multipliers of the bounds on states over time, shape (n_points, n_states)."""
    is_held = bounds.lower == bounds.upper
    for limit in limits_at_points(program):
        is_held[limit.columns] = True
    pull = np.where(is_held, 0.0, multipliers.upper - multipliers.lower)
    return np.asarray(pull[program.layout.state_columns[1:]])


def costate_errors_of(
    program: Transcription,
    z: FloatArray,
    multipliers: Multipliers,
    *,
    bounds: Bounds,
    costates: Costates,
) -> FloatArray:
    """Estimate the largest error of each costate, relative to its size, shape (n_states,).

    Where the solution is smooth, the estimate is the change from one more integration of the
    adjoint equations, with the costates in place of `stages`. A limit on a state that becomes
    active or inactive inside an element may act as an impulse anywhere in it. Where the multiplier
    does not vary smoothly, all of it counts as error, and so does its effect on the other costates.
    """
    mesh, weights = costates.mesh, costates.mesh.quadrature_weights[:, None]
    equations = linearised(program, program.path_variables(z), program.data.at_points())
    backwards = np.linalg.pinv(equations.by_rate)
    growth = np.einsum("kra,kbr->kab", equations.by_state, backwards)
    slopes = np.einsum("kab,kb->ka", growth, costates.at_points - costates.stages)
    rows = np.zeros((program.n_points, program.compiled.path.values.numel_out(0)))
    n = program.compiled.n_equations
    rows[:, :n] = multipliers.rows[: rows.shape[0] * n].reshape(-1, n)
    rows[:, :n][:, program.compiled.is_equality] = 0.0
    pull = _products(program, z, rows)[1] + _pull_of_bounds(program, multipliers, bounds)
    pull /= weights
    largest = np.zeros(costates.sizes.size)
    for degree, chosen, points in _by_degree(mesh):
        rule, widths = radau_rule(degree), mesh.widths[chosen, None, None]
        missed = 2.0 * np.abs(widths * (rule.integration @ slopes[points])).max(axis=1)
        grown = widths * (rule.integration @ pull[points])
        rough = np.abs(_roughness(degree)[:, 1:] @ grown).max(axis=1)
        whole = np.abs(grown).max(axis=1)
        uneven = np.where(rough > _ROUGH * whole, whole, rough)
        carried = np.einsum("eab,eb->ea", np.abs(growth[points]).max(axis=1), uneven)
        found = np.maximum.reduce([missed, uneven, widths[:, 0] * carried])
        largest = np.maximum(largest, found.max(axis=0))
    return np.asarray(largest / costates.sizes)
