"""Damping of controls that enter linearly, towards the smoothed controls of the previous mesh.

If equations and objective depend linearly on a control, its value at a single collocation point
hardly affects the objective. Without damping, the control oscillates from point to point (chatter),
and changes from mesh to mesh. Damping is a penalty on the distance from the smoothed control of the
previous mesh: see docs/theory/refinement.md, eq. (9).

The complementarity gap is the error that Ipopt's barrier leaves in the objective. A damped solve
may stop at a larger gap than usual.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial.legendre import legvander

from pyomo_quad.collocation.mesh import radau_rule
from pyomo_quad.collocation.program.ipopt import StartDistance
from pyomo_quad.collocation.program.nonlinear import ExtendedProgram

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray, Mesh
    from pyomo_quad.collocation.program.transcription import Transcription
    from pyomo_quad.collocation.solution import Solution

# Error estimate of a mesh above which the next solution is expected far from the present one.
_FAR = 1e-2


@dataclass(frozen=True, kw_only=True)
class Damping:
    """Penalty on the distance between controls and the smoothed controls of a solution.

    Attributes
    ----------
    solution : Solution
        Solution on the previous mesh.
    controls : ndarray of int, shape (n_controls,)
        Positions of the damped controls among the algebraic variables.
    prices : ndarray, shape (n_controls,)
        The penalty is ``price / 2`` times the mean over the horizon of ``(control - smoothed
        control)**2``.
    gap : float
        Complementarity gap at which the next solve is to stop, in the unit of the objective. With
        0, it stops at Ipopt's usual gap.
    is_still : bool
        Whether the objective hardly changes from mesh to mesh any more.
    """

    solution: Solution
    controls: NDArray[np.intp]
    prices: FloatArray
    # At a larger gap, controls that hardly affect the objective change less from mesh to mesh.
    gap: float
    is_still: bool

    @property
    def start_distance(self) -> StartDistance:
        """Expected distance between the warm start and the solution on the next mesh.

        It is `NONE` if `is_still` is True, `FAR` if the error of the previous solution is large,
        and otherwise `SHORT`.
        """
        if self.is_still:
            return StartDistance.NONE
        return StartDistance.FAR if self.solution.error_estimate >= _FAR else StartDistance.SHORT

    def firmer(self, factor: float, gap: float) -> Damping:
        """Return a stronger damping, with penalties multiplied by `factor` and `is_still` set.

        With so strong a penalty, the objective is expected to hardly change. The attribute `gap` of
        the result is at least the argument `gap` times `Solution.nominal_objective`.
        """
        gap = max(gap * self.solution.nominal_objective, self.gap)
        return replace(self, prices=factor * self.prices, gap=gap, is_still=True)

    def applied_to(self, program: Transcription) -> ExtendedProgram:
        """Return a nonlinear program with the penalty of this damping added to its objective.

        `program` is the nonlinear program of the model on the next mesh.
        """
        mesh = program.mesh or self.solution.mesh
        return ExtendedProgram(
            program=program,
            columns=program.layout.algebraic_columns[:, self.controls].ravel(),
            weights=(mesh.quadrature_weights[:, None] * self.prices).ravel(),
            near=self._near(mesh.point_fractions).ravel(),
        )

    def _near(self, fractions: FloatArray) -> FloatArray:
        """Return the smoothed controls of the previous mesh, shape (n_fractions, n_controls)."""
        mesh, held = self.solution.mesh, self.solution.trajectory.algebraics[:, self.controls]
        # A polynomial of low degree in each element, clipped to the control's limits.
        if self.is_still:
            lower, upper = (limit[self.controls] for limit in self.solution.algebraic_limits)
            return np.clip(_smoothed(mesh, held, fractions), lower, upper)
        # Straight lines between the means over the elements: damping toward the point values would
        # preserve chattering.
        middles, means = _element_means(mesh, held)
        near = [np.interp(fractions, middles, mean) for mean in means.T]
        return np.reshape(near, (self.controls.size, fractions.size)).T


def _smoothed(mesh: Mesh, values: FloatArray, fractions: FloatArray) -> FloatArray:
    """Return functions smoothed in each element by a least-squares polynomial of lower degree.

    `values` are those at the collocation points, shape (n_points, k). The result has the smoothed
    values at the times `fractions`, fractions of the horizon, shape (n_fractions, k).
    """
    starts, found = np.asarray(mesh.breakpoints), np.empty((fractions.size, values.shape[1]))
    element = np.clip(np.searchsorted(starts, fractions) - 1, 0, mesh.elements - 1)
    for e in np.unique(element):
        degree, points = mesh.degrees[e], slice(mesh.first_node[e], mesh.first_node[e + 1])
        kept, root = (degree - 1) // 2, np.sqrt(radau_rule(degree).weights)[:, None]
        terms = root * legvander(2.0 * radau_rule(degree).points - 1.0, kept)
        coefficients = np.linalg.lstsq(terms, root * values[points], rcond=None)[0]
        inside = element == e
        places = 2.0 * (fractions[inside] - starts[e]) / mesh.widths[e] - 1.0
        found[inside] = legvander(places, kept) @ coefficients
    return found


def _element_means(mesh: Mesh, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the midpoint of each element, and the means of several functions over each element.

    `values` are those of k functions at the collocation points, shape (n_points, k). The results
    have the shapes (n_elements,) and (n_elements, k). Midpoints are fractions of the horizon.
    """
    weights = mesh.quadrature_weights[:, None]
    columns = np.column_stack([mesh.point_fractions, values, np.ones(mesh.points)])
    sums = np.add.reduceat(weights * columns, mesh.first_node[:-1], axis=0)
    # For an element of degree 1, whose only point is its end, the end replaces the midpoint.
    means = sums / sums[:, -1:]
    return means[:, 0], means[:, 1:-1]


def damping_of(
    solution: Solution, weight: float, *, gap: float = 0.0, is_still: bool = False
) -> Damping | None:
    """Return the damping on the next mesh of bounded controls that enter nearly linearly.

    For a control that always differs from the smoothed control by its whole range, the penalty is
    `weight` times `solution.nominal_objective`. If no control is damped, the result only sets the
    gap of the next solve. If `gap` is 0, too, the result is None.

    Parameters
    ----------
    solution : Solution
        Solution on the present mesh.
    weight : float
        Strength of the penalty.
    gap : float, optional
        Complementarity gap at which the next solve is to stop, relative to
        `solution.nominal_objective`; 0 for Ipopt's usual gap.
    is_still : bool, optional
        Whether the objective hardly changes from mesh to mesh any more.
    """
    lower, upper = solution.algebraic_limits
    width = upper - lower
    is_bounded = np.isfinite(width) & (width > 0.0)
    prices, controls = np.zeros(width.size), np.zeros(0, dtype=np.intp)
    if weight > 0.0 and np.any(is_bounded):
        prices[is_bounded] = 2.0 * weight * solution.nominal_objective / width[is_bounded] ** 2
        # Where the second derivative is small, the control enters nearly linearly. A cost with a
        # smoothed corner has curvature at the corner only, and is linear beside it. The least
        # curvature over all points therefore decides.
        controls = np.flatnonzero(is_bounded & (_least_curvatures(solution) < prices))
    if controls.size == 0 and gap == 0.0:
        return None
    return Damping(
        solution=solution,
        controls=controls,
        prices=prices[controls],
        gap=gap * solution.nominal_objective,
        is_still=is_still,
    )


def _least_curvatures(solution: Solution) -> FloatArray:
    """Return the least second derivative of the Lagrangian with respect to each algebraic variable.

    It is the minimum over all collocation points, and may be negative. The shape is
    (n_algebraics,).
    """
    program = solution.program
    first = 2 * program.layout.n_states
    controls = slice(first, first + program.layout.n_algebraics)
    curvatures = program.path_curvatures(solution.unknowns, solution.multipliers.rows)
    return np.asarray(curvatures[:, controls].min(axis=0))
