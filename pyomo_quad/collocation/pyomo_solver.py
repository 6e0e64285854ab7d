"""Pyomo solver for optimal control problems: ``SolverFactory("pyomo_quad").solve(model)``.

The solver accepts a continuous model, a model that `pyomo.dae` has already discretised, and a model
without time. A continuous model is transcribed by Radau collocation with mesh refinement. Ipopt
solves the nonlinear programs.
"""

from __future__ import annotations

import sys
from contextlib import ExitStack
from inspect import signature
from pathlib import Path
from tempfile import mkstemp
from typing import TYPE_CHECKING, Any, Self
from weakref import WeakKeyDictionary

from pyomo.common.collections import Bunch
from pyomo.opt import (
    ProblemSense,
    SolverFactory,
    SolverResults,
    SolverStatus,
    TerminationCondition,
)

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.joint import compiled_of
from pyomo_quad.collocation.program.ipopt import Iteration, SolverOptions, Status

if TYPE_CHECKING:
    from collections.abc import Callable

    from pyomo_quad.collocation.joint import JointProblem, JointSolution
    from pyomo_quad.collocation.problem import Problem
    from pyomo_quad.collocation.reading.clock import FreeTimes
    from pyomo_quad.collocation.solution import Solution
    from pyomo_quad.collocation.starts import WarmStart

_TERMINATION = {
    Status.CONVERGED: (SolverStatus.ok, TerminationCondition.optimal),
    Status.INFEASIBLE: (SolverStatus.warning, TerminationCondition.infeasible),
    Status.NOT_CONVERGED: (SolverStatus.warning, TerminationCondition.unknown),
    Status.TOLERANCE_NOT_MET: (SolverStatus.warning, TerminationCondition.other),
    Status.INTERRUPTED: (SolverStatus.aborted, TerminationCondition.userInterrupt),
}
# Solver status and termination condition for Ipopt's return codes of failed solves.
_BY_CODE = {
    -1: (SolverStatus.warning, TerminationCondition.maxIterations),
    -4: (SolverStatus.aborted, TerminationCondition.maxTimeLimit),
    -5: (SolverStatus.aborted, TerminationCondition.maxTimeLimit),
    4: (SolverStatus.warning, TerminationCondition.unbounded),
}


@SolverFactory.register(
    "pyomo_quad", doc="Flipped-Radau collocation with mesh refinement, solved with Ipopt"
)
class PyomoSolver:
    """Pyomo's solver interface to this package's Radau collocation with mesh refinement and Ipopt.

    Parameters
    ----------
    **options
        Options of Ipopt for all solves, by name or as a dictionary named `options`. The argument
        `options` of `solve` overrides them for a single solve. The name `solver_io` is ignored.
    """

    def __init__(self, **options: Any) -> None:
        options.pop("solver_io", None)
        self.options = Bunch(**{**options.pop("options", {}), **options})
        self._last: WeakKeyDictionary[Any, WarmStart | tuple[WarmStart, ...]] = WeakKeyDictionary()

    @staticmethod
    def available(exception_flag: bool = False) -> bool:
        """Return True, as the solver is always available: Ipopt is a dependency of the package.

        Parameters
        ----------
        exception_flag : bool, default False
            Part of Pyomo's interface; without effect.
        """
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
        logfile: str | Path | None = None,
        keepfiles: bool = False,
        timelimit: float | None = None,
        warmstart: bool = False,
        options: dict[str, Any] | None = None,
        load_solutions: bool = True,
        symbolic_solver_labels: bool = True,
        final_time: Any = None,
        times: FreeTimes | None = None,
        **arguments: Any,
    ) -> SolverResults:
        """Solve a model and load the solution into it.

        Parameters
        ----------
        model : ConcreteModel
        tee : bool, optional
            Print a line for each iteration of Ipopt.
        logfile : str or Path, optional
            File to which a line for each iteration is written.
        keepfiles : bool, optional
            If no `logfile` is given, write the lines to a temporary file and print the file's name.
        timelimit : float, optional
            Wall-clock time limit [s] for all meshes together. Without it, the Ipopt option
            `max_wall_time` is this limit.
        warmstart : bool, optional
            Start from trajectory and multipliers of this solver's last converged solve of the
            model. By default, start from the values of the model's variables.
        options : dict, optional
            Ipopt options by name.
        load_solutions : bool, optional
            Load the values of variables and integrals into the model, also after a failed solve.
        symbolic_solver_labels : bool, optional
            Ignored: messages always name the model's components.
        final_time : Var, optional
            Static variable (variable without time) that is the free end of the horizon, for a model
            with one continuous set.
        times : mapping, optional
            Static variables that are free times, by member of the continuous set. With {1.0: m.T1},
            conditions declared at 1.0 hold at the physical time m.T1, which the solve determines.
            For several continuous sets: such mappings, by the name of the set.
        **arguments
            Further arguments of `Problem.solve`, such as `tolerance`, `mesh` and `guess`.

        Returns
        -------
        SolverResults
            Pyomo's usual result. Its attribute `solution_on_mesh` is a `Solution`, with
            trajectories and multipliers on the final mesh; for several continuous sets, a
            `JointSolution`.

        Raises
        ------
        TranscriptionError
            If the model's declarations are incomplete or unsupported, an argument is unknown, or
            the time limit is not positive.
        """
        del symbolic_solver_labels
        chosen = {**self.options, **(options or {})}
        limit = chosen.pop("max_wall_time", None) if timelimit is None else timelimit
        chosen.pop("max_wall_time", None)
        if limit is not None and not limit > 0.0:
            raise TranscriptionError(f"timelimit: {limit:g} s; must be above 0.")
        if warmstart and model in self._last:
            arguments.setdefault("warm_start", self._last[model])
        problem = compiled_of(model, final_time, times)
        _refuse_unknown(arguments, problem)
        with ExitStack() as files:
            writers = [sys.stdout.write] if tee else []
            if keepfiles and logfile is None:
                _, logfile = mkstemp(prefix="pyomo_quad_", suffix=".log")
                sys.stdout.write(f"Solver log file: '{logfile}'\n")
            if logfile is not None:
                file = files.enter_context(Path(logfile).open("w", encoding="utf-8"))
                writers.append(file.write)
            solution = problem.solve(
                options=SolverOptions(max_wall_s=limit, extra=tuple(chosen.items())),
                progress=_printed(writers) if writers else None,
                **arguments,
            )
        if load_solutions:
            problem.load(solution)
        if solution.is_converged:
            self._last[model] = solution.warm_start
        return _results(problem, solution)


def _refuse_unknown(arguments: dict[str, Any], problem: Problem | JointProblem) -> None:
    """Raise an error for a keyword argument that `PyomoSolver.solve` does not take.

    It takes its own arguments and, except `progress`, those of `problem.solve`. `problem` is the
    compiled Pyomo model.
    """
    known = {*signature(PyomoSolver.solve).parameters, *signature(problem.solve).parameters}
    # A caller may not give `progress`, because `PyomoSolver.solve` sets it to print the iterations.
    taken = known - {"self", "model", "arguments", "progress"}
    for name in arguments.keys() - taken:
        raise TranscriptionError(
            f"{name}: is no argument of solve, which takes {', '.join(sorted(taken))}."
        )


def _results(problem: Problem | JointProblem, solution: Solution | JointSolution) -> SolverResults:
    """Convert a solution to Pyomo's `SolverResults`, with Pyomo's termination condition."""
    results = SolverResults()
    results.solver.name = "pyomo_quad"
    ended = _TERMINATION[solution.status]
    if solution.status in (Status.NOT_CONVERGED, Status.INTERRUPTED):
        ended = _BY_CODE.get(solution.ipopt_code, ended)
    results.solver.status, results.solver.termination_condition = ended
    results.solver.message = solution.message
    results.solver.wallclock_time = solution.wall_s
    results.problem.number_of_variables, results.problem.number_of_constraints = solution.size
    is_maximised = problem.is_maximised
    results.problem.sense = ProblemSense.maximize if is_maximised else ProblemSense.minimize
    if is_maximised:
        results.problem.lower_bound = solution.objective
    else:
        results.problem.upper_bound = solution.objective
    results.solution_on_mesh = solution
    return results


def _printed(writers: list[Callable[[str], Any]]) -> Callable[[Iteration], None]:
    """Return a progress callback that passes a line of text for each iteration to all `writers`."""

    def write(line: Iteration) -> None:
        text = (
            f"{line.iteration:5d}  objective {line.objective:.8e}  "
            f"infeasibility {line.infeasibility:.2e}  dual {line.dual_infeasibility:.2e}\n"
        )
        for writer in writers:
            writer(text)

    return write
