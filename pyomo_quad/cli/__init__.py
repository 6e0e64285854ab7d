"""The command line, which catches signals before it imports the commands."""

from collections.abc import Sequence

from pyomo_quad.cli.endings import end_on_signals, leave
from pyomo_quad.cli.startup import own_process

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command."""
    if arguments is None:
        end_on_signals()
        own_process()
    from pyomo_quad.cli import commands  # noqa: PLC0415  after signals are caught

    status = commands.main(arguments)
    return status if arguments is not None else leave(status)
