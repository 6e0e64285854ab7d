"""Selection of the figures in a sweep's report, with titles and captions.

The scenario fields that vary decide which figures are possible. For example, a wind rose needs
several wind directions, and scatter plots need fields with random values.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import pandas as pd

from pyomo_quad.report.document import Drawing
from pyomo_quad.sweep import charts
from pyomo_quad.sweep.case import DURATION_FIELD
from pyomo_quad.sweep.design import Dimension
from pyomo_quad.sweep.quantities import (
    Quantity,
    case_name,
    field_quantity,
    number,
    output_quantity,
    setting,
    settings_name,
)
from pyomo_quad.sweep.statistics import Curve, SweepResults

_DIRECTION_FIELD = "wind.direction"
# A heat map or a wind rose needs at least three values of a field; more than seven curves are
# indistinguishable in a legend.
_FEWEST_STEPS = 3
_MOST_CURVES = 7


def sweep_drawings(results: SweepResults) -> tuple[Drawing, ...]:
    """List the figures of a sweep's report, each with a function that draws it.

    The scenario fields that vary decide which figures are possible. At least one case must have
    finished.
    """
    quantities = [output_quantity(column) for column in results.design.report_on]
    listed = _Figures(results, quantities)
    return (
        *listed.along_duration(),
        *listed.along_other_fields(),
        *listed.roses(),
        *listed.maps(),
        *listed.spreads(),
        *listed.tornadoes(),
    )


@dataclass(frozen=True)
class _Figures:
    """Generators of the figures of a parameter sweep, one method for each kind of figure.

    `quantities` are the output columns that the report draws.
    """

    results: SweepResults
    quantities: Sequence[Quantity]

    def along_duration(self) -> Iterator[Drawing]:
        along = self.results.dimension_of(DURATION_FIELD)
        if along is None:
            return
        first, *others = self.quantities
        curves, hidden = self._curves_along(DURATION_FIELD)
        yield Drawing(
            name="pareto",
            title=f"{first.label} against duration",
            caption=f"{first.label} against the duration of the mission. On the Pareto front "
            "(thick) no other duration is both shorter and cheaper; it ends at the best duration "
            f"(star). Right: durations up to {charts.FRONT_ZOOM:g} times the best only.{hidden}",
            draw=partial(charts.draw_front, curves, first, along.values(DURATION_FIELD)),
        )
        if others:
            yield Drawing(
                name="along_duration",
                title="Against duration",
                caption=f"Other quantities against the duration of the mission.{hidden}",
                draw=partial(charts.draw_curves, curves, DURATION_FIELD, others),
            )

    def along_other_fields(self) -> Iterator[Drawing]:
        for field in (one.paths[0] for one in self._scales()):
            if field in {DURATION_FIELD, _DIRECTION_FIELD}:
                continue
            (curves, hidden), name = self._curves_along(field), field_quantity(field).name
            yield Drawing(
                name=f"along_{''.join(c if c.isalnum() else '_' for c in field)}",
                title=f"Against {name}",
                caption=f"Each quantity against {name}.{hidden}",
                draw=partial(charts.draw_curves, curves, field, self.quantities),
            )

    def roses(self) -> Iterator[Drawing]:
        if not any(_DIRECTION_FIELD in one.paths for one in self._scales()):
            return
        curves, hidden = self._curves_along(_DIRECTION_FIELD)
        for quantity in self.quantities:
            yield Drawing(
                name=f"wind_rose_{quantity.column}",
                title=f"Wind rose of {quantity.name}",
                caption=f"{quantity.label} against the direction that the wind blows to."
                f"{_worst_direction(curves, quantity)}{hidden}",
                draw=partial(charts.draw_wind_rose, curves, _DIRECTION_FIELD, quantity),
            )

    def maps(self) -> Iterator[Drawing]:
        up, across, *_ = (*self._scales(), None, None)
        if up is None or across is None:
            return
        rest = self.results.beside(up, across)
        where = f", at {case_name(rest)}" if rest else ""
        for quantity in self.quantities:
            plane = self.results.plane(across, up, quantity.column)
            if plane.notna().any(axis=None):
                yield Drawing(
                    name=f"map_{quantity.column}",
                    title=f"{quantity.label} over two fields",
                    caption=f"{quantity.label} over {field_quantity(across.paths[0]).name} and "
                    f"{field_quantity(up.paths[0]).name}{where}; a cross marks a case that failed.",
                    draw=partial(charts.draw_heat_map, plane, quantity),
                )

    def spreads(self) -> Iterator[Drawing]:
        fields, rows, hidden = self.results.random_fields, self.results.finished, self._hidden()
        if not fields:
            return
        yield Drawing(
            name="distribution",
            title="Distribution",
            caption="Cases by value: median (solid) and the middle nine tenths (between the "
            f"dashes).{hidden}",
            draw=partial(charts.draw_distributions, rows, self.quantities),
        )
        yield Drawing(
            name="scatter",
            title="Against the random fields",
            caption=f"One dot per case.{hidden}",
            draw=partial(charts.draw_scatter, rows, fields, self.quantities),
        )

    def tornadoes(self) -> Iterator[Drawing]:
        for quantity in self.quantities:
            found = self.results.sensitivities(quantity.column)
            if len(found) < 2:
                continue
            spread = self.results.spread(quantity.column)
            yield Drawing(
                name=f"tornado_{quantity.column}",
                title=f"Sensitivity of {quantity.name}",
                caption=f"Range of {quantity.name}. Top: over all cases. Below: one field at a "
                f"time from the base case, {case_name(self.results.central_case)}{spread.note}. "
                "The numbers beside the bars say where their ends are reached; the axis need not "
                f"begin at zero.{self._hidden()}",
                draw=partial(charts.draw_tornado, found, spread, quantity),
            )

    def _curves_along(self, field: str) -> tuple[list[Curve], str]:
        """Select at most `_MOST_CURVES` curves along a scenario field, spread evenly, for a chart.

        The text for the caption says how many curves and cases are not drawn.
        """
        curves = self.results.curves_along(field)
        count = len(curves)
        if count <= _MOST_CURVES:
            return curves, self._hidden()
        steps = range(_MOST_CURVES)
        shown = [curves[round(k * (count - 1) / (_MOST_CURVES - 1))] for k in steps]
        return shown, f" Shown are {_MOST_CURVES} of {count} curves.{self._hidden()}"

    def _hidden(self) -> str:
        """Return a sentence for captions: how many cases did not finish; "" if all finished."""
        total = self.results.design.case_count
        missing = total - len(self.results.finished)
        return f" Not drawn: {missing} of {total} cases, which did not finish." if missing else ""

    def _scales(self) -> list[Dimension]:
        """Return the dimensions of the sweep that can be an axis of a chart.

        Such a dimension is numeric, not random, and has at least three values.
        """
        return [
            one
            for one in self.results.design.dimensions
            if one.is_numeric and not one.is_random and len(one.steps) >= _FEWEST_STEPS
        ]


def _worst_direction(curves: Sequence[Curve], quantity: Quantity) -> str:
    """Return a text for a wind rose's caption: the value at the centre, and the worst direction.

    The value at the centre of the polar chart is the least over all curves. The worst direction is
    that of the worst value over all curves (`Quantity.worst_row`).
    """
    least, _ = charts.rose_range(curves, quantity)
    worst_rows = [quantity.worst_row(curve.rows) for curve in curves]
    worst = quantity.worst_row(pd.DataFrame(worst_rows).reset_index(drop=True))
    curve = curves[int(worst.name)]  # type: ignore[call-overload]
    direction = field_quantity(_DIRECTION_FIELD)
    toward = setting(float(worst[_DIRECTION_FIELD]) * direction.scale)
    value = number(float(worst[quantity.column]) * quantity.scale)
    return (
        f" The centre is not zero but the least, {number(least)} {quantity.unit}; a star marks the "
        f"worst direction of each curve, and the worst of all is toward {toward}{direction.unit} "
        f"({settings_name(curve.fixed)}): {value} {quantity.unit}."
    )
