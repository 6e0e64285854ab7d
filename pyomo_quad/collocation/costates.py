"""Costates of a solution, computed from its multipliers, and estimates of the costates' errors.

By the covector mapping, the multipliers of the collocation equations are divided by the quadrature
weights to obtain the costates of the optimal control problem.

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

# Magnitude of a costate, relative to magnitude of the objective / magnitude of the state, below
# which the costate counts as zero.
_LEAST = 1e-9
# Fraction of the integrated multiplier of a limit in an element that a smooth polynomial does not
# fit, above which the multiplier may be an impulse.
_ROUGH = 0.02


@dataclass(frozen=True, kw_only=True)
class Costates:
    """Costates of a solution as polynomials on the elements, with the Hamiltonian.

    Attributes
    ----------
    mesh : Mesh
    starts : ndarray, shape (n_elements, n_states)
        Costates just after the left end of each element, where they may jump.
    at_points : ndarray, shape (n_points, n_states)
        Costates at the collocation points, by integrating the adjoint equations.
    stages : ndarray, shape (n_points, n_states)
        Less accurate costates at the collocation points, directly from the multipliers.
    hamiltonian : ndarray, shape (n_points,)
        H = L + p . dx/dt at the collocation points, with costates p, states x, and integrand L of
        the minimised objective per unit of physical time.
    sizes : ndarray, shape (n_states,)
        Largest magnitude of each costate over the horizon, but at least 1e-9 a / b. Here a is the
        magnitude of the objective, and b that of the state.
    """

    mesh: Mesh
    starts: FloatArray
    at_points: FloatArray
    stages: FloatArray
    hamiltonian: FloatArray
    sizes: FloatArray

    @property
    def per_element(self) -> tuple[FloatArray, ...]:
        """Costates at the nodes of each element, in arrays of shape (degree + 1, n_states).

        The nodes are the left end of the element and its collocation points.
        """
        inner = np.split(self.at_points, self.mesh.first_node[1:-1])
        return tuple(np.vstack(held) for held in zip(self.starts, inner, strict=True))

    def at(self, fractions: FloatArray) -> FloatArray:
        """Return the costates at fractions of the horizon, shape (n_fractions, n_states).

        At the boundary between two elements, the result is the value before a jump.
        """
        mesh, first = self.mesh, self.mesh.first_node
        found = np.empty((len(fractions), self.starts.shape[1]))
        for e, positions, local in by_element(mesh, fractions):
            held = np.vstack([self.starts[e], self.at_points[first[e] : first[e + 1]]])
            found[positions] = interpolation_matrix(radau_rule(mesh.degrees[e]).nodes, local) @ held
        return found


@lru_cache(maxsize=64)
def _roughness(degree: int) -> FloatArray:
    """Return the matrix R that maps the values in an element to the residual of a smooth fit.

    The values belong to the left end and the d collocation points. The fit by least squares has
    the degree max(d - 2, 0).
    """
    smooth = legendre.legvander(2.0 * radau_rule(degree).nodes - 1.0, max(degree - 2, 0))
    return np.asarray(np.eye(degree + 1) - smooth @ np.linalg.pinv(smooth))


def _by_degree(mesh: Mesh) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Group the elements of a mesh by their degree, the number of collocation points.

    Each item is (degree, indices of the k elements, indices of their points, shape (k, degree)).
    """
    degrees = np.asarray(mesh.degrees)
    groups = []
    # Elements of equal degree can be evaluated together by array operations.
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
    """Compute costates and Hamiltonian from the multipliers of a nonlinear program.

    `multipliers` are those of the unscaled program at its solution `z`; `bounds` are the bounds of
    its unknowns and constraints. `timeline` maps fractions of the horizon to physical time.
    `objective` is the objective's reference magnitude, the number a in `Costates.sizes`. See
    docs/theory/transcription.md, eqs. (9) to (12).
    """
    mesh = program.mesh or Mesh.uniform(1, 1)
    by_rate, by_state = _products(program, z, program.path_weights(z, multipliers.rows))
    by_state += _bound_multipliers(program, multipliers, bounds)
    weights = mesh.quadrature_weights[:, None]
    # The order of convergence of `stages` is lower by 1 than that of the states.
    stages, slopes = -by_rate / weights, -by_state / weights
    starts, at_points = np.empty((mesh.elements, by_rate.shape[1])), np.empty_like(stages)
    for degree, chosen, points in _by_degree(mesh):
        rule, widths = radau_rule(degree), mesh.widths[chosen, None]
        # The adjoint equations are integrated over each element, with the multipliers on the
        # right-hand side.
        starts[chosen] = np.einsum("j,ejs->es", rule.differentiation[:, 0], by_rate[points])
        starts[chosen] /= widths
        grown = widths[:, None] * (rule.integration @ slopes[points])
        at_points[points] = starts[chosen, None] + grown
    states = z[program.layout.state_columns]
    density = program.lagrangian_density(z, multipliers.rows)
    rates = program.layout.slope_matrix @ states
    spans = timeline.span_at(mesh.point_fractions)
    size = np.abs(states).max(axis=0, initial=0.0)
    # The least magnitude of a costate; a state that is always 0 has the magnitude 1 here.
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
    """Return the gradients of a weighted sum of equations with respect to rates and to states.

    Rates are derivatives by the fraction of the horizon. `weights` has a row per point, and columns
    for path equations, then integrands. Each gradient has shape (n_points, n_states).
    """
    n, rows = program.layout.n_states, np.arange(weights.shape[1])
    slopes = program.path_slopes(
        program.path_variables(z), program.data.at_points(), rows, np.arange(2 * n)
    )
    products = np.einsum("kr,krc->kc", weights, slopes)
    return products[:, :n], products[:, n:]


def _bound_multipliers(
    program: Transcription, multipliers: Multipliers, bounds: Bounds
) -> FloatArray:
    """Return upper minus lower multipliers of the states' bounds, shape (n_points, n_states).

    An entry is 0 where the state is fixed, or where a bound holds at a single time only.
    """
    is_held = bounds.lower == bounds.upper
    # A bound at a single time can make the costate jump there. The adjoint equations hold between
    # such jumps, and therefore do not contain its multiplier.
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
    """Estimate the largest relative error of each costate over the horizon, shape (n_states,).

    The result is the largest of three estimates, divided by `costates.sizes`: see
    docs/theory/transcription.md, eq. (13).
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
    pull = _products(program, z, rows)[1] + _bound_multipliers(program, multipliers, bounds)
    pull /= weights
    largest = np.zeros(costates.sizes.size)
    for degree, chosen, points in _by_degree(mesh):
        rule, widths = radau_rule(degree), mesh.widths[chosen, None, None]
        # The adjoint equations are integrated again, with `at_points` on the right-hand side. The
        # error is estimated as twice the change.
        missed = 2.0 * np.abs(widths * (rule.integration @ slopes[points])).max(axis=1)
        grown = widths * (rule.integration @ pull[points])
        # Where a limit on a state becomes active or inactive inside an element, the costate may
        # jump at an unknown time. If a smooth fit leaves more than 2 % of the change, the whole
        # change counts.
        rough = np.abs(_roughness(degree)[:, 1:] @ grown).max(axis=1)
        whole = np.abs(grown).max(axis=1)
        uneven = np.where(rough > _ROUGH * whole, whole, rough)
        # The adjoint equations couple the costates: an error from a jump in one causes errors in
        # others.
        carried = np.einsum("eab,eb->ea", np.abs(growth[points]).max(axis=1), uneven)
        found = np.maximum.reduce([missed, uneven, widths[:, 0] * carried])
        largest = np.maximum(largest, found.max(axis=0))
    return np.asarray(largest / costates.sizes)
