"""Starting points of a solve: an initial guess, or a warm start from an earlier solution."""

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
    """Numbers of iterations that a solve from an initial guess (cold start) took.

    A warm start of the same problem contains this record. A later solve from the warm start is
    abandoned if it takes more iterations than the cold start took.

    Attributes
    ----------
    first, iterations : int
        Iterations on the first mesh, and on all meshes.
    tolerance : float
        Tolerance of the mesh refinement of that solve, 0 for a single mesh.
    """

    first: int
    iterations: int
    tolerance: float

    @property
    def array(self) -> FloatArray:
        """The record as an array, which `from_arrays` reads.

        The three numbers are the iterations on the first mesh, the iterations on all meshes, and
        the tolerance.
        """
        return np.array([float(self.first), float(self.iterations), self.tolerance])

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> ColdStart | None:
        """Read the record from untrusted arrays by name, for example from a file, and check it.

        The result is None without an array "cold_start". If this array does not hold three finite
        real numbers, a TranscriptionError is raised.
        """
        if "cold_start" not in arrays:
            return None
        first, iterations, tolerance = real_array(arrays, "cold_start", (3,)).tolist()
        return cls(first=int(first), iterations=int(iterations), tolerance=tolerance)


@dataclass(frozen=True, kw_only=True)
class WarmStart:
    """Trajectory and multipliers of a solution, stored without the problem that was solved.

    A later solve of the same equations can start from them on any mesh. The arrays become
    read-only.

    Attributes
    ----------
    model : str
        Fingerprint (hash) of the equations to which the multipliers belong.
    trajectory : Trajectory
        States, algebraic variables and static variables.
    lower, upper : Trajectory
        Multipliers of the bounds of the variables in `trajectory`, arranged like these variables.
    equations : ndarray, shape (n_points, n_equations)
        Multipliers of the equations over time at the collocation points.
    conditions : ndarray, shape (n_conditions,)
        Multipliers of the constraints at single times, such as an end condition, and of the
        equations that define integrals.
    cold_start : ColdStart, optional
        Iterations of the solve without a warm start, if known.
    """

    model: str
    trajectory: Trajectory
    lower: Trajectory
    upper: Trajectory
    equations: FloatArray
    # Defining equations of integrals are included if the program has the integrals as unknowns.
    conditions: FloatArray
    cold_start: ColdStart | None = None

    def __post_init__(self) -> None:
        for array in self._numbers().values():
            array.setflags(write=False)

    @property
    def mesh(self) -> Mesh:
        """Mesh of the stored trajectory."""
        return self.trajectory.mesh

    @property
    def is_finite(self) -> bool:
        """Whether all values and multipliers are finite; after a failed solve they may not be."""
        return all(bool(np.all(np.isfinite(array))) for array in self._numbers().values())

    def fits(self, compiled: CompiledModel) -> bool:
        """Return whether the warm start belongs to the equations of a compiled model.

        The fingerprint of the equations and the sizes of the arrays are compared.

        Parameters
        ----------
        compiled : CompiledModel
            Equations of the model, as CasADi functions.
        """
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
        """Interpolate the warm start to another mesh and horizon, at equal physical times.

        Parameters
        ----------
        mesh : Mesh
            Mesh of the result.
        was, now : Timeline
            Timelines of this warm start and of the result. The horizon of the result must lie
            within the horizon of this warm start.

        Returns
        -------
        WarmStart
        """
        nodes, points = (
            was.fraction(now.time(fractions))
            for fractions in (mesh.node_fractions, mesh.point_fractions)
        )
        # The multiplier of a constraint at a collocation point is proportional to the duration that
        # the point represents: its quadrature weight times the length of the horizon.
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
        """Return trajectory and multipliers as arrays, by the names that files use for them."""
        sides = {"": self.trajectory, "lower_": self.lower, "upper_": self.upper}
        named = {f"{side}{part}": getattr(t, part) for side, t in sides.items() for part in _PARTS}
        return named | {"equations": self.equations, "conditions": self.conditions}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the warm start as a dictionary of named arrays, which `from_arrays` reads."""
        about = {
            "model": np.frombuffer(self.model.encode("ascii"), dtype=np.uint8),
            "breakpoints": np.asarray(self.mesh.breakpoints),
            "degrees": np.asarray(self.mesh.degrees),
        }
        if self.cold_start is not None:
            about["cold_start"] = self.cold_start.array
        return about | self._numbers()

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> WarmStart:
        """Read a warm start from untrusted arrays, for example from a file, and check them.

        Parameters
        ----------
        arrays : mapping
            Arrays by name, as `WarmStart.arrays` returns them.

        Raises
        ------
        TranscriptionError
            If an array is missing or has a wrong type, shape or content; the message names the
            array.
        """
        mesh = Mesh.from_arrays(arrays)
        model = arrays.get("model")
        if model is None or model.dtype != np.uint8 or model.ndim != 1 or np.any(model > 127):
            raise TranscriptionError("model: must be the ASCII codes of a fingerprint.")
        first = real_array(arrays, "states", (None, None))
        has_time = first.size > 0 or len(first) > 0
        points = mesh.points if has_time else 0
        nodes = points + 1 if has_time else 0
        widths = (first.shape[1], real_array(arrays, "algebraics", (points, None)).shape[1])
        statics = real_array(arrays, "statics", (None,)).size
        shapes = ((nodes, widths[0]), (points, widths[1]), (statics,))
        sides = []
        for side in ("", "lower_", "upper_"):
            states, algebraics, values = (
                real_array(arrays, f"{side}{part}", shape)
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
            equations=real_array(arrays, "equations", (points, None)),
            conditions=real_array(arrays, "conditions", (None,)),
            cold_start=ColdStart.from_arrays(arrays),
        )


def warm_start_of(
    program: Transcription,
    z: FloatArray,
    multipliers: Multipliers,
    cold_start: ColdStart | None,
) -> WarmStart:
    """Return a warm start from the unknowns and multipliers of a nonlinear program.

    `z` are the unknowns, shape (n_unknowns,). `cold_start` records how many iterations a solve from
    an initial guess took; None if unknown.
    """
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
    """Interpolate a warm start to the mesh of a program; return unknowns and multipliers.

    The fractions of the horizon are kept: half of one horizon becomes half of the other. If the
    warm start belongs to another model, a TranscriptionError is raised.
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
    """Starting point of a solve: a warm start, an initial guess, or the model's own values.

    Attributes
    ----------
    warm : WarmStart or tuple of WarmStart, optional
        Warm start. For several horizons, one per horizon and one for the coupling constraints.
    guess : mapping, Trajectory or list, optional
        Initial guess, by default the values of the model. For several horizons, one per horizon and
        one for all other variables.
    seed : int
        Seed of a random initial point; 0 for none.
    is_elastic : bool
        Whether to start from the optimum of the elastic program, in which equations over time may
        be violated at a penalty.
    """

    warm: Any = None
    guess: Any = None
    # The random point lies between the bounds of the variables.
    seed: int = 0
    is_elastic: bool = False

    @classmethod
    def of(cls, given: Any, guess: Any = None) -> Start:
        """Make a starting point from the arguments `warm_start` and `guess` of a solve.

        `given` is the argument `warm_start`: None, a warm start, or an object with an attribute
        `warm_start`, such as a solution or a flight plan. `guess` has the initial values of the
        variables.
        """
        return cls(warm=getattr(given, "warm_start", given), guess=guess)

    @property
    def cold(self) -> Start:
        """Copy of this starting point without its warm start."""
        return replace(self, warm=None)

    @property
    def cold_start(self) -> ColdStart | None:
        """Numbers of iterations that an earlier solve from an initial guess took, None if unknown.

        The warm start contains these numbers: the iterations on the first mesh, and on all meshes.
        A solve from the warm start may take no more. With several horizons, the numbers of the
        first warm start are returned.
        """
        first = self.warm[0] if isinstance(self.warm, tuple) else self.warm
        return first and first.cold_start


#: Start at the values that the variables of the Pyomo model have.
AT_THE_MODEL = Start()
