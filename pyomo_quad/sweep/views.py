"""What the rows of a sweep say, by plain arithmetic, in which words and units, and how it spreads.

Curves, fronts, maps and sensitivities; what columns are called in print; a tornado chart of what
matters most, and how a random quantity is distributed.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import ceil, degrees, isnan
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from pyomo_quad.report.render import NOTHING
from pyomo_quad.report.style import FULL_WIDTH, INK, MUTED, SERIES_STYLES, panel_grid
from pyomo_quad.scenario import field_unit
from pyomo_quad.sweep.case import CaseStatus
from pyomo_quad.sweep.design import Dimension, SweepDesign
from pyomo_quad.sweep.store import CASE_COLUMN, STATUS_COLUMN

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
        The quantity's range along the field, all else being as in the `central_case`.
    least_at, greatest_at : float
        Where in the field these are reached.
    base : float
        The quantity in the central case, of random fields in the middle of their draws; NaN where
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
    """From where to where a quantity goes over all finished cases.

    Attributes
    ----------
    least, greatest : float
        Its range.
    least_case, greatest_case : int
        The cases at its ends.
    linear_share : float
        Share of the variance that a plane over the random fields explains; NaN without such
        fields, or too few cases for a plane.
    """

    least: float
    greatest: float
    least_case: int
    greatest_case: int
    linear_share: float


@dataclass(frozen=True, kw_only=True)
class Best:
    """Where along a field a quantity is least, among the values tried.

    Attributes
    ----------
    at, value : float
        The best value of the field, and the quantity there.
    below, above : float or None
        The next values tried on either side; None where none was.
    is_below_flown, is_above_flown : bool
        Whether these cases finished, so that the best lies between values that are dearer.
    """

    at: float
    value: float
    below: float | None
    above: float | None
    is_below_flown: bool
    is_above_flown: bool

    @property
    def is_inside(self) -> bool:
        """Whether dearer cases finished on both sides."""
        return self.is_below_flown and self.is_above_flown


def finished_rows(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the rows whose case finished."""
    return frame[frame[STATUS_COLUMN] == CaseStatus.FINISHED.value]


def is_numeric(dimension: Dimension) -> bool:
    """Return whether the first field of a dimension holds numbers."""
    first = (step[0] for step in dimension.steps)
    return all(isinstance(value, int | float) and not isinstance(value, bool) for value in first)


def curves_along(design: SweepDesign, frame: pd.DataFrame, field: str) -> list[Curve]:
    """Split rows into curves over one field.

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

    Returns
    -------
    DataFrame
        Sorted by the first column; the last row has the smallest second quantity of all.
    """
    ordered = rows.sort_values([first, second])
    best_before = ordered[second].astype(float).cummin().shift(fill_value=np.inf)
    return ordered[ordered[second] < best_before]


def best_along(curve: Curve, field: str, quantity: str, tried: Sequence[float]) -> Best:
    """Find where along a curve a quantity is least, and whether that is an edge."""
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


def central_case(design: SweepDesign) -> dict[str, Any]:
    """Return the case of the grid through which maps and sensitivities go."""
    return {one.paths[0]: _central(design, one) for one in design.dimensions if not one.is_random}


def plane_of(
    design: SweepDesign, frame: pd.DataFrame, across: Dimension, up: Dimension, quantity: str
) -> pd.DataFrame:
    """Return a quantity over two dimensions, all others being as in the `central_case`.

    Parameters
    ----------
    across, up : Dimension
        Columns and rows of the plane.

    Returns
    -------
    DataFrame
        Rows and columns rise; NaN where no case finished.
    """
    rest = _others(design, across, up)
    rows = finished_rows(frame)
    rows = rows[_matches(rows, rest)]
    plane = rows.pivot_table(index=up.paths[0], columns=across.paths[0], values=quantity)
    return plane.reindex(
        index=sorted(up.values(up.paths[0])), columns=sorted(across.values(across.paths[0]))
    )


def sensitivities(design: SweepDesign, frame: pd.DataFrame, quantity: str) -> list[Sensitivity]:
    """Compare how a quantity changes with each numeric dimension.

    A field of a grid goes through all its steps, all others being as in the `central_case`; so an
    angle that comes round to where it began is judged fairly.  Random fields go over the middle
    nine tenths of their draws, along the plane fitted to the quantity by least squares.
    """
    rows = finished_rows(frame).dropna(subset=[quantity])
    found: list[Sensitivity] = []
    for dimension in design.dimensions:
        if dimension.is_random:
            found += _fitted(dimension.paths, rows[_matches(rows, central_case(design))], quantity)
        elif is_numeric(dimension):
            found += _across_grid(design, dimension, rows, quantity)
    return sorted(found, key=lambda one: one.swing, reverse=True)


def spread_of(design: SweepDesign, frame: pd.DataFrame, quantity: str) -> Spread:
    """Return the range of a quantity over all finished cases, as it came out.

    Parameters
    ----------
    frame : DataFrame
        Rows of `results_frame`, at least one of them finished.
    """
    rows = finished_rows(frame).dropna(subset=[quantity]).sort_values(quantity, kind="stable")
    least, greatest = rows.iloc[0], rows.iloc[-1]
    centred = rows[_matches(rows, central_case(design))]
    fields = [path for one in design.dimensions if one.is_random for path in one.paths]
    plane = _plane(fields, centred, quantity) if fields else None
    return Spread(
        least=float(least[quantity]),
        greatest=float(greatest[quantity]),
        least_case=int(least[CASE_COLUMN]),
        greatest_case=int(greatest[CASE_COLUMN]),
        linear_share=np.nan if plane is None else plane.explained,
    )


def _across_grid(
    design: SweepDesign, dimension: Dimension, rows: pd.DataFrame, quantity: str
) -> Iterator[Sensitivity]:
    field = dimension.paths[0]
    chosen = rows[_matches(rows, _others(design, dimension))]
    line = chosen.groupby(field)[quantity].mean()
    steps, values = line.index.to_numpy(dtype=float), line.to_numpy(dtype=float)
    if len(steps) > 1:
        yield Sensitivity(
            field=field,
            least=float(values.min()),
            greatest=float(values.max()),
            least_at=float(steps[values.argmin()]),
            greatest_at=float(steps[values.argmax()]),
            base=float(line.get(_central(design, dimension), np.nan)),
        )


@dataclass(frozen=True, kw_only=True)
class _Plane:
    """A quantity fitted linearly over random fields, by least squares."""

    fields: tuple[str, ...]
    centre: pd.Series
    middle: float
    slopes: np.ndarray
    explained: float


def _plane(fields: Sequence[str], rows: pd.DataFrame, quantity: str) -> _Plane | None:
    numbers = [field for field in fields if pd.api.types.is_numeric_dtype(rows[field])]
    if len(rows) <= len(numbers) + 1:
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


def _others(design: SweepDesign, *along: Dimension) -> dict[str, Any]:
    """Return the central case without the fields of the dimensions that are gone along."""
    free = {one.paths[0] for one in along}
    return {field: value for field, value in central_case(design).items() if field not in free}


def _central(design: SweepDesign, dimension: Dimension) -> Any:  # noqa: ANN401  a value of any field
    base = tuple(_base_value(design, path) for path in dimension.paths)
    if base in dimension.steps:
        return base[0]
    values = [step[0] for step in dimension.steps]
    ordered = sorted(values) if is_numeric(dimension) else values
    return ordered[len(ordered) // 2]


def _base_value(design: SweepDesign, path: str) -> Any:  # noqa: ANN401  a value of any field
    value: Any = design.base
    for part in path.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value


def _matches(rows: pd.DataFrame, fixed: dict[str, Any]) -> pd.Series:
    matching = pd.Series(data=True, index=rows.index)
    for field, value in fixed.items():
        matching &= rows[field] == value
    return matching


_SUFFIXES = {
    "_m_per_s": "m/s",
    "_percent": "%",
    "_rad": "rad",
    "_J": "J",
    "_W": "W",
    "_V": "V",
    "_m": "m",
    "_s": "s",
}
_PRINTED = {"kg": "kg", "m/s^2": "m/s²", "percent": "%", "A*hr": "A h", "1/A/hr": "1/(A h)"}
_LARGE, _SIGNIFICANT = 1e5, 4
# Of all other results the greatest is the worst.
_BETTER_LARGE = ("range_m", "endurance_s", "lowest_voltage_V")
_BETTER_LARGE_START = "saving_"


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """One column: its name and unit in print, and what turns its values into that unit."""

    column: str
    name: str
    unit: str
    scale: float = 1.0

    def of(self, frame: pd.DataFrame) -> pd.Series:
        """Return the column in the printed unit."""
        return frame[self.column] * self.scale

    def worst_row(self, frame: pd.DataFrame) -> pd.Series:
        """Return the row of a table where the quantity is worst."""
        is_better_large = self.column in _BETTER_LARGE or self.column.startswith(
            _BETTER_LARGE_START
        )
        ordered = frame.sort_values(
            self.column, ascending=not is_better_large, na_position="first", kind="stable"
        )
        return ordered.iloc[-1]

    @property
    def label(self) -> str:
        """Name and unit, as beside an axis."""
        return f"{self.name[:1].upper()}{self.name[1:]}" + (f" ({self.unit})" if self.unit else "")


def field_quantity(path: str) -> Quantity:
    """Return how a scenario field is printed."""
    unit = field_unit(path)
    name = " ".join(path.split(".")[-2:]).replace("_", " ")
    if unit == "rad":
        return Quantity(column=path, name=name, unit="°", scale=degrees(1.0))
    return Quantity(column=path, name=name, unit=_PRINTED.get(unit, unit))


def output_quantity(column: str) -> Quantity:
    """Return how a column of results is printed."""
    for suffix, unit in _SUFFIXES.items():
        if column.endswith(suffix):
            name = column.removesuffix(suffix).replace("_", " ")
            if unit == "rad":
                return Quantity(column=column, name=name, unit="°", scale=degrees(1.0))
            return Quantity(column=column, name=name, unit=unit)
    return Quantity(column=column, name=column.replace("_", " "), unit="")


def number(value: object) -> str:
    """Return a result as a cell of a table."""
    if not isinstance(value, float):
        return str(value)
    if pd.isna(value):
        return NOTHING
    if 1.0 <= abs(value) < _LARGE:
        whole = len(f"{abs(value):.0f}")
        return f"{value:.{max(0, _SIGNIFICANT - whole)}f}"
    return f"{value:.{_SIGNIFICANT}g}"


def setting(value: object) -> str:
    """Return the value of a field, without zeros that say nothing."""
    text = number(value)
    is_padded = isinstance(value, float) and "." in text and "e" not in text
    return text.rstrip("0").rstrip(".") if is_padded else text


def settings_name(fixed: Mapping[str, Any]) -> str:
    """Return what a curve is called, by the fields that are the same along it."""
    parts = []
    for path, value in fixed.items():
        if isinstance(value, str):
            parts.append(value.replace("_", " "))
            continue
        shown = field_quantity(path)
        size = setting(value * shown.scale) if isinstance(value, float) else setting(value)
        name = path.rsplit(".", maxsplit=1)[-1].replace("_", " ")
        parts.append(f"{name} {size} {shown.unit}".strip())
    return ", ".join(parts) or "all cases"


def case_name(fields: Mapping[str, Any]) -> str:
    """Return what the case is called through which maps and sensitivities go.

    Parameters
    ----------
    fields : mapping
        Scenario field -> value; empty where all fields are random.
    """
    parts = []
    for path, value in fields.items():
        shown = field_quantity(path)
        size = setting(value * shown.scale) if isinstance(value, float) else setting(value)
        parts.append(f"{path} = {size} {shown.unit}".strip())
    return ", ".join(parts) or "the middle of the draws"


_ROW, _EDGES = 0.36, 1.07  # inches
_PANEL_HEIGHT = 2.0  # inches
_QUANTILES = (0.05, 0.5, 0.95)
_MOST_BINS = 24
_LABEL_ROOM = 0.14  # of the widest bar, on either side
_BELOW, _ABOVE = SERIES_STYLES[:2]


def draw_tornado(found: Sequence[Sensitivity], spread: Spread, quantity: Quantity) -> Figure:
    """Draw by how much a quantity swings over all cases, and with each field."""
    height = _EDGES + _ROW * (1 + len(found))
    figure = Figure(figsize=(FULL_WIDTH, height))
    axes = figure.subplots()
    figure.subplots_adjust(left=0.24, right=0.97, top=1 - 0.3 / height, bottom=0.72 / height)
    base = found[0].base * quantity.scale
    cases = (f"case {spread.least_case}", f"case {spread.greatest_case}")
    _draw_bar(axes, 0, (spread.least, spread.greatest), cases, base, quantity)
    for row, one in enumerate(found, start=1):
        field = field_quantity(one.field)
        reached = tuple(setting(at * field.scale) for at in (one.least_at, one.greatest_at))
        _draw_bar(axes, row, (one.least, one.greatest), reached, base, quantity)
    if not isnan(base):
        axes.axvline(base, color=INK, linewidth=1.0)
    labels = ["All cases", *(field_quantity(one.field).label for one in found)]
    axes.set_yticks(range(len(labels)), labels)
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    low, high = spread.least * quantity.scale, spread.greatest * quantity.scale
    if high > low:
        axes.set_xlim(low - _LABEL_ROOM * (high - low), high + _LABEL_ROOM * (high - low))
    axes.set(title="Range, with where its ends are reached", xlabel=quantity.label)
    patches = [
        Patch(
            facecolor=style.color, hatch=style.hatch, edgecolor="white", linewidth=0.0, label=text
        )
        for style, text in ((_BELOW, "below the base case"), (_ABOVE, "above it"))
    ]
    at_base = Line2D([], [], color=INK, linewidth=1.0, label=f"base case, {number(base)}")
    handles = patches if isnan(base) else [*patches, at_base]
    figure.legend(handles=handles, loc="lower center", ncols=len(handles))
    return figure


def _draw_bar(
    axes: Axes,
    row: int,
    ends: tuple[float, float],
    reached: tuple[str, ...],
    base: float,
    quantity: Quantity,
) -> None:
    """Draw a range in two colours that meet at the base case, in one where that case failed."""
    low, high = (end * quantity.scale for end in ends)
    split = low if isnan(base) else min(max(base, low), high)
    for start, end, style in ((low, split, _BELOW), (split, high, _ABOVE)):
        axes.barh(
            row,
            end - start,
            left=start,
            height=0.6,
            color=style.color,
            hatch=style.hatch,
            edgecolor="white",
            linewidth=0.0,
        )
    for end, text, side, anchor in (
        (low, reached[0], -4, "right"),
        (high, reached[1], 4, "left"),
    ):
        axes.annotate(
            text,
            (end, row),
            xytext=(side, 0),
            textcoords="offset points",
            ha=anchor,
            va="center",
            color=INK,
        )


def draw_distributions(rows: pd.DataFrame, quantities: Sequence[Quantity]) -> Figure:
    """Draw histograms with the median and the middle nine tenths.

    Returns
    -------
    Figure
        Two panels in a row.
    """
    columns = min(2, len(quantities))
    figure, panels = panel_grid(
        ceil(len(quantities) / columns),
        columns,
        panel_height=_PANEL_HEIGHT,
        left=0.5,
        share_time=False,
    )
    style = SERIES_STYLES[0]
    for axes, quantity in zip(panels.flat, quantities, strict=False):
        values = quantity.of(rows).dropna()
        bins = min(_MOST_BINS, max(5, ceil(len(values) ** 0.5)))
        axes.hist(values, bins=bins, color=style.color, edgecolor="white", linewidth=0.6)
        for share in _QUANTILES:
            at = float(values.quantile(share))
            dashes = "solid" if share == _QUANTILES[1] else (0, (3, 2))
            axes.axvline(at, color=INK, linewidth=1.0, linestyle=dashes)
        low, median, high = (f"{values.quantile(share):.3g}" for share in _QUANTILES)
        axes.set_title(f"Median {median}, nine tenths from {low} to {high}")
        axes.xaxis.set_major_locator(MaxNLocator(nbins=6))
        axes.set(xlabel=quantity.label, ylabel="Cases")
    for axes in panels.flat[len(quantities) :]:
        axes.set_visible(False)
    return figure


def draw_scatter(
    rows: pd.DataFrame, fields: Sequence[str], quantities: Sequence[Quantity]
) -> Figure:
    """Draw each quantity against each random field.

    Parameters
    ----------
    fields : sequence of str
        Numeric fields, one column of panels each.
    """
    figure, panels = panel_grid(
        len(quantities),
        len(fields),
        panel_height=_PANEL_HEIGHT * 0.8,
        left=0.62,
        gap=0.62,
        share_time=False,
    )
    style = SERIES_STYLES[0]
    for line, quantity in zip(panels, quantities, strict=True):
        for axes, path in zip(line, fields, strict=True):
            field = field_quantity(path)
            axes.scatter(
                field.of(rows), quantity.of(rows), s=9, color=style.color, edgecolor=MUTED, lw=0.3
            )
            axes.set(title=quantity.label, xlabel=field.label)
            axes.xaxis.set_major_locator(MaxNLocator(nbins=6))
    return figure


def linear_note(spread: Spread) -> str:
    """Say how much of a spread the straight lines over the random fields account for.

    Begins with a semicolon; empty where no field is random.
    """
    if isnan(spread.linear_share):
        return ""
    return (
        "; of random fields the linear effect over the middle nine tenths of their draws, which "
        f"explains {100.0 * spread.linear_share:.3g} % of the variance"
    )
