"""Faster start of a process that runs a single command.

`own_process` limits threads and garbage collection. `import_scipy_alone` avoids slow imports.
Together they save about a second. Both change settings of the whole process. Call `own_process`
only in a process that runs nothing but one command. Without it, `import_scipy_alone` does nothing.
"""

import gc
import importlib
import os
import sys

# Number of new objects after which Python searches for reference cycles. With the default of 700,
# the searches during imports take a tenth of a command's time. A run makes fewer objects than this.
_MANY = 1_000_000
_PYOMO_WATCHERS = "pyomo.common.dependencies"
_is_own = False


def own_process() -> None:
    """Make the process of a command faster: one BLAS thread, rare garbage collection.

    Call the function before NumPy is imported. If an environment variable already sets the number
    of BLAS threads, that number is kept.
    """
    global _is_own  # noqa: PLW0603  a fact about the process
    _is_own = True
    # On small matrices, BLAS threads save little and take processor time from parallel flights.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    gc.set_threshold(_MANY, *gc.get_threshold()[1:])


def import_scipy_alone() -> None:
    """Remove the import hooks of Pyomo that make the import of SciPy and matplotlib slow.

    The function acts only if `own_process` was called before, and neither Pyomo nor SciPy has been
    imported yet.
    """
    # At the first import of SciPy or matplotlib, the hooks import modules that Pyomo may need
    # later. They take half a second for each of the two libraries. Without the hooks, Pyomo
    # imports these modules when it first uses them.
    if _is_own and _PYOMO_WATCHERS not in sys.modules and "scipy" not in sys.modules:
        # Pyomo's hook for NumPy must still act, so NumPy is imported before the hooks are removed.
        importlib.import_module("numpy")
        importlib.import_module(_PYOMO_WATCHERS)
        sys.meta_path[:] = [
            finder for finder in sys.meta_path if type(finder).__module__ != _PYOMO_WATCHERS
        ]
