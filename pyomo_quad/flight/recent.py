"""Values kept for the next question of the same kind, such as compiled problems."""

from collections.abc import Hashable
from typing import Generic, TypeVar

Value = TypeVar("Value")


class Recent(Generic[Value]):
    """The values stored last, by key; storing one too many discards the oldest.

    Parameters
    ----------
    most : int
        Greatest number of values held at a time; it may be changed at any time.
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
