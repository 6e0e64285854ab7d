"""The command line; importing it imports next to nothing, so that signals are heeded at once."""

import gc
import os
from collections.abc import Sequence

from pyomo_quad.cli.endings import end_on_signals, leave

__all__ = ["main"]

# New objects before Python looks for cycles to break: by its own count of 700 it looks at all that
# the imports make again and again, a tenth of the time of a whole command. A run makes fewer.
_MANY = 1_000_000


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command."""
    if arguments is None:
        # Of what is solved here, threads of BLAS take more of the processors than they give.
        os.environ.setdefault("OMP_NUM_THREADS", "1")
        end_on_signals()
        gc.set_threshold(_MANY, *gc.get_threshold()[1:])
    from pyomo_quad.cli import commands  # noqa: PLC0415  after signals are caught

    status = commands.main(arguments)
    return status if arguments is not None else leave(status)
