"""Flipped-Radau collocation of any Pyomo.DAE model, solved with Ipopt.

The front door is `solve`; `compile` returns a problem that can be solved again with other
parameters, horizons and meshes without being built again.
"""

from typing import Any

from pyomo_quad.collocation.diagnosis import ActiveLimit, Diagnosis, Relaxation, Residual, diagnose
from pyomo_quad.collocation.dynamics import (
    ClosedLoop,
    Dynamics,
    Instants,
    Law,
    Violation,
    split_algebraics,
)
from pyomo_quad.collocation.enclosure import Enclosure, symbols
from pyomo_quad.collocation.errors import EngineError, SolveError, TranscriptionError
from pyomo_quad.collocation.guess import WarmStart
from pyomo_quad.collocation.joint import JointProblem, JointSolution, compiled_of
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
from pyomo_quad.collocation.problem import Problem
from pyomo_quad.collocation.program.ipopt import Iteration, Progress, SolverOptions, Status
from pyomo_quad.collocation.pyomo_solver import PyomoSolver
from pyomo_quad.collocation.reading.copy import FreeTimes
from pyomo_quad.collocation.reading.tables import Table
from pyomo_quad.collocation.refining.error import Allowance
from pyomo_quad.collocation.refining.remeshing import RefinementOptions
from pyomo_quad.collocation.solution import MeshRecord, Solution

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


def compile(  # noqa: A001  as casadi, re and builtins do
    model: Any, *, final_time: Any = None, times: FreeTimes | None = None
) -> Any:
    """Compile a Pyomo.DAE model to a `Problem`, or one of several horizons to a `JointProblem`."""
    return compiled_of(model, final_time, times)


def solve(
    model: Any,
    *,
    final_time: Any = None,
    times: FreeTimes | None = None,
    **arguments: Any,
) -> Any:
    """Compile and solve a Pyomo.DAE model; the arguments are those of `Problem.solve`.

    The solution's values are also loaded into the model, at the times it declares.
    """
    problem = compiled_of(model, final_time, times)
    solution = problem.solve(**arguments)
    problem.load(solution)
    return solution
