"""What the rows of a sweep say: curves, fronts, maps and sensitivities, by plain arithmetic."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from pyomo_quad.study.sweep.design import Dimension, SweepDesign
from pyomo_quad.study.sweep.results import STATUS_COLUMN
from pyomo_quad.study.sweep.task import CaseStatus

__all__ = [
    "Curve",
    "Sensitivity",
    "curves_along",
    "finished_rows",
    "is_numeric",
    "pareto_front",
    "plane_of",
    "sensitivities",
]

# Random fields are compared over the middle nine tenths of their draws.
_LOW_SHARE, _HIGH_SHARE = 0.05, 0.95


@dataclass(frozen=True, kw_only=True)
class Curve:
    """Rows that differ in one dimension only, in the order of its first field."""

    fixed: dict[str, Any]
    rows: pd.DataFrame


@dataclass(frozen=True, kw_only=True)
class Sensitivity:
    """By how much a quantity changes with one field.

    Attributes
    ----------
    field : str
        The scenario field, the first of its dimension.
    least, greatest : float
        The quantity's range along the field, all else being in the middle.
    least_at, greatest_at : float
        Where in the field these are reached.
    """

    field: str
    least: float
    greatest: float
    least_at: float
    greatest_at: float

    @property
    def swing(self) -> float:
        """Width of the quantity's range."""
        return self.greatest - self.least


def finished_rows(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the rows whose case finished."""
    return frame[frame[STATUS_COLUMN] == CaseStatus.FINISHED.value]


def is_numeric(dimension: Dimension) -> bool:
    """Return whether the first field of a dimension holds numbers."""
    first = (step[0] for step in dimension.steps)
    return all(isinstance(value, int | float) and not isinstance(value, bool) for value in first)


def curves_along(design: SweepDesign, frame: pd.DataFrame, field: str) -> list[Curve]:
    """Split rows into curves over one field.

    Parameters
    ----------
    design : SweepDesign
        Its dimension with the field is the one along the curves.
    frame : DataFrame
        Rows of `results_frame`.
    field : str
        A field that varies.

    Returns
    -------
    list of Curve
        One for each combination of the other dimensions, in their order, empty ones left out.
    """
    others = [one.paths[0] for one in design.dimensions if field not in one.paths]
    steps = [[step[0] for step in one.steps] for one in design.dimensions if field not in one.paths]
    rows = finished_rows(frame)
    curves = []
    for values in product(*steps):
        fixed = dict(zip(others, values, strict=True))
        chosen = rows[_matches(rows, fixed)].sort_values(field)
        if not chosen.empty:
            curves.append(Curve(fixed=fixed, rows=chosen))
    return curves


def pareto_front(rows: pd.DataFrame, first: str, second: str) -> pd.DataFrame:
    """Return the rows that no other row beats in both of two quantities to be small.

    Parameters
    ----------
    rows : DataFrame
        Any rows.
    first, second : str
        Columns.

    Returns
    -------
    DataFrame
        Sorted by the first column; the last row has the smallest second quantity of all.
    """
    ordered = rows.sort_values([first, second])
    best_before = ordered[second].astype(float).cummin().shift(fill_value=np.inf)
    return ordered[ordered[second] < best_before]


def plane_of(
    design: SweepDesign, frame: pd.DataFrame, across: Dimension, up: Dimension, quantity: str
) -> pd.DataFrame:
    """Return a quantity over two dimensions, all others being at their middle step.

    Parameters
    ----------
    design : SweepDesign
        Of the rows.
    frame : DataFrame
        Rows of `results_frame`.
    across, up : Dimension
        Columns and rows of the plane.
    quantity : str
        A column.

    Returns
    -------
    DataFrame
        Rows and columns rise; NaN where no case finished.
    """
    rest = {one.paths[0]: _middle(one) for one in design.dimensions if one not in {across, up}}
    rows = finished_rows(frame)
    rows = rows[_matches(rows, rest)]
    plane = rows.pivot_table(index=up.paths[0], columns=across.paths[0], values=quantity)
    return plane.reindex(
        index=sorted(up.values(up.paths[0])), columns=sorted(across.values(across.paths[0]))
    )


def sensitivities(design: SweepDesign, frame: pd.DataFrame, quantity: str) -> list[Sensitivity]:
    """Compare how a quantity changes with each numeric dimension.

    A field of a grid goes through all its steps, all others being at their middle step; so an angle
    that comes round to where it began is judged fairly.  Random fields go over the middle nine
    tenths of their draws, along the plane fitted to the quantity by least squares.

    Parameters
    ----------
    design : SweepDesign
        Of the rows.
    frame : DataFrame
        Rows of `results_frame`.
    quantity : str
        A column.

    Returns
    -------
    list of Sensitivity
        Largest swing first; fields along which fewer than two cases finished are left out.
    """
    rows = finished_rows(frame).dropna(subset=[quantity])
    found: list[Sensitivity] = []
    for dimension in design.dimensions:
        if dimension.is_random:
            found += _fitted(dimension.paths, rows, quantity)
        elif is_numeric(dimension):
            found += _across_grid(design, dimension, rows, quantity)
    return sorted(found, key=lambda one: one.swing, reverse=True)


def _across_grid(
    design: SweepDesign, dimension: Dimension, rows: pd.DataFrame, quantity: str
) -> Iterator[Sensitivity]:
    rest = {
        one.paths[0]: _middle(one)
        for one in design.dimensions
        if one is not dimension and not one.is_random
    }
    field = dimension.paths[0]
    line = rows[_matches(rows, rest)].groupby(field)[quantity].mean()
    steps, values = line.index.to_numpy(dtype=float), line.to_numpy(dtype=float)
    if len(steps) > 1:
        yield Sensitivity(
            field=field,
            least=float(values.min()),
            greatest=float(values.max()),
            least_at=float(steps[values.argmin()]),
            greatest_at=float(steps[values.argmax()]),
        )


def _fitted(fields: Sequence[str], rows: pd.DataFrame, quantity: str) -> Iterator[Sensitivity]:
    numbers = [field for field in fields if pd.api.types.is_numeric_dtype(rows[field])]
    if len(rows) <= len(numbers) + 1:
        return
    centre = rows[numbers].mean()
    design_matrix = np.column_stack([np.ones(len(rows)), rows[numbers] - centre])
    fit = np.linalg.lstsq(design_matrix, rows[quantity].to_numpy(dtype=float), rcond=None)[0]
    for field, slope in zip(numbers, fit[1:], strict=True):
        ends = [float(rows[field].quantile(share)) for share in (_LOW_SHARE, _HIGH_SHARE)]
        reached = {float(fit[0] + slope * (end - centre[field])): end for end in ends}
        least, greatest = min(reached), max(reached)
        yield Sensitivity(
            field=field,
            least=least,
            greatest=greatest,
            least_at=reached[least],
            greatest_at=reached[greatest],
        )


def _middle(dimension: Dimension) -> Any:  # noqa: ANN401  a value of any scenario field
    values = [step[0] for step in dimension.steps]
    ordered = sorted(values) if is_numeric(dimension) else values
    return ordered[len(ordered) // 2]


def _matches(rows: pd.DataFrame, fixed: dict[str, Any]) -> pd.Series:
    matching = pd.Series(data=True, index=rows.index)
    for field, value in fixed.items():
        matching &= rows[field] == value
    return matching
