"""A law that an optimum keeps by itself: without time in it, its Hamiltonian is constant."""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi
import numpy as np

from pyomo_quad.collocation.expressions import symbol_names

if TYPE_CHECKING:
    from pyomo_quad.collocation.declarations import Declarations
    from pyomo_quad.collocation.solution import Solution

__all__ = ["hamiltonian_warnings"]

# Root mean square deviation, as a share of the Hamiltonian's size, that is no longer rounding
# and mesh error.
_SUSPICIOUS = 1e-2


def hamiltonian_warnings(solution: Solution) -> tuple[str, ...]:
    """Return a warning if the Hamiltonian should be constant and is not.

    Parameters
    ----------
    solution : Solution
        Converged; a model that reads time is never warned of.

    Returns
    -------
    tuple of str
        Empty or one line.
    """
    declared = solution.problem.compiled.declared
    if not declared.states or _reads_time(declared):
        return ()
    held, weights = solution.costates.hamiltonian, solution.mesh.quadrature_weights
    mean = float(weights @ held)
    spread = float(np.sqrt(weights @ (held - mean) ** 2))
    start, end = solution.horizon
    size = abs(mean) + abs(solution.objective) / (end - start)
    if spread <= _SUSPICIOUS * size:
        return ()
    warning = (
        f"Hamiltonian: varies by {spread:.2g} about {mean:.4g} although nothing depends on time; "
        "solve to a tighter tolerance, or distrust the costates."
    )
    return (warning,)


def _reads_time(declared: Declarations) -> bool:
    parts = [part for e in declared.equations for part in (e.expression, e.lower, e.upper)]
    parts += [i.integrand for i in declared.integrals]
    read = symbol_names(casadi.vertcat(casadi.SX(0, 1), *parts))
    return declared.has_signals or declared.fraction.name() in read
