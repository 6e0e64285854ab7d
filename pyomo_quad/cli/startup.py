"""The start of a process that runs one command and that nothing else shares.

As a library the package leaves the process as it is.  The command owns its process, and saves about
a second there: see `own_process` and `import_scipy_alone`.
"""

import gc
import importlib
import os
import sys

# New objects between two searches for reference cycles. At Python's default of 700 the searches
# during imports take a tenth of the time of a whole command. A run makes fewer objects than this.
_MANY = 1_000_000
_PYOMO_WATCHERS = "pyomo.common.dependencies"
_is_own = False


def own_process() -> None:
    """Set the number of threads and the pace of garbage collection for one command."""
    global _is_own  # noqa: PLW0603  a fact about the process
    _is_own = True
    # BLAS threads take more processor time from other flights than they save on small matrices.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    gc.set_threshold(_MANY, *gc.get_threshold()[1:])


def import_scipy_alone() -> None:
    """Keep Pyomo from importing `scipy.stats` and `matplotlib.pyplot`, half a second each.

    Pyomo watches for the first import of SciPy and of matplotlib, and completes each with modules
    that it may need later.  This drops the watchers, once NumPy's has run; Pyomo still imports
    either library where it makes use of it.  A process that others share is left alone.
    """
    if _is_own and _PYOMO_WATCHERS not in sys.modules and "scipy" not in sys.modules:
        importlib.import_module("numpy")
        importlib.import_module(_PYOMO_WATCHERS)
        sys.meta_path[:] = [
            finder for finder in sys.meta_path if type(finder).__module__ != _PYOMO_WATCHERS
        ]
