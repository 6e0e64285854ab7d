"""Time limit of a command of the user, shared by all its solves and simulated flights.

A command is one task for this package, such as planning a mission. The limit counts processor time,
so that the load of the machine does not change any result.
"""

from __future__ import annotations

import os
import time
from contextvars import ContextVar
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

from pyomo_quad.collocation import SolveError

if TYPE_CHECKING:
    from pyomo_quad.collocation import Iteration, Progress
    from pyomo_quad.scenario import Scenario


class TimeIsUpError(SolveError):
    """Error that ends a simulated flight when the limit on processor time has passed.

    The limit is the field `solver.time_limit` of the scenario.
    """


@dataclass
class _Watch:
    """Clock that measures the processor time of a thread against a time limit.

    The attribute `is_over` states whether the limit had passed at the last call of `look`.
    """

    limit_s: float
    end: float
    seen: float
    process: int
    is_over: bool = False

    @classmethod
    def started(cls, limit_s: float) -> Self:
        now = time.thread_time()
        return cls(limit_s=limit_s, end=now + limit_s, seen=now, process=os.getpid())

    def shortened(self, limit_s: float) -> Self:
        """Return a copy of this clock whose limit passes at most ``limit_s`` seconds from now.

        The seconds are processor time.
        """
        now = time.thread_time()
        return replace(self, end=min(self.end, now + limit_s), seen=now, process=os.getpid())

    def look(self) -> bool:
        """Read the processor time; return whether the time limit has passed."""
        now = time.thread_time()
        if os.getpid() != self.process:
            # The clock of a forked process starts at zero; the time left at the fork remains.
            self.process, self.end = os.getpid(), now + self.end - self.seen
        self.seen = now
        self.is_over = self.is_over or now > self.end
        return self.is_over


_CURRENT: ContextVar[_Watch | None] = ContextVar("time_limit", default=None)


class Deadline:
    """Context manager that stops solves and simulations in its block at the scenario's time limit.

    A simulation raises `TimeIsUpError`. A solve stops only if this object is its progress callback.
    The time counts from construction. A nested block keeps the limit of the outermost block, which
    `longest_s` can only shorten.

    Parameters
    ----------
    scenario : Scenario
        Scenario with `solver.time_limit` [s of processor time].
    progress : callable, optional
        Callback that may stop a solve earlier.
    longest_s : float, optional
        Further limit for this block [s of processor time].
    """

    def __init__(
        self,
        scenario: Scenario,
        progress: Progress | None = None,
        longest_s: float | None = None,
    ) -> None:
        # A command of the user has a single time limit.
        self._watch = _CURRENT.get() or _Watch.started(scenario.solver.time_limit)
        if longest_s is not None:
            self._watch = self._watch.shortened(longest_s)
        self._progress = progress

    def __enter__(self) -> Self:
        self._token = _CURRENT.set(self._watch)
        return self

    def __exit__(self, *_error: object) -> None:
        _CURRENT.reset(self._token)

    def __call__(self, iteration: Iteration) -> bool:
        """Return whether an Ipopt solve may continue; called at each iteration.

        `iteration` describes the present iteration. The result is False after the time limit.
        Before the limit, `iteration` is passed to the caller's progress callback, and the result is
        False if the callback returns False.
        """
        if self._watch.look():
            return False
        return self._progress is None or self._progress(iteration) is not False

    @property
    def limit_s(self) -> float:
        """Time limit of the outermost `Deadline` block, from its start [s of processor time]."""
        return self._watch.limit_s

    @property
    def is_over(self) -> bool:
        """Whether the time limit of this block had passed at the last check.

        Each iteration of Ipopt calls this object, which checks the limit. Simulations check it by
        `keep_time`.
        """
        return self._watch.is_over


def keep_time() -> None:
    """Raise an error if the time limit of the enclosing `Deadline` has passed.

    Simulations call this function at each evaluation of their differential equations.

    Raises
    ------
    TimeIsUpError
        If the limit has passed.
    """
    watch = _CURRENT.get()
    if watch is not None and watch.look():
        raise TimeIsUpError(
            f"given up after solver.time_limit = {watch.limit_s:g} s; allow more time."
        )
