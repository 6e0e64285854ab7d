"""Statistics of a parameter sweep: Pareto fronts, best values, sensitivities and ranges.

A quantity is an output column, such as the energy. A dimension is one scenario field, or several
fields that change together. A curve holds the finished cases that differ along one dimension only.
A random field is a scenario field whose values in the sweep are drawn from a distribution.

The central case has the field values of the base scenario. A field whose base value is not in the
sweep has the middle of its values. Sensitivities and heat maps vary one or two dimensions, and keep
the other fields as in the central case.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from math import isnan
from typing import Any

import numpy as np
import pandas as pd

from pyomo_quad.scenario.fields import parse_path, value_at
from pyomo_quad.sweep.case import CaseStatus
from pyomo_quad.sweep.design import Dimension, SweepDesign
from pyomo_quad.sweep.store import CASE_COLUMN, STATUS_COLUMN

# Sensitivities to random fields are computed over the middle nine tenths of their draws.
_LOW_SHARE, _HIGH_SHARE = 0.05, 0.95


@dataclass(frozen=True, kw_only=True)
class Curve:
    """Finished cases of a sweep that differ only along one dimension, in the order of its values.

    Attributes
    ----------
    fixed : dict
        Fields that vary in the sweep but are constant along the curve: value of each field, by its
        dotted path. Of several fields that change together, only the first is named.
    rows : DataFrame
        Rows of the result table.
    """

    fixed: dict[str, Any]
    rows: pd.DataFrame


@dataclass(frozen=True, kw_only=True)
class Sensitivity:
    """Range of an output quantity as one scenario field varies alone from the central case.

    For a field with given values, the quantity is averaged at each value over the draws of the
    random fields. For a random field, a linear function of all random fields is fitted by least
    squares. The ends of the range are then its values at the field's 5 % and 95 % quantiles, with
    the other random fields at their means.

    Attributes
    ----------
    field : str
        Dotted path; of several fields that change together, the first.
    least, greatest : float
        Ends of the range, in the unit of the column.
    least_at, greatest_at : float
        Values of the field at these ends.
    base : float
        The quantity in the central case, NaN if it failed; for a random field, the fit at the means
        of all random fields.
    """

    field: str
    least: float
    greatest: float
    least_at: float
    greatest_at: float
    base: float

    @property
    def swing(self) -> float:
        """Width of the quantity's range: greatest minus least value."""
        return self.greatest - self.least


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Range of an output quantity over all finished cases of a sweep.

    Attributes
    ----------
    least, greatest : float
        Ends of the range, in the unit of the column.
    least_case, greatest_case : int
        Row numbers of the cases with these values.
    linear_share : float
        Share of the variance that a linear fit over the random fields explains (coefficient of
        determination). NaN without random fields, or with too few cases.
    """

    least: float
    greatest: float
    least_case: int
    greatest_case: int
    linear_share: float

    @property
    def note(self) -> str:
        """Part of a caption: how much of the quantity's variance the random fields explain.

        The text begins with a semicolon. It is empty if `linear_share` is NaN.
        """
        if isnan(self.linear_share):
            return ""
        return (
            "; of random fields the linear effect over the middle nine tenths of their draws, "
            f"which explains {100.0 * self.linear_share:.3g} % of the variance"
        )


@dataclass(frozen=True, kw_only=True)
class Best:
    """Value of a scenario field at which an output quantity is least along a curve.

    Attributes
    ----------
    at, value : float
        The field's best value, and the quantity at this value.
    below, above : float or None
        Next smaller and next larger value of the field in the sweep; None if there is none.
    is_below_flown, is_above_flown : bool
        Whether the case with the value `below`, and that with `above`, finished (was solved and
        verified).
    """

    at: float
    value: float
    below: float | None
    above: float | None
    is_below_flown: bool
    is_above_flown: bool

    @property
    def is_inside(self) -> bool:
        """Whether the cases at the next smaller and next larger value of the field both finished.

        If so, the best value is a local minimum. Otherwise the true minimum may be elsewhere.
        """
        return self.is_below_flown and self.is_above_flown


@dataclass(frozen=True)
class SweepResults:
    """Result table of a parameter sweep, and the statistics that its report prints and draws.

    Attributes
    ----------
    design : SweepDesign
        Specification of the sweep. A field value that is a list is replaced by its JSON text, as in
        `frame`: see `SweepDesign.in_cells`.
    frame : DataFrame
        Result table with one row for each case that ended, as the function `results_frame` reads it
        from the result store.
    """

    design: SweepDesign
    frame: pd.DataFrame

    @cached_property
    def finished(self) -> pd.DataFrame:
        """Rows of the result table for the cases that were solved, and verified by simulation."""
        return self.frame[self.frame[STATUS_COLUMN] == CaseStatus.FINISHED.value]

    @cached_property
    def central_case(self) -> dict[str, Any]:
        """Field values of the sweep's central case, by dotted path, without random fields.

        Of several fields that change together, only the first is included.
        """
        grid = (one for one in self.design.dimensions if not one.is_random)
        return {one.paths[0]: self._central(one) for one in grid}

    @property
    def random_fields(self) -> list[str]:
        """Dotted paths of the scenario fields whose values were drawn at random."""
        return [path for one in self.design.dimensions if one.is_random for path in one.paths]

    def dimension_of(self, field: str) -> Dimension | None:
        """Return the dimension of the sweep in which a scenario field varies.

        The result is None if the field is constant.
        """
        return next((one for one in self.design.dimensions if field in one.paths), None)

    def curves_along(self, field: str) -> list[Curve]:
        """Split the finished cases into curves along one scenario field.

        There is one curve for each combination of values of the other fields, in the order of the
        design. Combinations without a finished case are left out.
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
        """Return the central case's field values without the fields of the given dimensions.

        The keys are dotted paths.
        """
        free = {one.paths[0] for one in along}
        return {path: value for path, value in self.central_case.items() if path not in free}

    def plane(self, across: Dimension, up: Dimension, quantity: str) -> pd.DataFrame:
        """Tabulate a quantity over two dimensions of the sweep.

        The columns are the values of `across`, the rows those of `up`, both ascending. Other fields
        are as in the central case. The quantity is averaged over the draws of random fields, and
        NaN where no case finished.
        """
        rows = _matching(self.finished, self.beside(across, up))
        plane = rows.pivot_table(index=up.paths[0], columns=across.paths[0], values=quantity)
        return plane.reindex(
            index=sorted(up.values(up.paths[0])), columns=sorted(across.values(across.paths[0]))
        )

    def sensitivities(self, quantity: str) -> list[Sensitivity]:
        """Compute the range of a quantity along each numeric field, the widest range first.

        The class `Sensitivity` defines the ranges. A field with given values is left out if cases
        finished at fewer than two of them. The range along a random field comes from a linear fit
        to the cases. If too few cases finished for the fit, all random fields are left out.
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
        """Compute the range of a quantity over all finished cases.

        At least one case must have finished with a value of the quantity.
        """
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
        # Over all values, not the first and last alone: for an angle over a full turn, the quantity
        # is equal at both.
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
        paths = (parse_path(path) or () for path in dimension.paths)
        base = tuple(value_at(self.design.base, *path) for path in paths)
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
    """Return the rows on the Pareto front of two quantities to minimise, by ascending `first`.

    A row is on the front if every other row has a larger value of at least one quantity. Of equal
    rows, only the first counts. The last row has the least `second`.
    """
    ordered = rows.sort_values([first, second])
    best_before = ordered[second].astype(float).cummin().shift(fill_value=np.inf)
    return ordered[ordered[second] < best_before]


def best_along(curve: Curve, field: str, quantity: str, tried: Sequence[float]) -> Best:
    """Find the value of a scenario field at which a quantity is least along a curve.

    `tried` has all values of the field in the sweep, including those of failed cases.
    """
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
    """Linear least-squares fit of a quantity over the random fields of a sweep.

    The fit is ``middle + slopes @ (values - centre)``, where ``values`` are those of ``fields`` and
    ``centre`` their means over the cases. ``explained`` is the coefficient of determination.
    """

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
