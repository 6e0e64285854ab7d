"""The engine as a Pyomo solver: ``SolverFactory("pyomo_quad").solve(model)``.

It takes a continuous model, one that `pyomo.dae` has discretised already, and one without
time: a plain nonlinear program.
"""

from __future__ import annotations

import sys
from typing import Any, Self

from pyomo.opt import (
    ProblemSense,
    SolverFactory,
    SolverResults,
    SolverStatus,
    TerminationCondition,
)

from pyomo_quad.collocation.problem import Problem
from pyomo_quad.collocation.program.ipopt import Iteration, SolverOptions, Status

_TERMINATION = {
    Status.CONVERGED: (SolverStatus.ok, TerminationCondition.optimal),
    Status.INFEASIBLE: (SolverStatus.warning, TerminationCondition.infeasible),
    Status.NOT_CONVERGED: (SolverStatus.warning, TerminationCondition.unknown),
    Status.TOLERANCE_NOT_MET: (SolverStatus.warning, TerminationCondition.other),
    Status.INTERRUPTED: (SolverStatus.aborted, TerminationCondition.userInterrupt),
}


@SolverFactory.register(
    "pyomo_quad", doc="Flipped-Radau collocation with mesh refinement, solved with Ipopt"
)
class PyomoSolver:
    """Pyomo's solver interface to the engine.

    Parameters
    ----------
    **options
        Ipopt options, which `options` of `solve` adds to.
    """

    def __init__(self, **options: Any) -> None:
        options.pop("solver_io", None)
        self.options: dict[str, Any] = options

    @staticmethod
    def available(*, exception_flag: bool = False) -> bool:
        """Return True: Ipopt comes with the package's dependencies."""
        del exception_flag
        return True

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        return

    def solve(
        self,
        model: Any,
        *,
        tee: bool = False,
        options: dict[str, Any] | None = None,
        load_solutions: bool = True,
        final_time: Any = None,
        **arguments: Any,
    ) -> SolverResults:
        """Solve a model and load the solution into it.

        Parameters
        ----------
        model : ConcreteModel
        tee : bool, optional
            Print a line for each iteration.
        options : dict, optional
            Ipopt options by name.
        load_solutions : bool, optional
            Whether the variables of the model take the solution's values.
        final_time : Var, optional
            See `Problem`.
        **arguments
            See `Problem.solve`: `tolerance`, `mesh`, `guess` and so on.

        Returns
        -------
        SolverResults
            As every Pyomo solver returns; `assert_optimal_termination` understands it.  Its
            `solution_on_mesh` is the engine's `Solution`.

        Raises
        ------
        TranscriptionError
            If the model declares something incomplete or unsupported.
        """
        settings = SolverOptions(extra=tuple({**self.options, **(options or {})}.items()))
        problem = Problem(model, final_time)
        solution = problem.solve(
            options=settings, progress=_print_iteration if tee else None, **arguments
        )
        if load_solutions:
            problem.load(solution)
        results = SolverResults()
        results.solver.name = "pyomo_quad"
        results.solver.status, results.solver.termination_condition = _TERMINATION[solution.status]
        results.solver.message = solution.message
        results.solver.wallclock_time = solution.wall_s
        results.problem.number_of_variables = solution.unknowns.size
        results.problem.number_of_constraints = solution.program.n_rows
        is_maximised = problem.compiled.declared.maximise
        results.problem.sense = ProblemSense.maximize if is_maximised else ProblemSense.minimize
        if is_maximised:
            results.problem.lower_bound = solution.objective
        else:
            results.problem.upper_bound = solution.objective
        results.solution_on_mesh = solution
        return results


def _print_iteration(line: Iteration) -> None:
    sys.stdout.write(
        f"{line.iteration:5d}  objective {line.objective:.8e}  "
        f"infeasibility {line.infeasibility:.2e}  dual {line.dual_infeasibility:.2e}\n"
    )
