"""Caches of a process: the most recently compiled problems and steady flights."""

from __future__ import annotations

from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Hashable

    from pyomo_quad.collocation import Problem
    from pyomo_quad.scenario import Scenario

Value = TypeVar("Value")


class Recent(Generic[Value]):
    """Cache of the most recently stored values; a full cache discards the oldest value.

    Parameters
    ----------
    most : int
        Largest number of values held; it may be changed at any time.
    """

    def __init__(self, most: int) -> None:
        self.most = most
        self._held: dict[Hashable, Value] = {}

    def get(self, key: Hashable) -> Value | None:
        """Return the value stored under a key, or None."""
        return self._held.get(key)

    def store(self, key: Hashable, value: Value) -> Value:
        """Store a value under a key and return the value."""
        self._held.pop(key, None)
        self._held[key] = value
        while len(self._held) > self.most:
            del self._held[next(iter(self._held))]
        return value


#: Compiled problems of a planner: in the wind that the optimiser assumes, and in the wind that
#: blows, and as many for a second planner.
MOST_PROBLEMS = 4
#: Steady flights of a planner: in each of these two winds.
MOST_STEADY = 2
#: Scenario and problem compiled from the declared model, for all planners of the process, by the
#: scenario's structure.
PROBLEMS: Recent[tuple[Scenario, Problem]] = Recent(MOST_PROBLEMS)
#: Problems in turbulence, by structure: missions as planned and as flown at a cruise speed, with
#: one neighbour each.
IN_TURBULENCE: Recent[Problem] = Recent(4)
#: Problems of the mission that remains after each waypoint, of the last scenario re-planned.
REMAINING: Recent[tuple[Problem, ...]] = Recent(1)
