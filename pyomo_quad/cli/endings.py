"""The end of a command: exit statuses, and the effect of Ctrl-C, SIGTERM and SIGHUP."""

import gc
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from enum import IntEnum
from types import FrameType
from typing import Any


class ExitCode(IntEnum):
    """Exit status of `pyomo-quad`."""

    VERIFIED = 0
    FAULT = 1  # the disk, the system or a bug
    BAD_INPUT = 2
    NOT_SOLVED = 3  # infeasible or not converged
    NOT_VERIFIED = 4
    RISK_NOT_HAD = 5  # a plan, but flights of it break limits more often than the risk allows
    INTERRUPTED = 130  # by Ctrl-C, as shells report it, by SIGTERM or by SIGHUP


_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_PATIENCE_S = 0.5  # a user who stops a command expects the prompt at once
_REPORT_S = 60.0  # or, once, the report of the usable plan that is there
_LINE = b"pyomo-quad: interrupted; no report was written.\n"
# Erase the progress line of a solve, and show the cursor, which that line hid.
_CLEAR = b"\r\x1b[K\x1b[?25h"

_last_acts: list[Callable[[], object]] = []
_is_told = False


class Stopped(Exception):  # noqa: N818  a stop by the user is not an error
    """Exception: the user stopped a command, and no message was printed yet."""


class SolveStopped(Stopped):
    """Exception: the user stopped a solve; ``plan`` holds its best iterate."""

    def __init__(self, plan: Any) -> None:  # noqa: ANN401  its type would import the engine
        super().__init__("interrupted")
        self.plan = plan


class Interruption:
    """Record of the user's request to stop.

    With `has_result` set, the command has the time to write its result, unless the user insists.
    """

    def __init__(self) -> None:
        self.is_requested = False
        self.has_result = False

    def request(self, _signal: int, _frame: FrameType | None) -> None:
        """Record the first signal; raise at the second if no timer ends the process.

        Raises
        ------
        KeyboardInterrupt
            When the user insists, in a process that is not the command's own.
        """
        if self.is_requested and not _enforce(_PATIENCE_S):
            raise KeyboardInterrupt
        if not self.is_requested:
            self.is_requested = True
            _enforce(_REPORT_S if self.has_result else _PATIENCE_S)


def end_on_signals() -> None:
    """Make Ctrl-C, SIGTERM and SIGHUP end this process from now on."""
    for number in (*_heeded(), signal.SIGALRM):
        signal.signal(number, _end)


def _heeded() -> list[signal.Signals]:
    """Return the signals that end a command; under nohup without SIGHUP."""
    is_deaf = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return [number for number in _SIGNALS if number != signal.SIGHUP or not is_deaf]


def leave(status: int) -> int:
    """End the process at once if a signal requested it; else return the status."""
    if signal.getitimer(signal.ITIMER_REAL)[0] > 0.0:
        os._exit(status)
    gc.freeze()  # the process ends: freeing its objects one by one would take 0.3 s
    return status


def has_told() -> None:
    """Record that the command printed its message, so that a timer prints no second message."""
    global _is_told  # noqa: PLW0603  a fact about the process
    _is_told = True


def before_the_end(act: Callable[[], object]) -> None:
    """Register a quick function to be called before a signal ends the process."""
    _last_acts.append(act)


@contextmanager
def stop_on_interrupt() -> Iterator[Interruption]:
    """Context that records a signal as a request to stop, and ends the process soon after."""
    interruption = Interruption()
    with _handled_by(interruption.request):
        yield interruption


@contextmanager
def raise_on_interrupt() -> Iterator[None]:
    """Context that raises `KeyboardInterrupt` at the first signal."""
    is_asked = False

    def once(_signal: int, _frame: FrameType | None) -> None:
        nonlocal is_asked
        is_asked = True
        for number in _SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        _enforce(_PATIENCE_S)
        raise KeyboardInterrupt

    with _handled_by(once):
        try:
            yield
        except KeyboardInterrupt:
            raise Stopped from None  # typer would exit without a message
        except Exception:
            # Libraries convert KeyboardInterrupt into errors of their own, such as ImportError.
            if is_asked:
                raise Stopped from None
            raise


@contextmanager
def _handled_by(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    previous = {number: signal.signal(number, handler) for number in _heeded()}
    try:
        yield
    finally:
        for number, former in previous.items():
            signal.signal(number, former)


def _enforce(patience_s: float) -> bool:
    """End the process after some seconds, or sooner if an earlier timer is set.

    Return whether the process is the command's own; another process is left alone.
    """
    is_own = signal.getsignal(signal.SIGALRM) is _end
    left_s = signal.getitimer(signal.ITIMER_REAL)[0]
    if is_own and not 0.0 < left_s <= patience_s:
        signal.setitimer(signal.ITIMER_REAL, patience_s)
    return is_own


def _end(_signal: int, _frame: FrameType | None) -> None:
    for number in (*_SIGNALS, signal.SIGALRM):
        signal.signal(number, signal.SIG_IGN)
    for act in _last_acts:
        act()
    if not _is_told:
        with suppress(OSError):
            os.write(2, (_CLEAR if os.isatty(2) else b"") + _LINE)
    os._exit(ExitCode.INTERRUPTED)
