"""Where text goes: results to standard output, progress and errors to standard error."""

import errno
import os
import sys

from rich.console import Console

__all__ = [
    "claim_streams",
    "complain",
    "error_console",
    "gives_up_output",
    "result_console",
]

_LOST = (errno.EPIPE, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF)
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
    try:
        print(" ".join(message.split()), file=sys.stderr, flush=True)
    except OSError:
        _send_to_nowhere(2)  # nobody is left to complain to


def claim_streams() -> bool:
    """Make the standard streams of this process safe to write to.

    Returns
    -------
    bool
        Whether there is a standard output at all.
    """
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            # Else the next file to be opened, a report perhaps, would get what is printed.
            os.open(os.devnull, os.O_RDWR)
    has_output = sys.stdout is not None
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123, SIM115
        getattr(sys, name).reconfigure(errors="backslashreplace")
    return has_output


def gives_up_output(error: OSError) -> bool:
    """Say whether an error is one of writing to standard output, and if so write no more to it.

    Parameters
    ----------
    error : OSError
        One of a file names the file.

    Returns
    -------
    bool
        Whether what was printed is lost.
    """
    if error.filename is not None or error.errno not in _LOST:
        return False
    _send_to_nowhere(1)  # Python itself flushes once more at the end
    return True


def _send_to_nowhere(descriptor: int) -> None:
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, descriptor)
    os.close(nowhere)
