"""Faster start of a process that runs a single command.

The functions change settings of the whole process. This is only permitted in a process that runs
nothing but a command. `own_process` limits threads and garbage collection. `import_scipy_alone`
avoids slow imports. Together they save about a second.
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

    If the user has set the number of BLAS threads by an environment variable, the number is not
    changed.
    """
    global _is_own  # noqa: PLW0603  a fact about the process
    _is_own = True
    # On small matrices, BLAS threads save little and take processor time from parallel flights.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    gc.set_threshold(_MANY, *gc.get_threshold()[1:])


def import_scipy_alone() -> None:
    """Prevent Pyomo from importing further slow modules when SciPy or matplotlib is imported.

    When SciPy or matplotlib is first imported, import hooks of Pyomo import further modules that
    Pyomo may need later. This takes half a second each for SciPy and matplotlib. The function
    removes the hooks. Pyomo then imports the further modules only when it uses them. The hook for
    NumPy still takes effect, because the function imports NumPy and Pyomo's hooks first.

    In a process that also runs other code, such as tests, the function does nothing.
    """
    if _is_own and _PYOMO_WATCHERS not in sys.modules and "scipy" not in sys.modules:
        importlib.import_module("numpy")
        importlib.import_module(_PYOMO_WATCHERS)
        sys.meta_path[:] = [
            finder for finder in sys.meta_path if type(finder).__module__ != _PYOMO_WATCHERS
        ]
