"""Where text goes: results to standard output, progress and errors to standard error."""

import sys

from rich.console import Console

__all__ = ["complain", "error_console", "result_console"]

_WIDTH_WITHOUT_TERMINAL = 140


def result_console() -> Console:
    """Return a console on standard output, wide enough for tables in a pipe.

    Returns
    -------
    Console
        Made anew, so that it writes to the present standard output.
    """
    width = None if sys.stdout.isatty() else _WIDTH_WITHOUT_TERMINAL
    return Console(width=width, highlight=False)


def error_console() -> Console:
    """Return a console on standard error.

    Returns
    -------
    Console
        Made anew, so that it writes to the present standard error.
    """
    return Console(stderr=True, highlight=False)


def complain(message: str) -> None:
    """Write one line to standard error.

    Parameters
    ----------
    message : str
        Line breaks in it become spaces.
    """
    print(" ".join(message.split()), file=sys.stderr)
