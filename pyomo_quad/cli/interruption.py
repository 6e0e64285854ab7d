"""Ctrl-C during a solve: stop at the next iteration and keep what was reached."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

__all__ = ["Interruption", "stop_on_interrupt"]


class Interruption:
    """Whether the user asked to stop."""

    def __init__(self) -> None:
        self.is_requested = False

    def request(self, _signal: int, _frame: FrameType | None) -> None:
        """Take the first interrupt as a wish, the second as an order.

        Raises
        ------
        KeyboardInterrupt
            When the user insists.
        """
        if self.is_requested:
            raise KeyboardInterrupt
        self.is_requested = True


@contextmanager
def stop_on_interrupt() -> Iterator[Interruption]:
    """Turn the interrupt signal into a flag while the block runs.

    Yields
    ------
    Interruption
        To be asked between two steps.
    """
    interruption = Interruption()
    previous = signal.signal(signal.SIGINT, interruption.request)
    try:
        yield interruption
    finally:
        signal.signal(signal.SIGINT, previous)
