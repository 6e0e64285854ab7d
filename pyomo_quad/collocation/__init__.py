"""Flipped-Radau collocation of any Pyomo.DAE model, solved with Ipopt.

`solve` transcribes and solves a model in a single call. `compile` translates a model into CasADi
functions, and returns a problem. The problem's method `solve` can be called repeatedly, with other
parameter values, horizons and meshes, without another compilation.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pyomo_quad.collocation.closed_loop import ClosedLoop, Law
from pyomo_quad.collocation.diagnosis import ActiveLimit, Diagnosis, Relaxation, Residual, diagnose
from pyomo_quad.collocation.dynamics import Dynamics, Instants, split_algebraics
from pyomo_quad.collocation.enclosure import Enclosure, symbols
from pyomo_quad.collocation.errors import EngineError, SolveError, TranscriptionError
from pyomo_quad.collocation.joint import JointProblem, JointSolution, compiled_of
from pyomo_quad.collocation.limits import Violation
from pyomo_quad.collocation.mesh import (
    Mesh,
    Summarised,
    Timeline,
    Trajectory,
    control_polynomial,
    interpolate,
    interpolate_rates,
    real_array,
)
from pyomo_quad.collocation.open_loop import OpenLoopSteps
from pyomo_quad.collocation.problem import Problem
from pyomo_quad.collocation.program.ipopt import Iteration, Progress, SolverOptions, Status
from pyomo_quad.collocation.pyomo_solver import PyomoSolver
from pyomo_quad.collocation.reading.clock import FreeTimes
from pyomo_quad.collocation.reading.schedules import Steps
from pyomo_quad.collocation.reading.tables import Table
from pyomo_quad.collocation.refining.error import Allowance
from pyomo_quad.collocation.refining.remeshing import RefinementOptions
from pyomo_quad.collocation.solution import MeshRecord, Solution
from pyomo_quad.collocation.starts import WarmStart
from pyomo_quad.collocation.stepping import SteppedFlights, SteppedLoops

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pyomo_quad.collocation.guess import Guess
    from pyomo_quad.collocation.reading.values import Overrides

__all__ = [
    "ActiveLimit",
    "Allowance",
    "ClosedLoop",
    "Diagnosis",
    "Dynamics",
    "Enclosure",
    "EngineError",
    "FreeTimes",
    "Instants",
    "Iteration",
    "JointProblem",
    "JointSolution",
    "Law",
    "Mesh",
    "MeshRecord",
    "OpenLoopSteps",
    "Problem",
    "Progress",
    "PyomoSolver",
    "RefinementOptions",
    "Relaxation",
    "Residual",
    "Solution",
    "SolveError",
    "SolverOptions",
    "Status",
    "SteppedFlights",
    "SteppedLoops",
    "Steps",
    "Summarised",
    "Table",
    "Timeline",
    "Trajectory",
    "TranscriptionError",
    "Violation",
    "WarmStart",
    "compile",
    "control_polynomial",
    "diagnose",
    "interpolate",
    "interpolate_rates",
    "real_array",
    "solve",
    "split_algebraics",
    "symbols",
]


def __dir__() -> list[str]:
    return sorted(__all__)


def compile(  # noqa: A001  as casadi, re and builtins do
    model: Any, *, final_time: Any = None, times: FreeTimes | None = None
) -> Any:
    """Compile a Pyomo.DAE model for repeated solves by collocation.

    Parameters
    ----------
    model : ConcreteModel
        Model whose continuous sets are not discretised. It may have no continuous set, one or
        several.
    final_time : Var, optional
        Static variable (a variable without time) that is the free end of the horizon. Only for a
        model with one continuous set.
    times : mapping, optional
        Physical times that the solve determines. For example, {1.0: m.T1} makes the static variable
        `m.T1` the physical time of all conditions declared at 1.0 in the continuous set. With
        several continuous sets: a mapping from the name of each set to such a mapping.

    Returns
    -------
    Problem or JointProblem
        `JointProblem` for a model with several continuous sets, each of which has its own horizon;
        otherwise `Problem`.

    Raises
    ------
    TranscriptionError
        If a component of the model is incomplete or unsupported, or if `final_time` or `times` is
        invalid. The message names the component.

    Examples
    --------
    Compile and solve the model `m` of the example of `solve`:

    >>> problem = compile(m)
    >>> round(problem.solve(tolerance=1e-8).objective, 6)
    1.0
    """
    return compiled_of(model, final_time, times)


def solve(
    model: Any,
    *,
    final_time: Any = None,
    times: FreeTimes | None = None,
    mesh: Mesh | Mapping[str, Mesh] | None = None,
    tolerance: float | None = None,
    parameters: Overrides | None = None,
    horizon: tuple[float, float] | None = None,
    guess: Guess | None = None,
    warm_start: Solution | WarmStart | JointSolution | tuple[WarmStart, ...] | None = None,
    options: SolverOptions | None = None,
    refinement: RefinementOptions | None = None,
    starts: int = 1,
    progress: Progress | None = None,
) -> Solution | JointSolution:
    """Compile and solve a Pyomo.DAE model, and load the solution into the model.

    Variables over time receive values at the members of the continuous sets. A failed solve raises
    no exception: its result is loaded, too, and its status shows the failure.

    Parameters
    ----------
    model : ConcreteModel
        Model whose continuous sets are not discretised. It may have no continuous set, one or
        several.
    final_time : Var, optional
        Static variable (a variable without time) that is the free end of the horizon. Only for a
        model with one continuous set.
    times : mapping, optional
        Physical times that the solve determines. For example, {1.0: m.T1} makes the static variable
        `m.T1` the physical time of all conditions declared at 1.0 in the continuous set. With
        several continuous sets: a mapping from the name of each set to such a mapping.
    mesh : Mesh or mapping, optional
        Mesh of the solve; only the initial mesh if a `tolerance` is given. By default, that of the
        warm start, or `first_mesh` of `refinement`. With several continuous sets: one mesh for all,
        or a mapping from their names to meshes.
    tolerance : float, optional
        Required relative error of the states, for which the mesh is refined. The default is 1e-6 if
        no mesh is given; a given mesh is by default not refined.
    parameters : mapping, optional
        New values of mutable parameters. A key is a parameter or its full name. The value of a
        parameter over time is a function of time.
    horizon : (float, float), optional
        Start and end of the horizon, in place of the ends of the continuous set. Not supported for
        several continuous sets.
    guess : mapping, optional
        Initial values by the name of a variable: a function of time, a constant, or an array of
        samples. The key "time" gives the times of the samples. With several continuous sets, the
        name of a set maps to a guess for the variables over this set.
    warm_start : Solution, WarmStart, JointSolution or tuple of WarmStart, optional
        Solution of the same model on any mesh, from which the solve starts. For a model with
        several continuous sets: a `JointSolution`, or a tuple of `WarmStart`.
    options : SolverOptions, optional
        Settings of Ipopt.
    refinement : RefinementOptions, optional
        Settings of the mesh refinement.
    starts : int, default 1
        Number of initial points on the first mesh; the best optimum is kept. All but one point are
        random between the bounds, drawn with fixed seeds. Must be 1 for several continuous sets.
    progress : callable, optional
        Called at each iteration of Ipopt with an `Iteration`; returning False stops the solve.

    Returns
    -------
    Solution or JointSolution
        `JointSolution` for a model with several continuous sets, otherwise `Solution`.

    Raises
    ------
    TranscriptionError
        If the model or an argument cannot be used; the message names the component or argument.

    Examples
    --------
    Move a point by 1 m in 1 s so that the integral of its squared speed is least:

    >>> from pyomo.dae import ContinuousSet, DerivativeVar, Integral
    >>> from pyomo.environ import ConcreteModel, Constraint, Objective, Var
    >>> m = ConcreteModel()
    >>> m.t = ContinuousSet(bounds=(0, 1))
    >>> m.x, m.u = Var(m.t), Var(m.t)
    >>> m.dx_dt = DerivativeVar(m.x, wrt=m.t)
    >>> m.motion = Constraint(m.t, rule=lambda m, t: m.dx_dt[t] == m.u[t])
    >>> m.x[0].fix(0)
    >>> m.x[1].fix(1)
    >>> m.effort = Integral(m.t, rule=lambda m, t: m.u[t] ** 2)
    >>> m.cost = Objective(expr=m.effort)
    >>> solution = solve(m)
    >>> round(solution.objective, 6)
    1.0
    """
    problem = compiled_of(model, final_time, times)
    solution: Solution | JointSolution = problem.solve(
        mesh=mesh,
        tolerance=tolerance,
        parameters=parameters,
        horizon=horizon,
        guess=guess,
        warm_start=warm_start,
        options=options,
        refinement=refinement,
        starts=starts,
        progress=progress,
    )
    problem.load(solution)
    return solution
