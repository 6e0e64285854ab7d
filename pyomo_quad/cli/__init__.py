"""Command line `pyomo-quad`.

Handlers for signals such as Ctrl-C are installed before the commands are imported, because the
imports take up to a second.
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
        Arguments of the command. By default the arguments of the process are read. In this case
        signals such as Ctrl-C end the process, and settings of the whole process that make a
        single command faster are changed by the function `startup.own_process`.

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
