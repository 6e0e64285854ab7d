"""End of a command: exit statuses, and the effect of Ctrl-C, SIGTERM and SIGHUP."""

import gc
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from enum import IntEnum
from types import FrameType
from typing import Any


class ExitCode(IntEnum):
    """Exit status of a `pyomo-quad` command: 0 for success, otherwise the kind of failure."""

    VERIFIED = 0
    FAULT = 1  # the disk, the system or a bug
    BAD_INPUT = 2
    NOT_SOLVED = 3  # infeasible or not converged
    NOT_VERIFIED = 4
    RISK_NOT_HAD = 5  # a plan, but flights of it break limits more often than the risk allows
    INTERRUPTED = 130  # by Ctrl-C, as shells report it, by SIGTERM or by SIGHUP


_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_PATIENCE_S = 0.5  # a user who stops a command expects the prompt at once
_REPORT_S = 60.0  # time to write the report of a usable plan after the first signal
_LINE = b"pyomo-quad: interrupted; no report was written.\n"
# Erase the progress line of a solve, and show the cursor, which that line hid.
_CLEAR = b"\r\x1b[K\x1b[?25h"

_last_acts: list[Callable[[], object]] = []
_has_last_message = False


class Stopped(Exception):  # noqa: N818  a stop by the user is not an error
    """Exception: the user stopped a command before it printed its result.

    The function `commands.main` catches the exception and prints a message.
    """


class SolveStopped(Stopped):
    """Exception: the user stopped a solve; ``plan`` is the best iterate that the solve found."""

    def __init__(self, plan: Any) -> None:  # noqa: ANN401  its type would import the engine
        super().__init__("interrupted")
        self.plan = plan


class Interruption:
    """Record of a user's request to stop the running command.

    The first signal, such as Ctrl-C, sets `is_requested` and starts a timer that ends the process.
    The timer takes one minute if `has_result` is True, so that the command can write its report.
    Otherwise, and after a second signal, it takes half a second.
    """

    def __init__(self) -> None:
        self.is_requested = False
        # The command sets this to True as soon as it has a plan whose simulated flight arrives and
        # keeps all limits.
        self.has_result = False

    def request(self, _signal: int, _frame: FrameType | None) -> None:
        """Handle a signal: record the request, and start a timer that ends the process.

        In a process that also runs other code, such as tests, no timer is started.

        Raises
        ------
        KeyboardInterrupt
            At a second signal, in a process that also runs other code.
        """
        # Python passes two arguments to every signal handler. They are not needed here.
        if self.is_requested and not _enforce(_PATIENCE_S):
            raise KeyboardInterrupt
        if not self.is_requested:
            self.is_requested = True
            _enforce(_REPORT_S if self.has_result else _PATIENCE_S)


def end_on_signals() -> None:
    """Install signal handlers: Ctrl-C, SIGTERM and SIGHUP then end this process at once.

    The exit status is `ExitCode.INTERRUPTED`. A SIGHUP that is ignored, as under `nohup`, stays
    ignored.
    """
    # SIGALRM is the signal of the timer. Its handler tells `_enforce` that this process runs only
    # the command.
    for number in (*_ending_signals(), signal.SIGALRM):
        signal.signal(number, _end)


def _ending_signals() -> list[signal.Signals]:
    """Return the signals that end a command: SIGINT, SIGTERM, and SIGHUP if it is not ignored."""
    is_deaf = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return [number for number in _SIGNALS if number != signal.SIGHUP or not is_deaf]


def leave(status: int) -> int:
    """Return the exit status `status`, or end the process with it if a timer is running.

    The timer is that of `Interruption`; a signal starts it. If the process did not end at once, the
    timer might end it first, with the status `ExitCode.INTERRUPTED`.
    """
    if signal.getitimer(signal.ITIMER_REAL)[0] > 0.0:
        os._exit(status)
    gc.freeze()  # the process ends: freeing its objects one by one would take 0.3 s
    return status


def record_last_message() -> None:
    """Record that the command has printed its last message.

    If the timer of `Interruption` ends the process after this call, it prints no further message.
    """
    global _has_last_message  # noqa: PLW0603  a fact about the process
    _has_last_message = True


def before_the_end(act: Callable[[], object]) -> None:
    """Register a function `act` to be called without arguments before a signal ends the process.

    The function `act` must be quick. For example, it may remove temporary files or end child
    processes.
    """
    _last_acts.append(act)


@contextmanager
def stop_on_interrupt() -> Iterator[Interruption]:
    """Turn a signal such as Ctrl-C into a request to stop a solve, inside a ``with`` block.

    A solve inside the block must read `Interruption.is_requested` at each iteration, and stop if it
    is True. The signal also starts a timer, which ends the process if the command does not end in
    time; see `Interruption`.
    """
    interruption = Interruption()
    with _handled_by(interruption.request):
        yield interruption


@contextmanager
def raise_on_interrupt() -> Iterator[None]:
    """Context manager: stop the ``with`` block by `KeyboardInterrupt` at the first signal.

    ``finally`` clauses in the block can then clean up. Later signals are ignored. If
    `end_on_signals` was called before, the process ends at most half a second after the signal,
    even if the block still runs. Otherwise, as in a test, there is no time limit.

    Raises
    ------
    Stopped
        If the block ends by `KeyboardInterrupt`, or by any error after the signal.
    """
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
    previous = {number: signal.signal(number, handler) for number in _ending_signals()}
    try:
        yield
    finally:
        for number, former in previous.items():
            signal.signal(number, former)


def _enforce(patience_s: float) -> bool:
    """Set a timer that ends the process after `patience_s` seconds, if it may be ended.

    The result is True if the process has called `end_on_signals`. A process that also runs other
    code, as in tests, is not ended. A timer that ends sooner is kept.
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
    if not _has_last_message:
        with suppress(OSError):
            os.write(2, (_CLEAR if os.isatty(2) else b"") + _LINE)
    os._exit(ExitCode.INTERRUPTED)
