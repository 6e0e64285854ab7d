"""What the exit status of a command means."""

from enum import IntEnum

__all__ = ["ExitCode"]


class ExitCode(IntEnum):
    """Exit status of `pyomo-quad`."""

    VERIFIED = 0
    FAULT = 1  # the disk, the system or a bug
    BAD_INPUT = 2
    NOT_SOLVED = 3  # infeasible or not converged
    NOT_VERIFIED = 4
    INTERRUPTED = 130  # by Ctrl-C, as shells report it, or by SIGTERM
