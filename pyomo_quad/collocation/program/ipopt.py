"""Ipopt through cyipopt: settings, callbacks, progress, and the best iterate of a failed solve.

Ipopt's barrier function leaves an error in the objective, the complementarity gap. `barrier_gap`
computes it, and `run_past_the_barrier` repeats a solve whose gap is too large. See
docs/theory/refinement.md, eq. (16).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import cyipopt
import numpy as np

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.program.linear_solvers import (
    OPTION,
    OWN_SOLVER,
    refuse_absent_solver,
)
from pyomo_quad.collocation.program.nonlinear import ExtendedProgram, Multipliers

if TYPE_CHECKING:
    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.program.nonlinear import Bounds, NonlinearProgram, Scaling


class Status(Enum):
    """Outcome of a solve.

    - `CONVERGED`: Ipopt converged, and so did the mesh refinement, if any.
    - `TOLERANCE_NOT_MET`: Ipopt converged on the last mesh, but the mesh refinement did not reach
      its tolerance.
    - `INFEASIBLE`: the constraints appear to have no solution.
    - `INTERRUPTED`: the progress callback, Ctrl+C or the time limit `SolverOptions.max_wall_s`
      stopped the solve.
    - `NOT_CONVERGED`: any other failure, for example at the limit of iterations or at Ipopt's own
      time limit.
    """

    CONVERGED = "converged"
    NOT_CONVERGED = "not_converged"
    INFEASIBLE = "infeasible"
    INTERRUPTED = "interrupted"
    TOLERANCE_NOT_MET = "tolerance_not_met"

    @property
    def is_solved(self) -> bool:
        """Whether Ipopt converged on the last mesh (`CONVERGED` or `TOLERANCE_NOT_MET`)."""
        return self in (Status.CONVERGED, Status.TOLERANCE_NOT_MET)

    @property
    def has_failed(self) -> bool:
        """Whether Ipopt failed or reported infeasibility (`NOT_CONVERGED` or `INFEASIBLE`).

        A poor initial guess may cause either outcome.
        """
        return self in (Status.NOT_CONVERGED, Status.INFEASIBLE)


# Relative relaxation of a bound where equations may leave it no interior.
_RELAXED = 1e-10
# Distances by which Ipopt pushes a warm start off its bounds: by default; where the times at which
# limits become active change; and for small changes (multipliers included).
_NEAR, _INSIDE, _WELL_INSIDE = 1e-9, 1e-6, 1e-4
# Least initial barrier parameter, and least multipliers, of a warm start where the times at which
# limits become active change.
_BEGUN = 1e-8
# Initial barrier parameter, and distance inside the bounds, of a warm start for other limits.
_BEGUN_FAR, _FAR_INSIDE = 1e-5, 1e-4
# Settings of a warm start far from its optimum: distance inside the bounds; exponent by which the
# barrier parameter falls, below Ipopt's 1.5, so that no single fall is large; and multiple of the
# barrier parameter to which each barrier problem is solved.
_MOVED_INSIDE = 1e-3
_FALLING_SLOWLY = {"mu_superlinear_decrease_power": 1.2, "barrier_tol_factor": 1e4}
# Settings of a solve without multipliers whose first point violates many limits: the barrier
# parameter begins large and falls by as much as a single good step allows.
_FROM_AFAR: tuple[tuple[str, Any], ...] = (
    ("mu_strategy", "monotone"),
    ("mu_init", 0.1),
    ("barrier_tol_factor", 1e3),
)
# Settings of a solve without multipliers whose first point is a flight along a route.
_FROM_A_FLIGHT: tuple[tuple[str, Any], ...] = (("mu_max", 1e-2),)
# Change of the scaled objective above which a warm start begins well inside its bounds.
_LARGE_CHANGE = 1e-6
# Ipopt ends a solve only at a barrier parameter below this multiple of its tolerance.
_ABOVE = 10.0
# Initial barrier parameter of a warm start that is expected to change little.
_LOW_BARRIER = 1e-10
# Ipopt's options for the distances by which it pushes a warm start off its bounds.
_PUSHES = (
    "warm_start_bound_push",
    "warm_start_bound_frac",
    "warm_start_slack_bound_push",
    "warm_start_slack_bound_frac",
    "warm_start_mult_bound_push",
)


class StartDistance(Enum):
    """Expected distance between a warm start and the point at which the solve ends.

    This point lies on the central path: the optima of the barrier problem for all positive barrier
    parameters.

    - `NONE`: the start practically coincides with this point.
    - `SHORT`: the start is near this point.
    - `FAR`: the start is far from this point.
    """

    NONE = "none"
    SHORT = "short"
    FAR = "far"


@dataclass(frozen=True, kw_only=True)
class SolverOptions:
    """Settings of Ipopt that a caller may change.

    Attributes
    ----------
    tolerance : float, optional
        Ipopt's option `tol`, for the scaled problem. With mesh refinement, the method `suiting`
        derives the default from the tolerance of the refinement. Otherwise, the default is 1e-9.
    max_iterations : int
        Limit of iterations on each mesh.
    max_wall_s : float, optional
        Wall-clock time limit for all meshes together [s].
    extra : tuple of (str, value)
        Further options of Ipopt, as (name, value). They override all other settings. If a name
        occurs twice, the later value applies.
    cold : tuple of (str, value)
        Options of Ipopt for solves without a warm start, as (name, value).
    """

    tolerance: float | None = None
    max_iterations: int = 500
    max_wall_s: float | None = None
    extra: tuple[tuple[str, Any], ...] = ()
    cold: tuple[tuple[str, Any], ...] = ()

    def suiting(self, tolerance: float) -> SolverOptions:
        """Return settings whose Ipopt tolerance suits the tolerance of the mesh refinement.

        Ipopt's option `tol` becomes ``1e-3 * tolerance``, but at least 1e-11 and at most 1e-9. A
        value that the caller has set remains.

        Parameters
        ----------
        tolerance : float
            Tolerance of the mesh refinement.
        """
        if self.tolerance is not None:
            return self
        return replace(self, tolerance=float(np.clip(1e-3 * tolerance, 1e-11, _TOLERANCE)))

    def at_most(self, iterations: float) -> SolverOptions:
        """Return the settings with a limit of iterations that is at most the given limit.

        Parameters
        ----------
        iterations : float
            Given limit of iterations on each mesh; infinite leaves the settings unchanged.
        """
        return replace(self, max_iterations=int(min(self.max_iterations, iterations)))

    def for_phases(self) -> SolverOptions:
        """Return settings for models in which an equation holds a variable at its bound.

        An example is full thrust that an equation prescribes in one phase (interval between free
        times). With these settings, unlike the defaults, Ipopt relaxes all bounds by 1e-10
        (relative). It finally projects the solution onto the original bounds.
        """
        # Equation and bound together leave the feasible set without an interior. Without the
        # relaxation, the multipliers diverge, and a warm start from them is slower than a solve
        # from the guess.
        relaxed = (("bound_relax_factor", _RELAXED), ("honor_original_bounds", "yes"))
        return replace(self, extra=(*relaxed, *self.extra))

    def on_central_path(self, parameter: float, distance: StartDistance) -> SolverOptions:
        """Return the settings for a warm start that converges to a point of the central path.

        The solve ends at a positive barrier parameter: see `StartDistance` and
        docs/theory/refinement.md, "The barrier's role".

        Parameters
        ----------
        parameter : float
            Final barrier parameter (Ipopt's `mu_target`), for the scaled objective.
        distance : StartDistance
            Expected distance of the start from the point at which the solve ends.
        """
        begun, chosen = dict(self.extra).get("mu_init", _BEGUN), dict[str, float]()
        # With `NONE`, variables that start on their bounds practically stay there.
        if distance is StartDistance.NONE:
            begun, chosen = 0.0, dict.fromkeys(_PUSHES, _NEAR)
        # At Ipopt's usual distance inside the bounds (`SHORT`), bounds that become active or
        # inactive would shorten nearly every step.
        elif distance is StartDistance.FAR:
            begun, chosen = _BEGUN_FAR, dict.fromkeys(_PUSHES, _MOVED_INSIDE) | _FALLING_SLOWLY
        # If many trajectories have nearly the same cost, the positive final parameter selects one
        # of them. The controls then change less from mesh to mesh.
        chosen["mu_init"] = max(parameter, begun)
        return replace(self, extra=(("mu_target", parameter), *self.extra, *chosen.items()))

    def for_a_change(self, change: float, sides: int) -> SolverOptions:
        """Return the settings for a warm start with a given expected change of the objective.

        The settings choose Ipopt's initial barrier parameter. For a change above 1e-6, they also
        move the start about 1e-4 inside the bounds.

        Parameters
        ----------
        change : float
            Expected change of the scaled objective.
        sides : int
            Number of inequality bounds of the program, `Bounds.sides`. The initial barrier
            parameter is derived from ``change / sides``.
        """
        # The barrier changes the objective by about the barrier parameter times `sides`. With a
        # parameter above ``change / sides``, the iterates would first move away from the warm start
        # and then return.
        tolerance, parameter = self.tolerance or _TOLERANCE, change / max(sides, 1)
        # Ipopt would keep a parameter below this limit until the end of the solve. The final gap
        # would then vary from mesh to mesh. The parameter chosen instead depends on the tolerance
        # alone.
        is_small = parameter < _ABOVE * tolerance
        last = tolerance / _WARM["barrier_tol_factor"]
        begun = last if is_small else min(parameter, _WARM["mu_init"])
        # A large change shifts the times at which bounds become active. From a start on the bounds,
        # Ipopt would take many short steps.
        pushes = _PUSHES if change > _LARGE_CHANGE else ()
        inside = tuple((name, _WELL_INSIDE) for name in pushes)
        return replace(self, extra=(("mu_init", begun), *inside, *self.extra))

    def for_moving_limits(self) -> SolverOptions:
        """Return settings for a warm start if limits may become active at other times than before.

        The settings move the start slightly inside the bounds of variables and constraints.
        """
        # If the start lies on a bound that becomes active at another time on the new mesh, the
        # bound shortens the first dozen steps of Ipopt.
        pushes = dict.fromkeys(_PUSHES, _INSIDE) | {"warm_start_mult_bound_push": _BEGUN}
        return replace(self, extra=(*pushes.items(), *self.extra))

    def for_other_limits(self) -> SolverOptions:
        """Return the settings for a warm start from the solution of a problem with other limits.

        The start may violate limits of the new problem. Ipopt moves it about 1e-4 inside the new
        limits, and begins with the barrier parameter 1e-5. The defaults of this package for a warm
        start are 1e-9 and 1e-7.
        """
        # With these settings, Ipopt needs fewer iterations to leave the limits that were active
        # before.
        pushes = dict.fromkeys(_PUSHES, _FAR_INSIDE) | {"warm_start_mult_bound_push": _BEGUN_FAR}
        return replace(self, extra=(*self.extra, ("mu_init", _BEGUN_FAR), *pushes.items()))

    def from_afar(self) -> SolverOptions:
        """Return the settings for a solve whose first point violates many inequalities.

        Only the attribute `cold`, which applies to solves without a warm start, differs from these
        settings. Its new options make the barrier parameter begin at 0.1 and only decrease: see
        docs/decisions/speed.md.
        """
        # By default, Ipopt chooses the barrier parameter adaptively, and estimates its first value
        # from the first point. The estimate is then often a thousand times too small, so that the
        # bounds shorten nearly every step.
        return replace(self, cold=_FROM_AFAR)

    def from_a_flight(self) -> SolverOptions:
        """Return the settings for a solve whose first point is a flight along a route.

        Only the attribute `cold`, which applies to solves without a warm start, differs from these
        settings. Its only option limits the barrier parameter to 0.01.
        """
        # The first value of Ipopt's adaptive barrier parameter may be near 1. The iterates then
        # move to flights that take two or three times as long, and need many iterations to return.
        return replace(self, cold=_FROM_A_FLIGHT)

    def for_small_changes(self) -> SolverOptions:
        """Return the settings for a warm start on a mesh that differs little from the one before.

        The start is the solution on the previous mesh. Ipopt moves it about 1e-4 inside the bounds,
        and begins with the barrier parameter 1e-10. The defaults of this package for a warm start
        are 1e-9 and 1e-7.
        """
        # With a larger parameter, controls that hardly affect the objective would drift away from
        # their values on the previous mesh. The parameter was tested on a flight of 1 km against
        # the wind, whose mesh was refined to five times as many points.
        pushes = tuple((name, _WELL_INSIDE) for name in _PUSHES)
        return replace(self, extra=(*self.extra, ("mu_init", _LOW_BARRIER), *pushes))


@dataclass(frozen=True, kw_only=True)
class Iteration:
    """Progress report on one iteration of Ipopt.

    Attributes
    ----------
    iteration : int
        Number of the iteration, from 0 in each solve.
    objective : float
        Value of the Pyomo model's objective, in its own sign even if the model maximises it. It
        includes added costs: penalties of slacks, and a quadratic cost that keeps controls near
        given values.
    infeasibility, dual_infeasibility : float
        Largest violation of the scaled constraints, and of the scaled stationarity conditions
        (gradient of the Lagrangian equal to zero).
    barrier : float
        Barrier parameter.
    elapsed_s : float
        Wall-clock time since the start of the solve [s].
    mesh_points : int
        Number of collocation points of the mesh.
    """

    iteration: int
    objective: float
    infeasibility: float
    dual_infeasibility: float
    barrier: float
    elapsed_s: float
    mesh_points: int


Progress = Callable[[Iteration], bool | None]


@dataclass(kw_only=True)
class Effort:
    """Progress callback that limits the iterations and the time of several successive solves.

    Attributes
    ----------
    progress : callable or None
        The caller's own callback.
    limits : (float, float)
        Iterations allowed in the first solve, and in all solves together.
    limit_s : float
        Wall-clock time allowed from construction on [s].
    first, count : int
        Iterations so far in the first solve, and in all.
    solves : int
        Number of solves so far.
    is_over : bool
        Whether a limit is exceeded.
    """

    progress: Progress | None
    limits: tuple[float, float] = (math.inf, math.inf)
    limit_s: float = math.inf
    first: int = 0
    count: int = 0
    solves: int = 0
    is_over: bool = False

    def __post_init__(self) -> None:
        self.started = time.perf_counter()

    def __call__(self, line: Iteration) -> bool | None:
        """Count an iteration; return False once a limit is exceeded, which stops the solve.

        Within the limits, the result is that of the caller's callback, or None without a callback.
        """
        self.solves += line.iteration == 0
        self.count += line.iteration > 0
        self.first = self.count if self.solves == 1 else self.first
        self.is_over = (
            self.first > self.limits[0]
            or self.count > self.limits[1]
            or (self.limit_s < math.inf and time.perf_counter() - self.started > self.limit_s)
        )
        if self.is_over:
            return False
        return None if self.progress is None else self.progress(line)


@dataclass(frozen=True, kw_only=True)
class IpoptResult:
    """Result of a solve by Ipopt: point, multipliers and progress.

    A solve may be repeated with other settings. The method `after` adds earlier solves to a result.

    Attributes
    ----------
    status : Status
    code : int
    message : str
        Ipopt's return code and message.
    z : ndarray, shape (n_unknowns,)
        The solution. After a failed or interrupted solve, the best iterate. An iterate replaces the
        best one so far if it has at most a tenth of its constraint violation. If the iterates
        diverged, the last iterate.
    multipliers : Multipliers
        Multipliers at the last iterate, for the unscaled program.
    iterations : int
        Number of iterations of the last solve.
    history : tuple of Iteration
        Progress reports of all solves, the first solve first.
    wall_s : float
        Wall-clock time of all solves [s].
    """

    status: Status
    code: int
    message: str
    z: FloatArray
    multipliers: Multipliers
    iterations: int
    history: tuple[Iteration, ...]
    wall_s: float

    @property
    def is_converged(self) -> bool:
        """Whether Ipopt converged to its tolerance."""
        return self.status is Status.CONVERGED

    def part(self, columns: Any, rows: Any) -> IpoptResult:
        """Return the result restricted to chosen unknowns and constraints.

        `columns` are the positions of the chosen unknowns (indices or a slice), `rows` those of the
        constraints.
        """
        return replace(self, z=self.z[columns], multipliers=self.multipliers.part(columns, rows))

    def after(self, earlier: IpoptResult) -> IpoptResult:
        """Return this result with the history and the wall-clock time of an earlier solve added."""
        return replace(
            self,
            history=(*earlier.history, *self.history),
            wall_s=earlier.wall_s + self.wall_s,
        )


@dataclass
class _Callbacks:
    """Callbacks that cyipopt calls during a solve; they record progress and the best iterate.

    The first exception in a callback is stored in `error`, and `run` raises it after Ipopt has
    returned.
    """

    program: NonlinearProgram
    progress: Progress | None
    # -1 if the Pyomo model maximises its objective, else 1.
    sign: float
    # Objective below which the problem counts as unbounded, if it stays there for several
    # iterations.
    floor: float
    # Number of the latest consecutive iterations with an objective below `floor`.
    below: int = 0
    started: float = field(default_factory=time.perf_counter)
    history: list[Iteration] = field(default_factory=list)
    # Constraint violation and unknowns of the best iterate. An iterate becomes the best if its
    # violation is at most a tenth of the violation stored here.
    best: tuple[float, FloatArray | None] = (np.inf, None)
    error: BaseException | None = None
    # Ipopt evaluates the Jacobian at its iterates only, so this is the iterate. Asking Ipopt for it
    # would take a tenth of the time of a warm re-solve.
    iterate: FloatArray | None = None

    @property
    def is_bottomless(self) -> bool:
        """Whether the problem appears unbounded.

        It does if the objective to minimise was below the attribute `floor` in the last five
        iterations.
        """
        return self.below >= _PATIENCE_BELOW

    # Cached, because a program may rebuild its structure at each call.
    @cached_property
    def _sizes(self) -> dict[str, int]:
        """Lengths of the arrays that the callbacks for constraints, Jacobian and Hessian return."""
        program = self.program
        return {
            "constraints": program.n_rows,
            "jacobian": len(program.jacobianstructure()[0]),
            "hessian": len(program.hessianstructure()[0]),
        }

    def _guarded(self, name: str, z: FloatArray, *more: Any) -> FloatArray:
        """Evaluate the method `name` of the program at the unknowns `z`, and catch its exceptions.

        From the first exception on, each evaluation returns an array of NaN.
        """
        if self.error is None:
            try:
                return np.asarray(getattr(self.program, name)(z, *more))
            except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001  raised again later
                # Ipopt cannot propagate an exception from a callback.
                self.error = error
        return np.full(self._sizes.get(name, z.size), np.nan)

    def objective(self, z: FloatArray) -> float:
        """Return the objective to minimise at the unknowns `z`, for Ipopt."""
        return float(self._guarded("objective", z).flat[0])

    def gradient(self, z: FloatArray) -> FloatArray:
        """Return the gradient of the objective to minimise at the unknowns `z`, for Ipopt."""
        return self._guarded("gradient", z)

    def constraints(self, z: FloatArray) -> FloatArray:
        """Return the values of the constraints at the unknowns `z`, for Ipopt."""
        return self._guarded("constraints", z)

    def jacobianstructure(self) -> tuple[Any, Any]:
        """Return row and column indices of the nonzeros of the constraints' Jacobian, for Ipopt."""
        return self.program.jacobianstructure()

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return the nonzeros of the constraints' Jacobian, and store `z` as the iterate."""
        self.iterate = np.array(z)
        return self._guarded("jacobian", z)

    def hessianstructure(self) -> tuple[Any, Any]:
        """Return row and column indices of the nonzeros of the Lagrangian's Hessian.

        Only the lower triangle is given.
        """
        return self.program.hessianstructure()

    def hessian(self, z: FloatArray, multipliers: FloatArray, factor: float) -> FloatArray:
        """Return the nonzeros of the Hessian of factor * objective + multipliers . constraints.

        The nonzeros are those of the lower triangle.
        """
        return self._guarded("hessian", z, multipliers, factor)

    def intermediate(
        self,
        _mode: int,
        iteration: int,
        objective: float,
        infeasibility: float,
        dual_infeasibility: float,
        barrier: float,
        *_rest: Any,
    ) -> bool:
        """Record an iteration and the best iterate; return False to stop Ipopt.

        The result is False after an exception, for an unbounded problem, or if the caller's
        callback returns False.
        """
        if self.error is not None:
            return False
        line = Iteration(
            iteration=iteration,
            objective=self.sign * objective,
            infeasibility=infeasibility,
            dual_infeasibility=dual_infeasibility,
            barrier=barrier,
            elapsed_s=time.perf_counter() - self.started,
            mesh_points=self.program.n_points,
        )
        self.history.append(line)
        self.below = self.below + 1 if objective < self.floor else 0
        if infeasibility <= 0.1 * self.best[0] and self.iterate is not None:
            self.best = (infeasibility, self.iterate)
        try:
            goes_on = self.progress is None or self.progress(line) is not False
        except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001  raised again later
            self.error = error
            return False
        return goes_on and not self.is_bottomless


# Default of Ipopt's tolerance `tol` for the scaled program; a mesh refinement uses no larger value.
_TOLERANCE = 1e-9

# With pivots as small as Ipopt's default for MUMPS (1e-6), steps lose so many digits that the
# inertia is miscounted, and convex problems are regularised until progress stalls. Larger pivots
# cause fill-in unless each matrix is rescaled. Bounds are kept as stated, because relaxed bounds
# would be visible in objectives that are accurate to 1e-8.
_DEFAULTS: dict[str, Any] = {
    "print_level": 0,
    "sb": "yes",
    OPTION: OWN_SOLVER,
    "mumps_pivtol": 1e-4,
    "mumps_scaling": 77,  # automatic choice for each matrix
    "mumps_permuting_scaling": 0,
    "mu_strategy": "adaptive",
    "nlp_scaling_method": "user-scaling",
    "bound_relax_factor": 0.0,
    "acceptable_iter": 0,
}

# A barrier problem counts as solved after one good step: waiting for more costs an iteration from a
# good start and saves none from a poor one. Next to a curved limit, a full step increases the error
# before the next steps reduce it; three of those steps are too few to decide.
_WARM: dict[str, Any] = {
    "warm_start_init_point": "yes",
    "mu_strategy": "monotone",
    "mu_init": 1e-7,
    "barrier_tol_factor": 1e3,
    "watchdog_trial_iter_max": 8,
} | dict.fromkeys(_PUSHES, _NEAR)

# Ipopt's return codes for convergence, for infeasibility, and for a stop by the callback.
_SOLVED, _INFEASIBLE, _STOPPED = 0, 2, 5
# A scaled objective is about 1 at the first point. Below `_BOTTOMLESS` for `_PATIENCE_BELOW`
# iterations, it counts as unbounded.
_BOTTOMLESS, _PATIENCE_BELOW = -1e12, 5
# Slack above which a bound counts as absent.
_FAR = 1e19
# Complementarity gap that is accepted, relative to the objective's magnitude and in units of
# Ipopt's tolerance; and the least magnitude of an objective, in units of its scaling.
_GAP_SHARE, _LEAST = 1e3, 1e-12
#: Least magnitude of the scaled objective that affects Ipopt's convergence test.
SEEN = 1e-6
# Limits of solves that are repeated with a larger factor on the objective: their number, the margin
# on the factor, the largest factor at once, and the iterations of each.
_SHARPENINGS, _AIMED, _LARGEST_STEP, _PATIENCE = 2, 10.0, 1e5, 100
#: Ipopt's return codes for a solve that reached its time limit, and for one that diverged.
TIME_LIMIT_CODE, DIVERGED_CODE = -5, 4
# Ipopt's return code for insufficient memory.
_NO_MEMORY = -102


def run(
    program: NonlinearProgram,
    bounds: Bounds,
    scaling: Scaling,
    start: FloatArray,
    *,
    options: SolverOptions,
    multipliers: Multipliers | None = None,
    progress: Progress | None = None,
) -> IpoptResult:
    """Solve a nonlinear program by Ipopt from the point `start`, warm if `multipliers` are given.

    If `progress` returns False, or after a KeyboardInterrupt, the status is `INTERRUPTED`. Any
    other exception in a callback is raised after Ipopt has returned.

    Raises
    ------
    TranscriptionError
        If Ipopt refuses an option, or cannot load the linear solver.
    MemoryError
        If Ipopt ran out of memory.
    """
    idle = bounds.surplus + 1
    if idle > 0:
        result = run(
            _with_idle_unknowns(program, start.size, idle, 1.0 / scaling.objective),
            bounds.extended(unknowns=(np.full(idle, -np.inf), np.full(idle, np.inf))),
            scaling.extended(unknowns=idle),
            np.append(start, np.zeros(idle)),
            options=options,
            multipliers=multipliers and multipliers.extended(unknowns=idle),
            progress=progress,
        )
        return result.part(slice(start.size), slice(None))
    sign = -1.0 if program.is_negated else 1.0
    callbacks = _Callbacks(program, progress, sign, floor=_BOTTOMLESS / scaling.objective)
    problem = cyipopt.Problem(
        n=start.size,
        m=program.n_rows,
        problem_obj=callbacks,
        lb=bounds.lower,
        ub=bounds.upper,
        cl=bounds.row_lower,
        cu=bounds.row_upper,
    )
    _set_options(problem, options, is_warm=multipliers is not None)
    problem.set_problem_scaling(scaling.objective, scaling.unknowns, scaling.rows)
    dual = {}
    if multipliers is not None:
        dual = {"lagrange": multipliers.rows, "zl": multipliers.lower, "zu": multipliers.upper}
    z, info = problem.solve(np.array(start), **dual)
    wall = time.perf_counter() - callbacks.started
    stopped = isinstance(callbacks.error, KeyboardInterrupt)
    if callbacks.error is not None and not stopped:
        raise callbacks.error
    if callbacks.is_bottomless:
        info["status"] = DIVERGED_CODE
    return _result(callbacks, np.asarray(z), info, wall, stopped=stopped)


def _with_idle_unknowns(
    program: NonlinearProgram, own: int, idle: int, weight: float
) -> ExtendedProgram:
    """Return a program with `idle` unknowns added to the `own` unknowns of `program`.

    Each added unknown s appears only in the objective, as ``weight / 2 * s**2``. The optimum is
    therefore unchanged.
    """
    # With the added unknowns, the program has more unknowns than equations.
    # If a program has as many equations as free unknowns, Ipopt ignores the objective, and stops at
    # the first point that satisfies the equations. With more equations, it refuses the program.
    # Neither is right if some equations are redundant, such as an end condition on a conserved
    # quantity: many points may satisfy them, and the objective selects the best.
    return ExtendedProgram(
        program=program,
        prices=np.zeros(idle),
        columns=own + np.arange(idle),
        weights=np.full(idle, weight),
        near=np.zeros(idle),
    )


def barrier_gap(
    program: NonlinearProgram, bounds: Bounds, z: FloatArray, multipliers: Multipliers
) -> float:
    """Return the complementarity gap: the sum of multiplier times slack over all inequalities.

    The gap has the unit of the objective. For a convex program, the objective at `z` exceeds the
    optimum by at most the gap: docs/theory/refinement.md, eq. (16).
    """
    rows, pull = program.constraints(z), multipliers.rows
    parts = (
        (multipliers.lower, z - bounds.lower),
        (multipliers.upper, bounds.upper - z),
        (np.maximum(-pull, 0.0), rows - bounds.row_lower),
        (np.maximum(pull, 0.0), bounds.row_upper - rows),
    )
    return float(sum(weights[s < _FAR] @ np.abs(s[s < _FAR]) for weights, s in parts))


def run_past_the_barrier(
    program: NonlinearProgram,
    bounds: Bounds,
    scaling: Scaling,
    start: FloatArray,
    *,
    size: Callable[[FloatArray], float],
    options: SolverOptions,
    multipliers: Multipliers | None = None,
    progress: Progress | None = None,
) -> IpoptResult:
    """Solve a program by Ipopt, and repeat the solve until `barrier_gap` is negligible.

    At most two repetitions continue from the last solution, with a larger scaling factor of the
    objective. `size` maps the unknowns to the magnitude of the objective. The solve is repeated in
    two cases:

    - The gap exceeds ``1e3 * size(z)`` times Ipopt's tolerance.
    - ``size(z)`` times the scaling factor of the objective is less than 1e-6.

    If a repetition fails, the previous result is returned.
    """
    solve = partial(run, program, bounds, progress=progress)
    result = solve(scaling, start, options=options, multipliers=multipliers)
    share = _GAP_SHARE * (options.tolerance or _TOLERANCE)
    fewer = options.at_most(_PATIENCE)
    factor = scaling.objective
    # Ipopt tests convergence on the scaled objective. An objective that is steep at the initial
    # point has a very small factor. Ipopt may then stop at a gap that exceeds the objective itself.
    for _ in range(_SHARPENINGS):
        if not result.is_converged:
            break
        own = max(size(result.z), _LEAST / scaling.objective)
        gap = barrier_gap(program, bounds, result.z, result.multipliers)
        excess = max(gap / (share * own), SEEN / (own * factor))
        if excess <= 1.0:
            break
        # With a larger factor on the objective, Ipopt ends at a smaller gap.
        factor *= min(_AIMED * excess, _LARGEST_STEP)
        steeper = replace(scaling, objective=factor)
        sharper = solve(steeper, result.z, options=fewer, multipliers=result.multipliers)
        if not sharper.is_converged:
            break
        result = sharper.after(result)
    return result


def _set_options(problem: Any, options: SolverOptions, *, is_warm: bool) -> None:
    """Pass options to Ipopt: defaults, settings for a warm or cold start, the caller's options.

    If Ipopt refuses an option, or cannot load the linear solver that an option names, a
    `TranscriptionError` is raised.
    """
    chosen = _DEFAULTS | {
        "tol": options.tolerance or _TOLERANCE,
        "max_iter": options.max_iterations,
    }
    chosen |= _WARM if is_warm else dict(options.cold)
    refuse_absent_solver(dict(options.extra))
    for name, value in (chosen | dict(options.extra)).items():
        try:
            problem.add_option(name, value)
        except TypeError as error:
            raise TranscriptionError(
                f"options: Ipopt does not take {name} = {value!r}; its options are listed at "
                "https://coin-or.github.io/Ipopt/OPTIONS.html."
            ) from error


def _result(
    callbacks: _Callbacks, z: FloatArray, info: dict[str, Any], wall: float, *, stopped: bool
) -> IpoptResult:
    """Return the outcome of Ipopt as an `IpoptResult`.

    After a failed or interrupted solve, the result has the best recorded iterate, unless the
    iterates diverged.
    """
    code = _STOPPED if stopped else int(info["status"])
    if code == _NO_MEMORY:
        raise MemoryError("Ipopt: not enough memory for the matrices of this mesh")
    status = {
        _SOLVED: Status.CONVERGED,
        _INFEASIBLE: Status.INFEASIBLE,
        _STOPPED: Status.INTERRUPTED,
    }.get(code, Status.NOT_CONVERGED)
    if status is not Status.CONVERGED and code != DIVERGED_CODE and callbacks.best[1] is not None:
        z = callbacks.best[1]
    message = info["status_msg"]
    return IpoptResult(
        status=status,
        code=code,
        message=message.decode() if isinstance(message, bytes) else str(message),
        z=z,
        multipliers=Multipliers(
            rows=np.array(info["mult_g"]),
            lower=np.array(info["mult_x_L"]),
            upper=np.array(info["mult_x_U"]),
        ),
        iterations=callbacks.history[-1].iteration if callbacks.history else 0,
        history=tuple(callbacks.history),
        wall_s=wall,
    )
