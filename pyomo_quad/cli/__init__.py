"""Command line `pyomo-quad`.

The import of the commands takes up to a second. Handlers for signals such as Ctrl-C are therefore
installed first.
"""

from collections.abc import Sequence

from pyomo_quad.cli.endings import end_on_signals, leave
from pyomo_quad.cli.startup import own_process

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one `pyomo-quad` command.

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments of the command. By default the function reads the arguments of the process, lets
        signals such as Ctrl-C end the process, and calls `startup.own_process` to make the process
        faster.

    Returns
    -------
    int
        Exit status, a value of `ExitCode`.
    """
    if arguments is None:
        end_on_signals()
        own_process()
    from pyomo_quad.cli import commands  # noqa: PLC0415  after signals are caught

    status = commands.main(arguments)
    return status if arguments is not None else leave(status)
