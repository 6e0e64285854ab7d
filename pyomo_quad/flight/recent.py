"""Small caches, for example of compiled problems."""

from collections.abc import Hashable
from typing import Generic, TypeVar

Value = TypeVar("Value")


class Recent(Generic[Value]):
    """The most recently stored values, by key; the oldest is discarded when the cache is full.

    Parameters
    ----------
    most : int
        Largest number of values held; it may be changed at any time.
    """

    def __init__(self, most: int) -> None:
        self.most = most
        self._held: dict[Hashable, Value] = {}

    def get(self, key: Hashable) -> Value | None:
        """Return the value stored under a key, None if it was never stored or is discarded."""
        return self._held.get(key)

    def store(self, key: Hashable, value: Value) -> Value:
        """Store a value as the newest, and return it."""
        self._held.pop(key, None)
        self._held[key] = value
        while len(self._held) > self.most:
            del self._held[next(iter(self._held))]
        return value
