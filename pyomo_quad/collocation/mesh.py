"""Mesh of elements with flipped Radau points, and polynomials through values on the mesh.

See docs/theory/transcription.md, eqs. (1) to (3) and (8).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_left
from dataclasses import dataclass
from functools import cached_property, lru_cache
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import roots_jacobi

from pyomo_quad.collocation.errors import TranscriptionError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class RadauRule:
    """Flipped Radau rule on the unit interval, with d collocation points.

    Attributes
    ----------
    degree : int
        Number d of collocation points.
    points, weights : ndarray, shape (d,)
        Collocation points, the last of which is 1, and quadrature weights.
    nodes : ndarray, shape (d + 1,)
        0 and the collocation points.
    differentiation : ndarray, shape (d, d + 1)
        Matrix from values at the nodes to slopes at the collocation points.
    slope_at_start : ndarray, shape (d + 1,)
        Row vector from values at the nodes to the slope at 0.
    integration : ndarray, shape (d, d)
        Matrix from slopes at the collocation points to changes since 0.
    """

    degree: int
    points: FloatArray
    weights: FloatArray
    nodes: FloatArray
    differentiation: FloatArray
    slope_at_start: FloatArray
    integration: FloatArray


def barycentric_weights(nodes: FloatArray) -> FloatArray:
    """Return the barycentric weights of distinct nodes in the unit interval, shape (n_nodes,).

    For the nodes x_j, the weight is w_j = 1 / prod over k != j of 4 (x_j - x_k). See
    docs/theory/transcription.md, eq. (2).
    """
    # The factor 4, the inverse of the logarithmic capacity of the interval, avoids underflow and
    # overflow at high degree. It cancels in barycentric interpolation.
    differences = 4.0 * (nodes[:, None] - nodes[None, :])
    np.fill_diagonal(differences, 1.0)
    return np.asarray(1.0 / np.prod(differences, axis=1), dtype=float)


def interpolation_matrix(nodes: FloatArray, targets: FloatArray) -> FloatArray:
    """Return the matrix that maps a polynomial's values at nodes to its values at other points.

    The shape is (n_targets, n_nodes). The nodes are distinct points in the unit interval. A target
    equal to a node reproduces its value exactly.
    """
    weights = barycentric_weights(nodes)
    difference = targets[:, None] - nodes[None, :]
    exact = difference == 0.0
    difference[exact] = 1.0
    terms = weights[None, :] / difference
    hit = exact.any(axis=1)
    terms[hit] = exact[hit].astype(float)
    return np.asarray(terms / terms.sum(axis=1, keepdims=True), dtype=float)


def _square_differentiation(nodes: FloatArray) -> FloatArray:
    """Return the matrix that maps a polynomial's values at nodes to its slopes at the same nodes.

    The `nodes` are distinct points in the unit interval.
    """
    weights = barycentric_weights(nodes)
    difference = nodes[:, None] - nodes[None, :]
    np.fill_diagonal(difference, 1.0)
    matrix = weights[None, :] / weights[:, None] / difference
    np.fill_diagonal(matrix, 0.0)
    np.fill_diagonal(matrix, -matrix.sum(axis=1))
    return np.asarray(matrix, dtype=float)


@lru_cache(maxsize=256)
def radau_rule(degree: int) -> RadauRule:
    """Return the flipped Radau rule with `degree` collocation points.

    The interior points are the zeros of the Jacobi polynomial P(1, 0) of degree `degree` - 1,
    mapped to the unit interval.

    Raises
    ------
    TranscriptionError
        If the degree is below 1.
    """
    if degree < 1:
        raise TranscriptionError(
            f"mesh: element degree = {degree}; must be at least 1, 3 to 12 is usual."
        )
    if degree == 1:
        points, weights = np.array([1.0]), np.array([1.0])
    else:
        interior, jacobi_weights = roots_jacobi(degree - 1, 1.0, 0.0)
        points = np.append(0.5 * (1.0 + interior), 1.0)
        weights = np.append(0.5 * jacobi_weights / (1.0 - interior), 1.0 / degree**2)
    nodes = np.concatenate(([0.0], points))
    square = _square_differentiation(nodes)
    rule = RadauRule(
        degree=degree,
        points=points,
        weights=weights,
        nodes=nodes,
        differentiation=square[1:],
        slope_at_start=square[0],
        integration=np.asarray(np.linalg.inv(square[1:, 1:]), dtype=float),
    )
    # The rule is cached, so a caller who changed an array would change it for all.
    for array in (
        rule.points,
        rule.weights,
        rule.nodes,
        rule.differentiation,
        rule.slope_at_start,
        rule.integration,
    ):
        array.setflags(write=False)
    return rule


def real_array(
    arrays: Mapping[str, NDArray[Any]], name: str, shape: tuple[int | None, ...]
) -> FloatArray:
    """Return a checked copy of one array from a mapping of untrusted arrays.

    Parameters
    ----------
    arrays : mapping
        Arrays by name, for example as read from a file.
    name : str
        Name of the wanted array.
    shape : tuple of int or None
        Required shape; None allows any length.

    Returns
    -------
    ndarray
        Copy of the array, as floats.

    Raises
    ------
    TranscriptionError
        If the array is missing, has another type than float64 or another shape, or holds a number
        that is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> real_array({"energy": np.array([1.0, 2.0])}, "energy", (None,))
    array([1., 2.])
    """
    if name not in arrays:
        raise TranscriptionError(f"{name}: is missing.")
    array = arrays[name]
    wanted = " x ".join("n" if size is None else str(size) for size in shape)
    if array.dtype != np.float64:
        raise TranscriptionError(f"{name}: holds {array.dtype}; must be real numbers (float64).")
    if array.ndim != len(shape) or any(
        size not in (None, found) for size, found in zip(shape, array.shape, strict=True)
    ):
        found = " x ".join(map(str, array.shape)) or "a single number"
        raise TranscriptionError(f"{name}: has the shape {found}; must be {wanted}.")
    if not np.all(np.isfinite(array)):
        raise TranscriptionError(f"{name}: holds a number that is not finite.")
    return np.array(array)


@dataclass(frozen=True, kw_only=True)
class Trajectory:
    """States, algebraic variables and static variables on a mesh.

    Attributes
    ----------
    mesh : Mesh
        Mesh to which the values belong.
    states : ndarray, shape (n_points + 1, n_states)
        Values at the nodes: start of the horizon and collocation points.
    algebraics : ndarray, shape (n_points, n_algebraics)
        Values of algebraic variables (controls included) at the collocation points.
    statics : ndarray, shape (n_statics,)
        Values of the variables without time.
    """

    mesh: Mesh
    states: FloatArray
    algebraics: FloatArray
    statics: FloatArray

    def states_at(self, fractions: FloatArray) -> FloatArray:
        """Evaluate the polynomials of the states at fractions of the horizon.

        Parameters
        ----------
        fractions : ndarray, shape (n,)
            Times as fractions of the horizon.

        Returns
        -------
        ndarray, shape (n, n_states)
        """
        return interpolate(self.mesh, self.states, fractions, with_start=True)

    def rates_at(self, fractions: FloatArray) -> FloatArray:
        """Evaluate the derivatives of the states' polynomials at fractions of the horizon.

        The derivatives are taken with respect to the fraction of the horizon.

        Parameters
        ----------
        fractions : ndarray, shape (n,)
            Times as fractions of the horizon.

        Returns
        -------
        ndarray, shape (n, n_states)
            d state / d fraction of the horizon.
        """
        return interpolate_rates(self.mesh, self.states, fractions)

    def algebraics_at(self, fractions: FloatArray) -> FloatArray:
        """Evaluate the polynomials of the algebraic variables at fractions of the horizon.

        In each element, the polynomials pass through the values at the collocation points. The
        algebraic variables include the controls.

        Parameters
        ----------
        fractions : ndarray, shape (n,)
            Times as fractions of the horizon.

        Returns
        -------
        ndarray, shape (n, n_algebraics)
        """
        return interpolate(self.mesh, self.algebraics, fractions, with_start=False)


@dataclass(frozen=True, kw_only=True)
class Timeline:
    """Mapping between fractions of the declared horizon and physical time, linear in each phase.

    The declared horizon is the range of the continuous set in the Pyomo model. Free times, which
    the solve determines, divide it into phases. The boundary between two phases belongs to the
    earlier phase.

    Attributes
    ----------
    fractions : ndarray, shape (n,)
        Boundaries of the phases as fractions of the declared horizon, increasing from 0 to 1.
    times : ndarray, shape (n,)
        Physical times of these boundaries, increasing.
    """

    fractions: FloatArray
    times: FloatArray

    @property
    def spans(self) -> FloatArray:
        """Derivative of physical time with respect to the fraction of the horizon, in each phase.

        The array has one entry per phase.
        """
        return np.diff(self.times) / np.diff(self.fractions)

    def span_at(self, fractions: FloatArray) -> FloatArray:
        """Return the derivative of physical time with respect to the fraction of the horizon.

        Parameters
        ----------
        fractions : ndarray
            Fractions of the horizon at which the derivative is evaluated.

        Returns
        -------
        ndarray
            In the shape of `fractions`.
        """
        return self.spans[np.searchsorted(self.fractions[1:-1], fractions)]

    def time(self, fractions: Any) -> Any:
        """Return the physical times at fractions of the declared horizon.

        Parameters
        ----------
        fractions : float or ndarray
            Fractions of the declared horizon, the range of the model's continuous set, from 0 to 1.

        Returns
        -------
        ndarray
            In the shape of `fractions`.
        """
        phase = np.searchsorted(self.fractions[1:-1], fractions)
        inside = self.spans[phase] * (fractions - self.fractions[phase])
        ends = fractions == self.fractions[phase + 1]
        return np.where(ends, self.times[phase + 1], self.times[phase] + inside)

    def fraction(self, times: Any) -> Any:
        """Return the fractions of the declared horizon at physical times.

        The declared horizon is the range of the continuous set in the Pyomo model.

        Parameters
        ----------
        times : float or ndarray
            Physical times.

        Returns
        -------
        float or ndarray
            In the shape of `times`.
        """
        if len(self.times) == 2:
            return (times - self.times[0]) / (self.times[1] - self.times[0])
        phase = np.searchsorted(self.times[1:-1], times)
        first, last = self.fractions[phase], self.fractions[phase + 1]
        inside = (times - self.times[phase]) / np.diff(self.times)[phase] * (last - first)
        is_last = phase == len(self.times) - 2
        return np.where(is_last, first + inside, np.minimum(first + inside, last))

    @cached_property
    def _phases(self) -> tuple[list[float], list[tuple[float, float, float]]]:
        """Phases as Python numbers: the times between phases, and a tuple for each phase.

        The tuple is (first physical time, first fraction, fraction per unit of time).
        """
        slopes = np.diff(self.fractions) / np.diff(self.times)
        columns = self.times[:-1].tolist(), self.fractions[:-1].tolist(), slopes.tolist()
        return self.times[1:-1].tolist(), list(zip(*columns, strict=True))

    def fraction_at(self, time: float) -> float:
        """Return the fraction of the declared horizon at one physical time.

        For a single time, this method is several times faster than `fraction`.

        Parameters
        ----------
        time : float
            Physical time.
        """
        # Simulations call this method in each evaluation of the equations.
        ends, phases = self._phases
        phase = bisect_left(ends, time)
        start, first, slope = phases[phase]
        fraction = first + (time - start) * slope
        return min(fraction, phases[phase + 1][1]) if phase < len(ends) else fraction


def by_element(mesh: Mesh, fractions: FloatArray) -> list[tuple[int, np.ndarray, FloatArray]]:
    """Group fractions of the horizon by the element that contains them.

    Each item is (index of the element, positions in `fractions`, local coordinates from 0 to 1).
    Elements that contain no fraction are left out.
    """
    elements = mesh.locate(fractions)
    starts = np.asarray(mesh.breakpoints)
    groups = []
    order = np.argsort(elements, kind="stable")
    boundaries = np.flatnonzero(np.diff(elements[order])) + 1
    for positions in np.split(order, boundaries):
        if positions.size:
            e = int(elements[positions[0]])
            local = (fractions[positions] - starts[e]) / mesh.widths[e]
            groups.append((e, positions, local))
    return groups


def interpolate(
    mesh: Mesh, values: FloatArray, fractions: FloatArray, *, with_start: bool
) -> FloatArray:
    """Evaluate the polynomials through values on a mesh at fractions of the horizon.

    Parameters
    ----------
    mesh : Mesh
    values : ndarray, shape (n_points + 1, k) or (n_points, k)
        Values of k variables at the collocation points. If `with_start` is True, the value at the
        start of the horizon precedes them.
    fractions : ndarray, shape (n,)
        Times as fractions of the horizon.
    with_start : bool
        Whether each element's polynomial also passes through the value at the element's left end.

    Returns
    -------
    ndarray, shape (n, k)

    Examples
    --------
    >>> import numpy as np
    >>> mesh = Mesh(breakpoints=(0.0, 0.5, 1.0), degrees=(2, 2))
    >>> squares = mesh.node_fractions[:, None] ** 2
    >>> interpolate(mesh, squares, np.array([0.25, 0.9]), with_start=True).round(12)
    array([[0.0625],
           [0.81  ]])
    """
    result = np.empty((len(fractions), values.shape[1]))
    for e, positions, local in by_element(mesh, fractions):
        rule = radau_rule(mesh.degrees[e])
        first, last = mesh.first_node[e], mesh.first_node[e + 1]
        nodes = rule.nodes if with_start else rule.points
        held = values[first : last + 1] if with_start else values[first:last]
        result[positions] = interpolation_matrix(nodes, local) @ held
    return result


def interpolate_rates(mesh: Mesh, states: FloatArray, fractions: FloatArray) -> FloatArray:
    """Evaluate the slopes of state polynomials at fractions of the horizon.

    Parameters
    ----------
    mesh : Mesh
    states : ndarray, shape (n_points + 1, n_states)
        Values at the nodes: start of the horizon and collocation points.
    fractions : ndarray, shape (n,)
        Times as fractions of the horizon.

    Returns
    -------
    ndarray, shape (n, n_states)
        Derivatives with respect to the fraction of the horizon.

    Examples
    --------
    >>> import numpy as np
    >>> mesh = Mesh(breakpoints=(0.0, 0.5, 1.0), degrees=(2, 2))
    >>> squares = mesh.node_fractions[:, None] ** 2
    >>> interpolate_rates(mesh, squares, np.array([0.25, 0.9])).round(12)
    array([[0.5],
           [1.8]])
    """
    result = np.empty((len(fractions), states.shape[1]))
    for e, positions, local in by_element(mesh, fractions):
        rule = radau_rule(mesh.degrees[e])
        first, last = mesh.first_node[e], mesh.first_node[e + 1]
        slopes = np.vstack([rule.slope_at_start, rule.differentiation]) / mesh.widths[e]
        held = slopes @ states[first : last + 1]
        result[positions] = interpolation_matrix(rule.nodes, local) @ held
    return result


# Number of times per collocation point at which a polynomial is evaluated to find out whether it
# exceeds limits.
_LOOKS = 4


def control_polynomial(
    mesh: Mesh,
    values: FloatArray,
    element: int,
    start: float,
    end: float,
    limits: tuple[FloatArray, FloatArray] = (np.array(-np.inf), np.array(np.inf)),
) -> Callable[[float | FloatArray], FloatArray]:
    """Return the controls in one element as polynomials of physical time.

    The polynomials pass through the values at the element's collocation points. Where a polynomial
    exceeds a limit between the collocation points, the control is set to the limit.

    Parameters
    ----------
    mesh : Mesh
    values : ndarray, shape (n_points, k)
        Values of k variables at the collocation points of the whole mesh.
    element : int
        Index of the element.
    start, end : float
        Physical times of the element's ends.
    limits : (ndarray, ndarray), optional
        Lower and upper limits of the k variables, shape (k,) each; none by default.

    Returns
    -------
    callable
        t -> ndarray, shape (k,) for a single time, shape (n, k) for n times.

    Examples
    --------
    >>> mesh = Mesh(breakpoints=(0.0, 0.5, 1.0), degrees=(2, 2))
    >>> control = control_polynomial(mesh, mesh.node_fractions[1:, None], 0, start=0.0, end=5.0)
    >>> control(2.5).round(12)
    array([0.25])
    """
    points = radau_rule(mesh.degrees[element]).points
    weights = barycentric_weights(points)
    held = values[mesh.first_node[element] : mesh.first_node[element + 1]]
    width = end - start

    def polynomial(t: float | FloatArray) -> FloatArray:
        if isinstance(t, np.ndarray):
            return np.asarray(interpolation_matrix(points, (t - start) / width) @ held)
        difference = (t - start) / width - points
        nearest = int(np.argmin(np.abs(difference)))
        if difference[nearest] == 0.0:
            return np.asarray(held[nearest], dtype=float)
        terms = weights / difference
        return np.asarray(terms @ held / terms.sum(), dtype=float)

    looks = _LOOKS * (points.size + 1)
    looked_at = 0.5 - 0.5 * np.cos(np.pi * np.arange(looks + 1) / looks)
    found = interpolation_matrix(points, looked_at) @ held
    low, high = found.min(axis=0), found.max(axis=0)
    # Between the extrema of a Chebyshev polynomial, a polynomial exceeds its largest value there by
    # at most this factor: Ehlich and Zeller, "Schwankung von Polynomen zwischen Gitterpunkten",
    # Mathematische Zeitschrift 86 (1964).
    beyond = (high - low) / 2.0 * (1.0 / np.cos(np.pi * (points.size - 1) / (2 * looks)) - 1.0)
    if np.all((limits[0] <= low - beyond) & (high + beyond <= limits[1])):
        return polynomial
    return lambda t: np.clip(polynomial(t), *limits)


# Highest degree of a mesh read from a file; nodes of a higher degree take long to compute.
_HIGHEST_DEGREE = 100
# Bound of the rounding error of a fraction that is computed from a time and the ends of a horizon.
_ROUNDING = 1e-13


class Summarised(ABC):
    """Base class of objects that print a summary: one line as text, a small table in notebooks."""

    @property
    @abstractmethod
    def summary(self) -> dict[str, str]:
        """Main properties of the object, as text by label."""

    def __repr__(self) -> str:
        """Return the class name and the summary in one line."""
        told = ", ".join(f"{name}: {text}" for name, text in self.summary.items())
        return f"<{type(self).__name__} {told}>"

    def _repr_html_(self) -> str:
        """Return the summary as an HTML table for a notebook."""
        rows = "".join(
            f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>"
            for name, text in self.summary.items()
        )
        caption = f"<caption>{type(self).__name__}</caption>"
        return f"<table>{caption}{rows}</table>"


@dataclass(frozen=True, kw_only=True, repr=False)
class Mesh(Summarised):
    """Mesh of elements of any widths and degrees; times are fractions of the horizon, 0 to 1.

    Parameters
    ----------
    breakpoints : tuple of float, length n_elements + 1
        Element boundaries, from exactly 0 to exactly 1, strictly increasing.
    degrees : tuple of int, length n_elements
        Collocation points per element, each at least 1.

    Raises
    ------
    TranscriptionError
        If the boundaries do not increase from 0 to 1, a degree is not a whole number of at least 1,
        or the lengths of the tuples do not match.
    """

    breakpoints: tuple[float, ...]
    degrees: tuple[int, ...]

    def __post_init__(self) -> None:
        if len(self.breakpoints) != len(self.degrees) + 1 or not self.degrees:
            raise TranscriptionError(
                f"mesh: {len(self.breakpoints)} breakpoints for {len(self.degrees)} degrees; "
                "there must be one more breakpoint than elements, and at least one element."
            )
        if self.breakpoints[0] != 0.0 or self.breakpoints[-1] != 1.0:
            raise TranscriptionError(
                f"mesh: breakpoints run from {self.breakpoints[0]} to {self.breakpoints[-1]}; "
                "they are fractions of the horizon and must run from 0 to 1."
            )
        if not np.all(np.diff(self.breakpoints) > 0.0):
            raise TranscriptionError("mesh: breakpoints must increase strictly.")
        for degree in set(self.degrees):
            if degree != int(degree):
                raise TranscriptionError(f"mesh: degree {degree}; must be a whole number.")
            radau_rule(degree)

    @property
    def summary(self) -> dict[str, str]:
        """Numbers of elements and points, and range of degrees, as text by label."""
        low, high = min(self.degrees), max(self.degrees)
        degrees = f"{low}" if low == high else f"{low} to {high}"
        return {
            "elements": f"{self.elements}",
            "points": f"{self.points}",
            "degrees": degrees,
        }

    @classmethod
    def uniform(cls, elements: int, degree: int) -> Mesh:
        """Return a mesh of equally wide elements of the same degree.

        Parameters
        ----------
        elements : int
            Number of elements, at least 1.
        degree : int
            Collocation points per element, at least 1.

        Raises
        ------
        TranscriptionError
            If either number is below 1.
        """
        if elements < 1:
            raise TranscriptionError(f"mesh: {elements} elements; must be at least 1.")
        breakpoints = tuple(float(b) for b in np.arange(elements + 1) / elements)
        return cls(breakpoints=breakpoints, degrees=(degree,) * elements)

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Mesh:
        """Read a mesh from untrusted arrays, for example from a file, and check the arrays.

        Parameters
        ----------
        arrays : mapping
            Arrays by name: "breakpoints", real numbers, and "degrees", whole numbers.

        Raises
        ------
        TranscriptionError
            If an array is missing or of the wrong type, a degree is above 100, or the two arrays do
            not define a mesh.
        """
        breakpoints = real_array(arrays, "breakpoints", (None,))
        degrees = arrays.get("degrees")
        if degrees is None or degrees.dtype.kind != "i" or degrees.ndim != 1:
            raise TranscriptionError("degrees: must be a row of whole numbers.")
        if degrees.size and not 1 <= int(degrees.min()) <= int(degrees.max()) <= _HIGHEST_DEGREE:
            raise TranscriptionError(f"degrees: must be from 1 to {_HIGHEST_DEGREE}.")
        return cls(
            breakpoints=tuple(float(b) for b in breakpoints),
            degrees=tuple(int(d) for d in degrees),
        )

    def with_breakpoints(self, fractions: Iterable[float]) -> Mesh:
        """Return this mesh with additional element boundaries.

        If an element is split, both parts have the degree of the element. Boundaries that exist
        already are not repeated.

        Parameters
        ----------
        fractions : iterable of float
            The additional boundaries as fractions of the horizon.
        """
        breakpoints, degrees = list(self.breakpoints), list(self.degrees)
        for fraction in sorted(fractions):
            nearest = min(range(len(breakpoints)), key=lambda i: abs(breakpoints[i] - fraction))
            if abs(breakpoints[nearest] - fraction) < 1e-12:
                continue
            after = int(np.searchsorted(breakpoints, fraction))
            breakpoints.insert(after, float(fraction))
            degrees.insert(after, degrees[after - 1])
        return Mesh(breakpoints=tuple(breakpoints), degrees=tuple(degrees))

    @property
    def elements(self) -> int:
        """Number of elements."""
        return len(self.degrees)

    @cached_property
    def points(self) -> int:
        """Number of collocation points in all elements."""
        return int(sum(self.degrees))

    @cached_property
    def widths(self) -> FloatArray:
        """Element widths as fractions of the horizon, shape (n_elements,)."""
        return np.diff(self.breakpoints)

    @cached_property
    def first_node(self) -> NDArray[np.intp]:
        """Indices of the nodes at the element boundaries, shape (n_elements + 1,).

        Entry k is the first node of element k. The last entry is the last node of the mesh.
        """
        return np.concatenate(([0], np.cumsum(self.degrees))).astype(np.intp)

    @cached_property
    def element_of_point(self) -> NDArray[np.intp]:
        """Index of the element that each collocation point belongs to, shape (n_points,)."""
        return np.repeat(np.arange(self.elements), self.degrees)

    @cached_property
    def point_fractions(self) -> FloatArray:
        """Collocation points as fractions of the horizon, shape (n_points,)."""
        starts = np.asarray(self.breakpoints)
        fractions = np.concatenate(
            [starts[e] + self.widths[e] * radau_rule(d).points for e, d in enumerate(self.degrees)]
        )
        fractions[self.first_node[1:] - 1] = starts[1:]
        return fractions

    @cached_property
    def node_fractions(self) -> FloatArray:
        """Nodes as fractions of the horizon, shape (n_points + 1,).

        The nodes are 0 and the collocation points. At the nodes, the states have values.
        """
        return np.concatenate(([0.0], self.point_fractions))

    @cached_property
    def quadrature_weights(self) -> FloatArray:
        """Quadrature weights of all points, shape (n_points,): Radau weights times element widths.

        The sum of the weights is 1.
        """
        return np.concatenate(
            [self.widths[e] * radau_rule(d).weights for e, d in enumerate(self.degrees)]
        )

    def locate(self, fractions: FloatArray) -> NDArray[np.intp]:
        """Return the index of the element that contains each of several times.

        A time at an element boundary belongs to the element that ends there. This also holds for a
        time that exceeds the boundary by a rounding error only.

        Parameters
        ----------
        fractions : ndarray
            The times as fractions of the horizon.

        Returns
        -------
        ndarray of int
            In the shape of `fractions`.
        """
        inner = np.asarray(self.breakpoints)[1:-1]
        return np.searchsorted(inner, fractions - _ROUNDING, side="left").astype(np.intp)
