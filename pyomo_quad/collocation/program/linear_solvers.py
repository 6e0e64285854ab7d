"""Check that Ipopt can load the linear solver that its options name.

If Ipopt cannot load the solver, a solve of a model fails, or the whole process ends.
"""

from __future__ import annotations

import json
import subprocess
import sys
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from pyomo_quad.collocation.errors import TranscriptionError

if TYPE_CHECKING:
    from collections.abc import Mapping

#: The linear solver that Ipopt is built with, and the option that selects another.
OWN_SOLVER, OPTION = "mumps", "linear_solver"
# Options that give the path of a solver's library.
_LIBRARIES = ("hsllib", "pardisolib")
# Time limit of the separate process that tries a linear solver [s].
_TIMEOUT_S = 60.0

# Ipopt loads the library of a linear solver at the start of a solve. Without the library the solve
# fails, or the process crashes when Ipopt is released. Therefore a separate process tries it,
# minimising the square of one number.
_PROBE = """
import json, sys
import cyipopt, numpy
class Square:
    def objective(self, x): return float(x[0] ** 2)
    def gradient(self, x): return 2 * x
    def constraints(self, x): return x[:1]
    def jacobianstructure(self): return numpy.zeros(1, int), numpy.zeros(1, int)
    def jacobian(self, x): return numpy.ones(1)
    def hessianstructure(self): return numpy.zeros(1, int), numpy.zeros(1, int)
    def hessian(self, x, multipliers, factor): return numpy.array([2 * factor])
problem = cyipopt.Problem(n=1, m=1, problem_obj=Square(), lb=[-5], ub=[5], cl=[-5], cu=[5])
for name, value in {"print_level": 0, "sb": "yes", **json.loads(sys.argv[1])}.items():
    problem.add_option(name, value)
sys.exit(problem.solve(numpy.ones(1))[1]["status"] != 0)
"""


def refuse_absent_solver(options: Mapping[str, Any]) -> None:
    """Raise an error if Ipopt's options name a linear solver that Ipopt cannot load.

    `options` maps the names of Ipopt's options to their values. The default solver MUMPS is not
    checked.

    Raises
    ------
    TranscriptionError
        If Ipopt cannot load the solver; the message names it.
    """
    chosen = str(options.get(OPTION, OWN_SOLVER))
    asked = {name: options[name] for name in (OPTION, *_LIBRARIES) if name in options}
    if chosen != OWN_SOLVER and not _is_loaded(json.dumps(asked, sort_keys=True, default=str)):
        raise TranscriptionError(
            f"options: {OPTION} = {chosen!r}, which this Ipopt does not have or cannot load; leave "
            f"the option out for {OWN_SOLVER!r}, or name the library in one of the options "
            f"{' and '.join(_LIBRARIES)}."
        )


@lru_cache
def _is_loaded(options: str) -> bool:
    """Return whether Ipopt solves a small problem with the given options within 60 s.

    `options` is a JSON text of option names and values.
    """
    try:
        probe = subprocess.run(  # noqa: S603  our own interpreter and program
            [sys.executable, "-c", _PROBE, options],
            capture_output=True,
            check=False,
            timeout=_TIMEOUT_S,
        )
    except subprocess.TimeoutExpired:
        return False
    return probe.returncode == 0
