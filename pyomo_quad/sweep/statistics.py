"""Statistics of a sweep: curves, Pareto fronts, planes, sensitivities and spreads."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from math import isnan
from typing import Any

import numpy as np
import pandas as pd

from pyomo_quad.scenario.fields import value_at
from pyomo_quad.sweep.case import CaseStatus
from pyomo_quad.sweep.design import Dimension, SweepDesign
from pyomo_quad.sweep.store import CASE_COLUMN, STATUS_COLUMN

# Sensitivities to random fields are computed over the middle nine tenths of their draws.
_LOW_SHARE, _HIGH_SHARE = 0.05, 0.95


@dataclass(frozen=True, kw_only=True)
class Curve:
    """Rows of a sweep that differ in one dimension only, in order."""

    fixed: dict[str, Any]
    rows: pd.DataFrame


@dataclass(frozen=True, kw_only=True)
class Sensitivity:
    """Range of a quantity along one field.

    Attributes
    ----------
    field : str
        The scenario field, the first of its dimension.
    least, greatest : float
        Range of the quantity along the field, with all other fields as in the `central_case`.
    least_at, greatest_at : float
        Values of the field at the ends of the range.
    base : float
        The quantity in the central case, with random fields at the middle of their draws; NaN if
        that case failed.
    """

    field: str
    least: float
    greatest: float
    least_at: float
    greatest_at: float
    base: float

    @property
    def swing(self) -> float:
        """Width of the quantity's range."""
        return self.greatest - self.least


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Range of a quantity over all finished cases.

    Attributes
    ----------
    least, greatest : float
        Ends of the range.
    least_case, greatest_case : int
        Cases at the ends of the range.
    linear_share : float
        Fraction of the variance explained by a linear fit in the random fields; NaN without random
        fields, or with too few cases for a plane.
    """

    least: float
    greatest: float
    least_case: int
    greatest_case: int
    linear_share: float

    @property
    def note(self) -> str:
        """Sentence on the share of the variance that linear effects of the random fields explain.

        Begins with a semicolon; empty if no field is random.
        """
        if isnan(self.linear_share):
            return ""
        return (
            "; of random fields the linear effect over the middle nine tenths of their draws, "
            f"which explains {100.0 * self.linear_share:.3g} % of the variance"
        )


@dataclass(frozen=True, kw_only=True)
class Best:
    """Tried value of a field at which a quantity is least.

    Attributes
    ----------
    at, value : float
        The best value of the field, and the quantity there.
    below, above : float or None
        The next values tried on either side; None if there is no such value.
    is_below_flown, is_above_flown : bool
        Whether these cases finished, so that the best value lies between more expensive ones.
    """

    at: float
    value: float
    below: float | None
    above: float | None
    is_below_flown: bool
    is_above_flown: bool

    @property
    def is_inside(self) -> bool:
        """Whether cases with larger values of the quantity finished on both sides."""
        return self.is_below_flown and self.is_above_flown


@dataclass(frozen=True)
class SweepResults:
    """Rows of a sweep, for statistics, figures and tables.

    Attributes
    ----------
    design : SweepDesign
        Design whose values are those of table cells.
    frame : DataFrame
        Rows of `results_frame`.
    """

    design: SweepDesign
    frame: pd.DataFrame

    @cached_property
    def finished(self) -> pd.DataFrame:
        """Rows whose case finished."""
        return self.frame[self.frame[STATUS_COLUMN] == CaseStatus.FINISHED.value]

    @cached_property
    def central_case(self) -> dict[str, Any]:
        """Fields of the grid's central case, through which maps and sensitivities pass."""
        grid = (one for one in self.design.dimensions if not one.is_random)
        return {one.paths[0]: self._central(one) for one in grid}

    @property
    def random_fields(self) -> list[str]:
        """Fields that are drawn at random."""
        return [path for one in self.design.dimensions if one.is_random for path in one.paths]

    def dimension_of(self, field: str) -> Dimension | None:
        """Return the dimension along which a field varies, None if it does not vary."""
        return next((one for one in self.design.dimensions if field in one.paths), None)

    def curves_along(self, field: str) -> list[Curve]:
        """Split rows into curves over one field.

        Returns
        -------
        list of Curve
            One for each combination of the other dimensions, in their order, without empty curves.
        """
        others = [one for one in self.design.dimensions if field not in one.paths]
        curves = []
        for values in product(*(one.values(one.paths[0]) for one in others)):
            fixed = {one.paths[0]: value for one, value in zip(others, values, strict=True)}
            rows = _matching(self.finished, fixed).sort_values(field)
            if not rows.empty:
                curves.append(Curve(fixed=fixed, rows=rows))
        return curves

    def beside(self, *along: Dimension) -> dict[str, Any]:
        """Return the central case's field values, without the fields of the given dimensions."""
        free = {one.paths[0] for one in along}
        return {path: value for path, value in self.central_case.items() if path not in free}

    def plane(self, across: Dimension, up: Dimension, quantity: str) -> pd.DataFrame:
        """Return a quantity over two dimensions, with other fields as in the central case.

        Parameters
        ----------
        across, up : Dimension
            Columns and rows of the plane.

        Returns
        -------
        DataFrame
            Rows and columns rise; NaN where no case finished.
        """
        rows = _matching(self.finished, self.beside(across, up))
        plane = rows.pivot_table(index=up.paths[0], columns=across.paths[0], values=quantity)
        return plane.reindex(
            index=sorted(up.values(up.paths[0])), columns=sorted(across.values(across.paths[0]))
        )

    def sensitivities(self, quantity: str) -> list[Sensitivity]:
        """Compare how a quantity changes with each numeric dimension, the widest swing first.

        A field of a grid takes all its steps, with all other fields as in the `central_case`, so
        that the result is also right for an angle that goes once around. Random fields span the
        middle nine tenths of their draws, along the plane fitted to the quantity by least squares.
        """
        rows = self.finished.dropna(subset=[quantity])
        found: list[Sensitivity] = []
        for dimension in self.design.dimensions:
            if dimension.is_random:
                found += _fitted(dimension.paths, _matching(rows, self.central_case), quantity)
            elif dimension.is_numeric:
                found += self._across_grid(dimension, rows, quantity)
        return sorted(found, key=lambda one: one.swing, reverse=True)

    def spread(self, quantity: str) -> Spread:
        """Return the range of a quantity over the finished cases, at least one."""
        rows = self.finished.dropna(subset=[quantity]).sort_values(quantity, kind="stable")
        least, greatest = rows.iloc[0], rows.iloc[-1]
        plane = _plane(self.random_fields, _matching(rows, self.central_case), quantity)
        return Spread(
            least=float(least[quantity]),
            greatest=float(greatest[quantity]),
            least_case=int(least[CASE_COLUMN]),
            greatest_case=int(greatest[CASE_COLUMN]),
            linear_share=np.nan if plane is None else plane.explained,
        )

    def _across_grid(
        self, dimension: Dimension, rows: pd.DataFrame, quantity: str
    ) -> Iterator[Sensitivity]:
        field = dimension.paths[0]
        line = _matching(rows, self.beside(dimension)).groupby(field)[quantity].mean()
        steps, values = line.index.to_numpy(dtype=float), line.to_numpy(dtype=float)
        if len(steps) > 1:
            yield Sensitivity(
                field=field,
                least=float(values.min()),
                greatest=float(values.max()),
                least_at=float(steps[values.argmin()]),
                greatest_at=float(steps[values.argmax()]),
                base=float(line.get(self._central(dimension), np.nan)),
            )

    def _central(self, dimension: Dimension) -> Any:  # noqa: ANN401  a value of any field
        base = tuple(value_at(self.design.base, *path.split(".")) for path in dimension.paths)
        if base in dimension.steps:
            return base[0]
        values = dimension.values(dimension.paths[0])
        ordered = sorted(values) if dimension.is_numeric else values
        return ordered[len(ordered) // 2]


def _matching(rows: pd.DataFrame, fixed: Mapping[str, Any]) -> pd.DataFrame:
    for field, value in fixed.items():
        rows = rows[rows[field] == value]
    return rows


def pareto_front(rows: pd.DataFrame, first: str, second: str) -> pd.DataFrame:
    """Return the Pareto front of two quantities to minimise.

    Returns
    -------
    DataFrame
        Sorted by the first column; the last row has the smallest second quantity of all.
    """
    ordered = rows.sort_values([first, second])
    best_before = ordered[second].astype(float).cummin().shift(fill_value=np.inf)
    return ordered[ordered[second] < best_before]


def best_along(curve: Curve, field: str, quantity: str, tried: Sequence[float]) -> Best:
    """Return the value of a field at the least point of a curve, with its neighbours."""
    best = pareto_front(curve.rows, field, quantity).iloc[-1]
    at, flown = float(best[field]), set(curve.rows[field])
    below = max((value for value in tried if value < at), default=None)
    above = min((value for value in tried if value > at), default=None)
    return Best(
        at=at,
        value=float(best[quantity]),
        below=below,
        above=above,
        is_below_flown=below in flown,
        is_above_flown=above in flown,
    )


@dataclass(frozen=True, kw_only=True)
class _Plane:
    """Linear least-squares fit of a quantity over random fields."""

    fields: tuple[str, ...]
    centre: pd.Series
    middle: float
    slopes: np.ndarray
    explained: float


def _plane(fields: Sequence[str], rows: pd.DataFrame, quantity: str) -> _Plane | None:
    numbers = [field for field in fields if pd.api.types.is_numeric_dtype(rows[field])]
    if not fields or len(rows) <= len(numbers) + 1:
        return None
    centre, values = rows[numbers].mean(), rows[quantity].to_numpy(dtype=float)
    design_matrix = np.column_stack([np.ones(len(rows)), rows[numbers] - centre])
    fit = np.linalg.lstsq(design_matrix, values, rcond=None)[0]
    variance, rest = np.var(values), np.var(values - design_matrix @ fit)
    return _Plane(
        fields=tuple(numbers),
        centre=centre,
        middle=float(fit[0]),
        slopes=fit[1:],
        explained=float(1.0 - rest / variance) if variance > 0.0 else np.nan,
    )


def _fitted(fields: Sequence[str], rows: pd.DataFrame, quantity: str) -> Iterator[Sensitivity]:
    plane = _plane(fields, rows, quantity)
    if plane is None:
        return
    for field, slope in zip(plane.fields, plane.slopes, strict=True):
        ends = [float(rows[field].quantile(share)) for share in (_LOW_SHARE, _HIGH_SHARE)]
        reached = {float(plane.middle + slope * (end - plane.centre[field])): end for end in ends}
        least, greatest = min(reached), max(reached)
        yield Sensitivity(
            field=field,
            least=least,
            greatest=greatest,
            least_at=reached[least],
            greatest_at=reached[greatest],
            base=plane.middle,
        )
