"""Starting points of a solve: a guess, or point and multipliers of another solution."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.guess import point_from_trajectory
from pyomo_quad.collocation.mesh import Mesh, Timeline, Trajectory, interpolate, real_array
from pyomo_quad.collocation.program.nonlinear import Multipliers

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.program.compiled import CompiledModel
    from pyomo_quad.collocation.program.transcription import Transcription

_PARTS = ("states", "algebraics", "statics")


@dataclass(frozen=True, kw_only=True)
class ColdStart:
    """Iterations of a solve from the guess, as a budget for warm starts of the same problem.

    Attributes
    ----------
    first, iterations : int
        Iterations on the first mesh, and on all meshes.
    tolerance : float
        Tolerance of that solve, 0 for a single mesh.
    """

    first: int
    iterations: int
    tolerance: float

    @property
    def array(self) -> FloatArray:
        """Return the three numbers as an array for `from_arrays`."""
        return np.array([float(self.first), float(self.iterations), self.tolerance])

    @classmethod
    def from_arrays(cls, held: Mapping[str, NDArray[Any]]) -> ColdStart | None:
        """Read the record from untrusted arrays, None if they hold none."""
        if "cold_start" not in held:
            return None
        first, iterations, tolerance = real_array(held, "cold_start", (3,)).tolist()
        return cls(first=int(first), iterations=int(iterations), tolerance=tolerance)


@dataclass(frozen=True, kw_only=True)
class WarmStart:
    """Point and multipliers of a solution, independent of its problem.

    Attributes
    ----------
    model : str
        Fingerprint of the equations to which the multipliers belong.
    trajectory : Trajectory
        The point itself.
    lower, upper : Trajectory
        Multipliers of the bounds, in the form of a trajectory.
    equations : ndarray, shape (n_points, n_equations)
        Multipliers of the equations over time.
    conditions : ndarray, shape (n_conditions,)
        Multipliers of all other rows.
    cold_start : ColdStart, optional
        Iterations of the solve without a warm start, if known.
    """

    model: str
    trajectory: Trajectory
    lower: Trajectory
    upper: Trajectory
    equations: FloatArray
    conditions: FloatArray
    cold_start: ColdStart | None = None

    def __post_init__(self) -> None:
        for array in self._numbers().values():
            array.setflags(write=False)

    @property
    def mesh(self) -> Mesh:
        """Mesh of the solution."""
        return self.trajectory.mesh

    @property
    def is_finite(self) -> bool:
        """Whether all numbers are finite; those of a failed solve may not be."""
        return all(bool(np.all(np.isfinite(array))) for array in self._numbers().values())

    def fits(self, compiled: CompiledModel) -> bool:
        """Return whether a compiled model has the same equations as the warm start."""
        held, declared = self.trajectory, compiled.declared
        return (
            self.model == compiled.fingerprint
            and (not declared.has_horizon or held.states.shape[1] == len(declared.states))
            and (not declared.has_horizon or held.algebraics.shape[1] == len(declared.algebraics))
            and held.statics.size == len(declared.statics)
            and self.equations.shape[1] == compiled.n_equations
            and self.conditions.size == len(declared.conditions) + len(compiled.static_of_integral)
        )

    def continued(self, mesh: Mesh, was: Timeline, now: Timeline) -> WarmStart:
        """Return the warm start on another mesh, with its values at the same times.

        Multipliers of quantities imposed at a point, divided by the duration that the point
        represents, are samples of a function of time, which is interpolated.

        Parameters
        ----------
        mesh : Mesh
            Mesh of the same horizon, or of another one inside it.
        was, now : Timeline
            Times of its own horizon, and of the other.
        """
        nodes, points = (
            was.fraction(now.time(fractions))
            for fractions in (mesh.node_fractions, mesh.point_fractions)
        )
        old = self.mesh.quadrature_weights * was.span_at(self.mesh.point_fractions)
        new = mesh.quadrature_weights * now.span_at(mesh.point_fractions)
        path, sides = self.trajectory, (self.lower, self.upper)
        # Interpolate all at once: building the polynomials costs as much as evaluating them.
        imposed = [self.equations]
        imposed += [part for side in sides for part in (side.states[1:], side.algebraics)]
        held = np.hstack([path.algebraics, *(part / old[:, None] for part in imposed)])
        borders = np.cumsum([path.algebraics.shape[1], *(part.shape[1] for part in imposed)])[:-1]
        carried = interpolate(self.mesh, held, points, with_start=False)
        algebraics, *pulls = np.split(carried, borders, axis=1)
        equations, *limits = (part * new[:, None] for part in pulls)
        positive = [np.maximum(part, 0.0) for part in limits]
        lower, upper = (
            replace(side, mesh=mesh, states=np.vstack([side.states[:1], over]), algebraics=others)
            for side, over, others in zip(sides, positive[::2], positive[1::2], strict=True)
        )
        states = path.states_at(nodes)
        moved = replace(path, mesh=mesh, states=states, algebraics=algebraics)
        return replace(self, trajectory=moved, lower=lower, upper=upper, equations=equations)

    def _numbers(self) -> dict[str, FloatArray]:
        sides = {"": self.trajectory, "lower_": self.lower, "upper_": self.upper}
        named = {f"{side}{part}": getattr(t, part) for side, t in sides.items() for part in _PARTS}
        return named | {"equations": self.equations, "conditions": self.conditions}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the warm start as named arrays for `from_arrays`."""
        about = {
            "model": np.frombuffer(self.model.encode("ascii"), dtype=np.uint8),
            "breakpoints": np.asarray(self.mesh.breakpoints),
            "degrees": np.asarray(self.mesh.degrees),
        }
        if self.cold_start is not None:
            about["cold_start"] = self.cold_start.array
        return about | self._numbers()

    @classmethod
    def from_arrays(cls, held: Mapping[str, NDArray[Any]]) -> WarmStart:
        """Read a warm start from untrusted arrays.

        Raises
        ------
        TranscriptionError
            Naming the array that is missing or has another type, shape or content.
        """
        mesh = Mesh.from_arrays(held)
        model = held.get("model")
        if model is None or model.dtype != np.uint8 or model.ndim != 1 or np.any(model > 127):
            raise TranscriptionError("model: must be the ASCII codes of a fingerprint.")
        first = real_array(held, "states", (None, None))
        has_time = first.size > 0 or len(first) > 0
        points = mesh.points if has_time else 0
        nodes = points + 1 if has_time else 0
        widths = (first.shape[1], real_array(held, "algebraics", (points, None)).shape[1])
        statics = real_array(held, "statics", (None,)).size
        shapes = ((nodes, widths[0]), (points, widths[1]), (statics,))
        sides = []
        for side in ("", "lower_", "upper_"):
            states, algebraics, values = (
                real_array(held, f"{side}{part}", shape)
                for part, shape in zip(_PARTS, shapes, strict=True)
            )
            sides.append(
                Trajectory(mesh=mesh, states=states, algebraics=algebraics, statics=values)
            )
        return cls(
            model=model.tobytes().decode("ascii"),
            trajectory=sides[0],
            lower=sides[1],
            upper=sides[2],
            equations=real_array(held, "equations", (points, None)),
            conditions=real_array(held, "conditions", (None,)),
            cold_start=ColdStart.from_arrays(held),
        )


def warm_start_of(
    program: Transcription,
    z: FloatArray,
    multipliers: Multipliers,
    cold_start: ColdStart | None,
) -> WarmStart:
    """Make a warm start from a program's point and multipliers."""
    first = program.first_condition_row
    return WarmStart(
        model=program.compiled.fingerprint,
        trajectory=program.trajectory(z),
        lower=program.trajectory(multipliers.lower),
        upper=program.trajectory(multipliers.upper),
        equations=np.array(
            multipliers.rows[:first].reshape(program.n_points, program.compiled.n_equations)
        ),
        conditions=np.array(multipliers.rows[first:]),
        cold_start=cold_start,
    )


def transfer(start: WarmStart, program: Transcription) -> tuple[FloatArray, Multipliers]:
    """Interpolate unknowns and multipliers of a warm start to the mesh of a program.

    Raises
    ------
    TranscriptionError
        If the warm start belongs to another model.
    """
    if not start.fits(program.compiled):
        raise TranscriptionError(
            "warm_start: the solution is of another model; pass its frame as guess= instead."
        )
    if program.mesh is not None and program.mesh != start.mesh:
        unit = Timeline(fractions=np.array([0.0, 1.0]), times=np.array([0.0, 1.0]))
        start = start.continued(program.mesh, unit, unit)
    z, lower, upper = (
        point_from_trajectory(program, part)
        for part in (start.trajectory, start.lower, start.upper)
    )
    rows = np.concatenate([start.equations.ravel(), start.conditions])
    return z, Multipliers(rows=rows, lower=lower, upper=upper)


@dataclass(frozen=True, kw_only=True)
class Start:
    """Starting point of a solve, with an optional warm start.

    Attributes
    ----------
    warm : WarmStart or tuple of WarmStart, optional
        Point and multipliers of another solution; with several horizons, one for each and for
        their coupling.
    guess : mapping, Trajectory or list, optional
        First point where there is no warm start; with several horizons, one for each.
    seed : int
        If above 0, the first point is random between the bounds.
    is_elastic : bool
        Whether the first point is the optimum of the elastic program.
    """

    warm: Any = None
    guess: Any = None
    seed: int = 0
    is_elastic: bool = False

    @classmethod
    def of(cls, given: Any, guess: Any = None) -> Start:
        """Make a start from a warm start or from an object that has one: a solution, a plan."""
        return cls(warm=getattr(given, "warm_start", given), guess=guess)

    @property
    def cold(self) -> Start:
        """Starting point without the warm start."""
        return replace(self, warm=None)

    @property
    def cold_start(self) -> ColdStart | None:
        """Iterations of the solve from the guess, if known."""
        first = self.warm[0] if isinstance(self.warm, tuple) else self.warm
        return first and first.cold_start


#: The start at the model's own values.
AT_THE_MODEL = Start()
