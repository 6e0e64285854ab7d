"""Start of a process that runs a single command.

As a library, the package leaves the process unchanged. The command owns its process and saves about
a second with `own_process` and `import_scipy_alone`.
"""

import gc
import importlib
import os
import sys

# New objects between two searches for reference cycles. With Python's default of 700, the searches
# during imports take a tenth of a command's time. A run makes fewer objects than this.
_MANY = 1_000_000
_PYOMO_WATCHERS = "pyomo.common.dependencies"
_is_own = False


def own_process() -> None:
    """Set threads and garbage collection for a process that runs one command."""
    global _is_own  # noqa: PLW0603  a fact about the process
    _is_own = True
    # On small matrices, BLAS threads cost other flights more processor time than they save.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    gc.set_threshold(_MANY, *gc.get_threshold()[1:])


def import_scipy_alone() -> None:
    """Import SciPy without slow modules that Pyomo would pull in (half a second each).

    At the first import of SciPy and of matplotlib, Pyomo imports further modules that it may need
    later. This function removes these import hooks after that of NumPy has run; Pyomo still imports
    either library when it uses it. A shared process is left unchanged.
    """
    if _is_own and _PYOMO_WATCHERS not in sys.modules and "scipy" not in sys.modules:
        importlib.import_module("numpy")
        importlib.import_module(_PYOMO_WATCHERS)
        sys.meta_path[:] = [
            finder for finder in sys.meta_path if type(finder).__module__ != _PYOMO_WATCHERS
        ]
