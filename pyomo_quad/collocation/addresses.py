"""Where a Pyomo variable or parameter sits: its component, its index, and its time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pyomo_quad.collocation.errors import TranscriptionError

if TYPE_CHECKING:
    from pyomo.dae import ContinuousSet

__all__ = ["Address", "AddressBook", "indexed_name"]


@dataclass(frozen=True)
class Address:
    """Component name, index without time, and time (None for what does not vary)."""

    component: str
    index: tuple[Any, ...]
    time: float | None

    @property
    def name(self) -> str:
        """Name of the function of time, as ``rotors.omega[1]``."""
        return indexed_name(self.component, self.index)


def indexed_name(component: str, index: tuple[Any, ...]) -> str:
    """Return the name of a component's member with its index in brackets."""
    return f"{component}[{','.join(str(i) for i in index)}]" if index else component


def _as_tuple(index: Any) -> tuple[Any, ...]:
    if index is None:
        return ()
    return index if isinstance(index, tuple) else (index,)


class AddressBook:
    """Addresses of data objects with respect to one continuous set."""

    def __init__(self, time: ContinuousSet | None) -> None:
        self._time = time
        self._positions: dict[int, int | None] = {}

    def time_position(self, component: Any) -> int | None:
        """Return where time stands in a component's index, None if it does not."""
        key = id(component)
        if key not in self._positions:
            self._positions[key] = self._find(component)
        return self._positions[key]

    def _find(self, component: Any) -> int | None:
        if self._time is None or not component.is_indexed():
            return None
        offset, found = 0, None
        for subset in component.index_set().subsets():
            if subset is self._time:
                if found is not None:
                    raise TranscriptionError(
                        f"{component.name}: indexed twice by {self._time.name}; once is supported."
                    )
                found = offset
            offset += subset.dimen or 1
        return found

    def of(self, data: Any) -> Address:
        """Return the address of a variable, parameter or constraint data object."""
        component = data.parent_component()
        return self.split(component, data.index())

    def split(self, component: Any, index: Any) -> Address:
        """Split a component's full index into the index without time, and the time."""
        whole = _as_tuple(index)
        position = self.time_position(component)
        if position is None:
            return Address(component.name, whole, None)
        rest = whole[:position] + whole[position + 1 :]
        return Address(component.name, rest, whole[position])

    def join(self, component: Any, index: tuple[Any, ...], time: Any) -> Any:
        """Return a component's full index at a time: the inverse of `split`."""
        position = self.time_position(component)
        if position is None:
            return index[0] if len(index) == 1 else (index or None)
        whole = (*index[:position], time, *index[position:])
        return whole[0] if len(whole) == 1 else whole
