"""The cases of a sweep: their order, their keys, and from which neighbour each one starts.

Every case that is solved, but the first, has a parent whose result is its warm start.  The parent
follows from the design alone, never from which case happened to finish first, so the rows are the
same numbers with one worker, with many, and after any number of interruptions.

Along one dimension the parents form a bisection tree over the sorted steps: the middle step first,
then the middles of the two halves, and so on.  Half of all cases so start from a direct neighbour,
and the longest chain of cases that wait for each other grows with the logarithm of the steps, which
leaves work for many workers.  Over several dimensions a case differs from its parent along one
dimension only, the last one where it is not at the root.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

from pyomo_quad.study.sweep.design import Dimension, SweepDesign
from pyomo_quad.study.sweep.task import StudyTask

__all__ = ["Case", "bisection_parents", "case_key", "expand"]

_KEY_LENGTH = 20


@dataclass(frozen=True, kw_only=True)
class Case:
    """One point of the design.

    Attributes
    ----------
    position : int
        Place in the row order.
    key : str
        Hash of the overrides; the same case has the same key in an extended study.
    overrides : mapping
        Scenario field -> value.
    parent : int or None
        Position of the case whose result is the warm start; None for the first, and where nothing
        is solved.
    """

    position: int
    key: str
    overrides: Mapping[str, Any]
    parent: int | None


def expand(design: SweepDesign) -> tuple[Case, ...]:
    """Spell out all cases of a design.

    Parameters
    ----------
    design : SweepDesign
        Dimensions and their steps.

    Returns
    -------
    tuple of Case
        In row order: the last dimension varies fastest.
    """
    parents = [_step_parents(dimension) for dimension in design.dimensions]
    sizes = [len(dimension.steps) for dimension in design.dimensions]
    is_solved = design.task == StudyTask.OPTIMISE
    cases = []
    for position, place in enumerate(product(*(range(size) for size in sizes))):
        overrides = {
            path: value
            for dimension, step in zip(design.dimensions, place, strict=True)
            for path, value in zip(dimension.paths, dimension.steps[step], strict=True)
        }
        cases.append(
            Case(
                position=position,
                key=case_key(overrides),
                overrides=overrides,
                parent=_parent_position(place, parents, sizes) if is_solved else None,
            )
        )
    return tuple(cases)


def case_key(overrides: Mapping[str, Any]) -> str:
    """Hash the overrides of a case.

    Parameters
    ----------
    overrides : mapping
        Scenario field -> value.

    Returns
    -------
    str
        Hexadecimal digits, independent of the order of the fields.
    """
    text = json.dumps(dict(overrides), sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:_KEY_LENGTH]


def bisection_parents(count: int) -> list[int | None]:
    """Return the parents of a balanced bisection tree over consecutive ranks.

    Parameters
    ----------
    count : int
        Number of ranks.

    Returns
    -------
    list of int or None
        For each rank the rank it starts from, None for the middle one.
    """
    parents: list[int | None] = [None] * count
    pending: list[tuple[int, int, int | None]] = [(0, count, None)]
    while pending:
        low, high, parent = pending.pop()
        if low >= high:
            continue
        middle = (low + high) // 2
        parents[middle] = parent
        pending += [(low, middle, middle), (middle + 1, high, middle)]
    return parents


def _step_parents(dimension: Dimension) -> list[int | None]:
    order = _sorted_steps(dimension.steps)
    parents: list[int | None] = [None] * len(order)
    for rank, parent in enumerate(bisection_parents(len(order))):
        parents[order[rank]] = None if parent is None else order[parent]
    return parents


def _sorted_steps(steps: Sequence[tuple[Any, ...]]) -> list[int]:
    # Neighbours in the first field are neighbours; texts and lists keep the order of the file.
    is_numeric = all(isinstance(step[0], int | float) for step in steps)
    indices = range(len(steps))
    return sorted(indices, key=lambda index: steps[index][0]) if is_numeric else list(indices)


def _parent_position(
    place: Sequence[int], parents: Sequence[Sequence[int | None]], sizes: Sequence[int]
) -> int | None:
    for index in reversed(range(len(place))):
        step = parents[index][place[index]]
        if step is not None:
            neighbour = [*place[:index], step, *place[index + 1 :]]
            return _position(neighbour, sizes)
    return None


def _position(place: Sequence[int], sizes: Sequence[int]) -> int:
    position = 0
    for step, size in zip(place, sizes, strict=True):
        position = position * size + step
    return position
