"""Caches of compiled problems and of calculators of steady flight.

Each cache keeps the few values stored last. A compiled problem is the optimal control problem of a
scenario, ready to be solved. A calculator (class `SteadyFlight`) computes flight at constant
velocity.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Hashable

    from pyomo_quad.collocation import Problem
    from pyomo_quad.scenario import Scenario

Value = TypeVar("Value")


class Recent(Generic[Value]):
    """Cache of the most recently stored values; a full cache discards its oldest value.

    Parameters
    ----------
    capacity : int
        Largest number of values kept; it may be changed at any time.
    """

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self._values: dict[Hashable, Value] = {}

    def get(self, key: Hashable) -> Value | None:
        """Return the value stored in the cache under a key, or None if there is no such value."""
        return self._values.get(key)

    def store(self, key: Hashable, value: Value) -> Value:
        """Store a value in the cache under a key and return the value."""
        self._values.pop(key, None)
        self._values[key] = value
        while len(self._values) > self.capacity:
            del self._values[next(iter(self._values))]
        return value


#: Number of compiled problems to keep: two planners, each with the wind of the forecast, which
#: plans assume, and with the actual wind, in which flights are simulated.
MOST_PROBLEMS = 4
#: Number of steady flights that a planner keeps: one in each of these two winds.
MOST_STEADY = 2
#: Compiled problems of all planners of the process, with the scenario of which each was built, by
#: the scenario's structure (`model.structure_key`).
PROBLEMS: Recent[tuple[Scenario, Problem]] = Recent(MOST_PROBLEMS)
#: Compiled problems with turbulence, by structure: enough for a mission as planned and as flown by
#: an autopilot, and for a second mission.
IN_TURBULENCE: Recent[Problem] = Recent(4)
#: Compiled problems of the rest of a mission after each waypoint, of the last scenario that was
#: planned again in flight.
REMAINING: Recent[tuple[Problem, ...]] = Recent(1)
