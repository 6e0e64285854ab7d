"""Next mesh of a refinement: raise or lower degrees of elements, split and merge elements.

Rules and sources: see docs/theory/refinement.md, eqs. (4) to (6) and (8).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.polynomial import legendre

from pyomo_quad.collocation.mesh import FloatArray, Mesh, radau_rule
from pyomo_quad.collocation.refining.activity import JUMP_SHARE, SAME, kinks, known_boundaries
from pyomo_quad.collocation.refining.error import Allowance, state_sizes

if TYPE_CHECKING:
    from collections.abc import Callable

    from pyomo_quad.collocation.refining.error import ErrorEstimate
    from pyomo_quad.collocation.solution import Solution


@dataclass(frozen=True, kw_only=True)
class RefinementOptions:
    """Limits and thresholds of the mesh refinement.

    The tolerance of the refinement is not among them, but an argument of the function `refine`.

    Attributes
    ----------
    first_elements, first_degree : int
        Number of elements of the initial mesh, and their degree.
    max_meshes : int
        Number of solves after which the refinement stops.
    min_degree, max_degree : int
        Lowest degree to which an element's degree is lowered, and highest to which it is raised.
    smooth_decay : float
        Least decay rate of the Legendre coefficients of a smooth solution, in decades per degree.
        The degree is raised in smooth elements only; other elements are split.
    smallest_width : float
        Fraction of the horizon below which no element is split.
    max_points : int
        Number of collocation points above which no finer mesh is tried.
    allowance : Allowance
        Tolerances of a simulated flight with the controls, for example on violations of limits
        between the collocation points.
    damping : float
        Strength of the penalty on changes of controls on which equations and objective depend
        nearly linearly. If such a control changes by its whole range since the previous mesh, at
        all times, the penalty is `damping` * tolerance * `Solution.nominal_objective`.
    limits_move : bool
        Whether limits are expected to become active or inactive at many times. The refinement then
        splits elements at these times last, and solves less exactly on early meshes.
    on_mesh : callable, optional
        Called with the solution after each mesh on which Ipopt converged. If it returns False, the
        refinement ends with its most accurate solution and the status interrupted.
    known : Solution, optional
        Converged solution for the parameters of the present solve. If a warm start is given and the
        first mesh is that of `known`, then `known` replaces the solve on this mesh.
    """

    first_elements: int = 10
    first_degree: int = 4
    max_meshes: int = 25
    min_degree: int = 3
    max_degree: int = 12
    smooth_decay: float = 0.35
    smallest_width: float = 1e-9
    max_points: int = 60_000
    allowance: Allowance = field(default_factory=Allowance)
    damping: float = 100.0
    # Most times at which limits become active or inactive hardly affect the objective. Elements are
    # split there only after all errors meet the tolerance. Each solve reduces the complementarity
    # gap only to a fraction of the error on the previous mesh.
    limits_move: bool = False
    on_mesh: Callable[[Any], bool | None] | None = None
    known: Any = None

    @property
    def breach_between_points(self) -> float:
        """Largest violation of a bound that is allowed between the collocation points.

        The violation is relative to max(1, abs(bound)). An infinite value means that bounds are
        imposed at the points only.
        """
        # A later simulation then corrects the controls by feedback, and reveals violations between
        # the points. Bounds between the points would be superfluous.
        if self.allowance.state_error is not None:
            return math.inf
        allowed = min(self.allowance.control_breach, self.allowance.limit_breach)
        # If `limits_move` is true, solves with a warm start impose bounds between the points, with
        # this tolerance.
        return 0.5 * allowed if self.limits_move and allowed > 0.0 else math.inf

    @property
    def is_checked(self) -> bool:
        """Whether a simulation of the controls will check the result."""
        # Callers that simulate the controls state at least one tolerance of the simulation.
        return self.allowance != Allowance()

    @property
    def first_mesh(self) -> Mesh:
        """Initial mesh of a refinement: elements of equal width and equal degree."""
        return Mesh.uniform(self.first_elements, self.first_degree)


# Errors are predicted from a fit, so the target is below the tolerance; elements are merged or
# lowered in degree only if they are predicted to meet the tolerance by a wide margin.
# These numbers are fractions of the tolerance: the target, a smaller target for a mesh that is
# predicted to be the last, and the error below which elements merge.
_AIM, _LAST_AIM = 0.3, 0.03
_MARGIN = 1e-2
# Largest relative error of a mesh from which the next mesh is predicted to be the last. Nothing is
# predicted if no simulation checks the result: the estimated error of the states is then what the
# last mesh moved them, which is too little if this mesh differs from the one before it in few
# elements.
_LAST = 1.0
# Elements are merged on the first meshes only, so that merging and splitting cannot alternate.
_MERGING_MESHES = 8
# A control that is still clipped after this many meshes becomes constant in this many parts of its
# element; a constant cannot exceed a limit between the points.
_CHASING_MESHES, _CONSTANT_PARTS = 12, 8
# Corners are resolved by small elements; a high degree does not help there.
# Number and highest degree of the parts into which an element with a corner is split.
_CORNER_PARTS = 3
_CORNER_DEGREE = 4
# Largest number of parts into which any other element is split at once; and into which an element
# that exceeds a limit between the points is split if the next mesh is predicted to be the last.
_MOST_PARTS, _MOST_PARTS_AT_LIMIT = 4, 8
# Power of the width with which the violation of a limit between the points is assumed to decrease.
_VIOLATION_ORDER = 3
# Highest degree of parts in which a limit on states becomes active or inactive; a higher degree
# does not help there either.
_TOUCHING_DEGREE = 6
# If the quadratic term of the states in an element is below this multiple of a limit's violation,
# the limit alone causes it, and the states may be straight lines.
_STRAIGHT = 3.0
# One more degree makes the quadrature exact for polynomials of two more degrees.
_QUADRATURE_GAIN = 2.0
# Half the width of the sliver around a jump, relative to the element.
_SLIVER = 0.02


@dataclass(frozen=True)
class _Piece:
    """Element of the next mesh: its right end as a fraction of the horizon, and its degree."""

    end: float
    degree: int
    # Error of the element of the present mesh that contains this one; predicted error of a merged
    # element.
    error: float
    # Whether the element was refined or must keep its degree. It is then not merged.
    is_changed: bool = True


@dataclass(frozen=True, kw_only=True)
class Marks:
    """Choice of the elements to refine, and of those that keep their degree, on the next mesh.

    Attributes
    ----------
    coarse : frozenset of int
        Indices of the elements to refine.
    kept : frozenset of int
        Indices of the elements whose degree must not be lowered.
    are_kinked : bool
        Whether controls are expected to have a kink where they reach a limit, and no jump.
    """

    coarse: frozenset[int]
    kept: frozenset[int]
    # Controls that enter the equations linearly usually jump instead.
    are_kinked: bool = False


def refined_mesh(
    solution: Solution,
    error: ErrorEstimate,
    marks: Marks,
    tolerance: float,
    options: RefinementOptions,
) -> Mesh:
    """Return the next mesh of a refinement, given a solution and its estimated errors.

    `marks` lists the elements to refine, and those that keep their degree. The degrees of others
    may be lowered. If the next mesh would have more collocation points than `options.max_points`,
    the present mesh is returned.
    """
    mesh = solution.mesh
    pieces: list[_Piece] = []
    switches = {} if options.limits_move else _switches(solution, marks)
    for e, size in enumerate(error.per_element):
        if e in switches:
            pieces.extend(_isolated(mesh, e, switches[e], float(size)))
        elif e in marks.coarse:
            pieces.extend(_finer(solution, e, error, tolerance, options))
        elif e in marks.kept:
            pieces.append(_Piece(mesh.breakpoints[e + 1], mesh.degrees[e], float(size)))
        else:
            pieces.append(_lowered(solution, e, float(size), tolerance, options))
    if len(solution.history) < _MERGING_MESHES:
        pieces = _merged(pieces, solution, tolerance)
    mesh = Mesh(
        breakpoints=(0.0, *(p.end for p in pieces[:-1]), 1.0),
        degrees=tuple(p.degree for p in pieces),
    )
    return solution.mesh if mesh.points > options.max_points else mesh


def _lowered(
    solution: Solution, e: int, error: float, tolerance: float, options: RefinementOptions
) -> _Piece:
    """Return the element of the next mesh for an element `e` that needs no refinement.

    Its degree is lowered if its `error` is below 1 % of the tolerance. The Legendre coefficients of
    the states for the highest degrees must be negligible, too.
    """
    mesh = solution.mesh
    degree = mesh.degrees[e]
    if error < _MARGIN * tolerance:
        sizes = _legendre_sizes(solution, e)
        # The coefficients of the highest degrees must be negligible for all states.
        while degree > options.min_degree and sizes[degree - 1 :].sum() < _MARGIN * tolerance:
            degree -= 1
    return _Piece(mesh.breakpoints[e + 1], degree, error, is_changed=False)


def _switches(solution: Solution, marks: Marks) -> dict[int, float]:
    """Return the times of the control switches that the next mesh isolates in narrow elements.

    The result maps elements of `marks.coarse` to times as fractions of the horizon.
    """
    ends, found = np.asarray(solution.mesh.breakpoints)[1:], {}
    times = kinks(solution) if marks.are_kinked else np.zeros(0)
    elements = np.searchsorted(ends, times)
    for e in marks.coarse:
        here = times[elements == e]
        # The switch is the only kink in the element, or else the jump of a bounded control.
        time = float(here[0]) if here.size == 1 else _jump(solution, e)
        if time is not None:
            found[e] = time
    return found


def _isolated(mesh: Mesh, e: int, jump: float, size: float) -> list[_Piece]:
    """Return the elements into which an element with a jump or kink of a control is split.

    `size` is the estimated error of the element `e`. `jump` is the time of the jump or kink, as a
    fraction of the horizon. See docs/theory/refinement.md, eq. (8).
    """
    start, end, degree = mesh.breakpoints[e], mesh.breakpoints[e + 1], mesh.degrees[e]
    # A neighbour of degree 1 is a sliver from an earlier mesh, which failed to enclose the whole
    # jump.
    if 1 in (mesh.degrees[max(e - 1, 0)], mesh.degrees[min(e + 1, mesh.elements - 1)]):
        return _parts(mesh, e, _CORNER_PARTS, min(degree, _CORNER_DEGREE), size)
    half, wide = _SLIVER * (end - start), max(degree, 2)
    edges = [(jump - half, wide), (jump + half, 1)]
    inside = [(b, d) for b, d in edges if start + 0.5 * half < b < end - 0.5 * half]
    ends = [*inside, (end, wide)]
    # The sliver of degree 1 encloses the jump. Near an end of the element, it extends to that end.
    if len(inside) < 2:
        is_late = jump - start > end - jump
        ends = [*inside, (end, 1)] if is_late else [*((b, 1) for b, _ in inside), (end, wide)]
    return [_Piece(at, d, size) for at, d in ends]


def _finer(
    solution: Solution,
    e: int,
    error: ErrorEstimate,
    tolerance: float,
    options: RefinementOptions,
) -> list[_Piece]:
    """Return the elements of the next mesh that replace an element to be refined.

    The degree is raised or the element is split: see docs/theory/refinement.md, eqs. (4) and (5).
    """
    mesh = solution.mesh
    degree, size = mesh.degrees[e], float(error.per_element[e])
    # An element that is too narrow to be split stays unchanged.
    if mesh.widths[e] < 2.0 * options.smallest_width:
        return [_Piece(mesh.breakpoints[e + 1], degree, size)]
    # A corner is a control clipped at its limit, or a largest error that is due to bounds imposed
    # between the points (`restraint`) or to a control switch.
    is_corner = error.is_clipped[e] or size in (error.restraint[e], error.switches[e])
    # An element that meets the tolerance is refined if a limit becomes active or inactive in it.
    if size <= tolerance or is_corner:
        is_chased = error.is_clipped[e] and len(solution.history) > _CHASING_MESHES
        parts = (_CONSTANT_PARTS, 1) if is_chased else (_CORNER_PARTS, min(degree, _CORNER_DEGREE))
        return _parts(mesh, e, *parts, size)
    sizes = _legendre_sizes(solution, e)
    if degree == 2 and error.violation[e] == size and sizes[2] < _STRAIGHT * size:
        # Straight lines satisfy the limits that their ends satisfy.
        return _parts(mesh, e, 2, 1, size)
    is_last = options.is_checked and error.largest <= _LAST
    # Many limits are expected to become active or inactive.
    if options.limits_move and error.violation[e] == size:
        wanted = math.ceil((size / tolerance) ** (1.0 / _VIOLATION_ORDER))
        count = min(_MOST_PARTS_AT_LIMIT, max(2, wanted)) if is_last else _MOST_PARTS
        return _parts(mesh, e, count, min(degree, _TOUCHING_DEGREE), size)
    aim = _LAST_AIM if is_last else _AIM
    decades = math.log10(size / (aim * tolerance))
    decay = _decay(sizes)
    gain = decay
    if error.integrals[e] == size:
        decay = _decay(_integrand_sizes(solution, e))
        gain = _QUADRATURE_GAIN * decay
    wanted = degree + max(1, math.ceil(decades / max(gain, 1e-3)))
    if decay >= options.smooth_decay and wanted <= options.max_degree:
        return [_Piece(mesh.breakpoints[e + 1], wanted, size)]
    parts = min(_MOST_PARTS, max(2, math.ceil(10.0 ** (decades / (degree + 1.0)))))
    return _parts(mesh, e, parts, degree, size)


def _parts(mesh: Mesh, e: int, count: int, degree: int, size: float) -> list[_Piece]:
    """Split element `e` into `count` equally wide elements of the given degree.

    `size` is the estimated error of the element. It is recorded as the error of each part, too.
    """
    edges = np.linspace(mesh.breakpoints[e], mesh.breakpoints[e + 1], count + 1)
    ends = [*(float(b) for b in edges[1:-1]), mesh.breakpoints[e + 1]]
    return [_Piece(end, degree, size) for end in ends]


def _merged(pieces: list[_Piece], solution: Solution, tolerance: float) -> list[_Piece]:
    """Merge neighbouring elements of the next mesh if the merged element is accurate enough.

    Boundaries that the problem requires are kept. See docs/theory/refinement.md, eq. (6).
    """
    required = solution.problem.required_breakpoints(solution.instance)
    merged: list[_Piece] = []
    starts: list[float] = []
    for piece in pieces:
        start = merged[-1].end if merged else 0.0
        if merged and not (piece.is_changed or merged[-1].is_changed):
            last = merged[-1]
            degree = max(last.degree, piece.degree)
            ratio = (piece.end - starts[-1]) / min(piece.end - start, start - starts[-1])
            predicted = max(last.error, piece.error) * ratio ** (degree + 1)
            needed = any(abs(start - b) < SAME for b in required)
            if predicted < _MARGIN * tolerance and not needed:
                merged[-1] = _Piece(piece.end, degree, predicted, is_changed=False)
                continue
        merged.append(piece)
        starts.append(start)
    return merged


def _legendre_sizes(solution: Solution, e: int) -> FloatArray:
    """Return the largest Legendre coefficients over all states in an element, shape (degree + 1,).

    The coefficients of a state are relative to its magnitude over the horizon.
    """
    mesh, states = solution.mesh, solution.trajectory.states
    first, last = mesh.first_node[e], mesh.first_node[e + 1]
    nodes = 2.0 * radau_rule(mesh.degrees[e]).nodes - 1.0
    matrix = legendre.legvander(nodes, mesh.degrees[e])
    coefficients = np.linalg.solve(matrix, states[first : last + 1])
    return np.asarray(
        np.abs(coefficients / state_sizes(solution)).max(axis=1, initial=0.0), dtype=float
    )


def _integrand_sizes(solution: Solution, e: int) -> FloatArray:
    """Return the largest Legendre coefficients over all integrands in an element, shape (degree,).

    The coefficients of an integrand are relative to its magnitude in the element.
    """
    mesh, program = solution.mesh, solution.program
    points = slice(mesh.first_node[e], mesh.first_node[e + 1])
    held = program.rows_at_points(solution.unknowns)[points, program.compiled.n_equations :]
    degree = mesh.degrees[e]
    matrix = legendre.legvander(2.0 * radau_rule(degree).points - 1.0, degree - 1)
    size = np.abs(held).max(axis=0)
    coefficients = np.linalg.solve(matrix, held / np.where(size > 0.0, size, 1.0))
    return np.asarray(np.abs(coefficients).max(axis=1), dtype=float)


def _decay(sizes: FloatArray) -> float:
    """Return the decay rate of Legendre coefficients in decades per degree, by least squares.

    With fewer than two coefficients, it is 2, the rate of a smooth function.
    """
    # The constant term says nothing about smoothness.
    order = np.arange(1, sizes.size)
    # Coefficients at the level of rounding do not count.
    kept = sizes[1:] > 1e-14
    if kept.sum() < 2:
        return 2.0
    return float(-np.polyfit(order[kept], np.log10(sizes[1:][kept]), 1)[0])


def _jump(solution: Solution, e: int) -> float | None:
    """Return the time at which a bounded control jumps in an element, as a fraction of the horizon.

    It is None if no control jumps. See docs/theory/refinement.md, eq. (8).
    """
    mesh = solution.mesh
    # If the problem requires a boundary at the start or end of the element, a jump is assumed to be
    # there, for example because a parameter jumps. Elements are separated there already.
    if known_boundaries(solution)[e : e + 2].any():
        return None
    controls = solution.trajectory.algebraics
    lower, upper = solution.algebraic_limits
    first, last = mesh.first_node[e], mesh.first_node[e + 1]
    means = radau_rule(mesh.degrees[e]).weights @ controls[first:last]
    for k in range(controls.shape[1]):
        width = upper[k] - lower[k]
        before, after = controls[first - 1, k], controls[last, k]
        if np.isfinite(width) and abs(before - after) > JUMP_SHARE * width:
            share = (means[k] - after) / (before - after)
            if 0.0 < share < 1.0:
                return float(mesh.breakpoints[e] + share * mesh.widths[e])
    return None
