"""Wind that varies from place to place, as a spline of place and time per component.

symbol | name | unit | meaning
s | field_unit | m/s | factor on the wind of the field, as a speed
x, y, z, t | - | m, s | the vehicle's place, and the wind time

Each component is the tensor product of cubic B-splines through its values on the grid, without
knots beside the ends: twice differentiable, with exact derivatives, and its work does not grow
with the grid (`collocation.Table`).  An axis of two or three points is the line or parabola
through them.  Grid points without wind, such as points inside a building, get the wind of the
nearest point with wind, because a spline needs a value everywhere; a flight through them is
refused (`unknown_wind`) unless `wind.beyond` is "hold".

With `wind.beyond` "hold", the place is clipped smoothly to the grid: farther than a tenth of a step
inside the border it is the vehicle's own to 1e-10 of a step, and outside the wind is constant.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyomo.core import Block, ConcreteModel, Expression, exp, sqrt
from pyomo.core.base.units_container import units
from pyomo.core.expr import NumericExpression

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import Table
from pyomo_quad.model.parameters import Parameter
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.messages import shown
from pyomo_quad.scenario.wind import Beyond, WindGrid

COMPONENTS = ("velocity_x", "velocity_y", "velocity_z")
FIELD_UNIT = Parameter(
    name="field_unit",
    units=units.get_units(units.m / units.s),
    value=lambda s: s.wind.field_scale,
    doc="s: factor on the wind of the field, as a speed",
)
_SPLINE_POINTS = 4
# Width over which a place beyond the grid is moved back to it, relative to the axis's least step.
_PASSING_STEPS = 0.02


def smooth_positive(number: Any, width: Any) -> Any:
    """Return a smooth max(number, 0), rounded over a width."""
    rounding = width**2 * exp(-((number / width) ** 2))
    return (number + sqrt(number**2 + rounding)) / 2


def declare_field(m: ConcreteModel, grid: WindGrid, scenario: Scenario) -> list[Expression]:
    """Declare the tables of a wind field and return its components over time [m/s].

    Parameters
    ----------
    m : ConcreteModel
        With `time`, `rigid_body` and `wind`, which has `wind_time` and `field_unit`.
    """
    b, is_held = m.wind, scenario.wind.beyond is Beyond.HOLD
    axes, tables = _filled(grid)
    unit_of_axis = [units.m] * len(axes)
    if grid.times:
        unit_of_axis[-1] = units.s
    found = []
    for name, values in zip(COMPONENTS, tables, strict=False):
        table = Table(*axes, values, arg_units=unit_of_axis)
        b.add_component(f"field_{name[-1]}", table)

        def at(b: Block, t: float, table: Table = table) -> NumericExpression:
            told = _arguments(b, grid, t)
            if is_held:
                told = [
                    _led_back(one, axis, unit)
                    for one, axis, unit in zip(told, axes, unit_of_axis, strict=True)
                ]
            return b.field_unit * table(*told)

        doc = f"wind of the field along world {name[-1]} [m/s]"
        field = Expression(m.time, rule=at, doc=doc)
        b.add_component(f"of_field_{name[-1]}", field)
        found.append(field)
    return found


def _arguments(b: Block, grid: WindGrid, t: float) -> list[Any]:
    body = b.parent_block().rigid_body
    place = [body.x[t], body.y[t], *([body.z[t]] if grid.z else [])]
    return [*place, *([b.wind_time[t]] if grid.times else [])]


def _led_back(argument: Any, axis: FloatArray, unit: Any) -> Any:
    """Clip a coordinate smoothly to the range of its grid axis."""
    width = _PASSING_STEPS * float(np.diff(axis).min()) * unit
    first, last = float(axis[0]) * unit, float(axis[-1]) * unit
    above = first + smooth_positive(argument - first, width)
    return last - smooth_positive(last - above, width)


def _filled(grid: WindGrid) -> tuple[list[FloatArray], FloatArray]:
    """Return axes and wind components of a grid, with missing values filled in for a spline."""
    from scipy.interpolate import BarycentricInterpolator  # noqa: PLC0415  for fields alone
    from scipy.ndimage import distance_transform_edt  # noqa: PLC0415  for fields alone

    values, axes = np.array(grid.components), [np.array(axis) for axis in grid.axes]
    has_wind = np.isfinite(values).all(axis=0)
    if not has_wind.all():
        steps = [float(np.diff(axis).mean()) for axis in axes]
        nearest = distance_transform_edt(
            ~has_wind, sampling=steps, return_distances=False, return_indices=True
        )
        values = values[(slice(None), *nearest)]
    for number, axis in enumerate(axes):
        if axis.size < _SPLINE_POINTS:
            axes[number] = np.linspace(axis[0], axis[-1], _SPLINE_POINTS)
            through = BarycentricInterpolator(axis, values, axis=number + 1)
            values = through(axes[number])
    return axes, values


def is_wind_known(
    scenario: Scenario, times: FloatArray | float, places: FloatArray
) -> NDArray[np.bool_]:
    """Return whether the wind is known at places (n, 3) at times in flight [s], shape (n,)."""
    wind = scenario.wind
    if wind.grid is None or wind.beyond is Beyond.HOLD:
        return np.ones(len(places), dtype=bool)
    return wind.grid.is_known(places, times + wind.time_offset)


def unknown_wind(scenario: Scenario, times: FloatArray, places: FloatArray) -> str:
    """Return a message on the first place of a flight without wind in its field, or an empty text.

    Parameters
    ----------
    times : ndarray, shape (n,)
        Times in flight [s].
    places : ndarray, shape (n, 3)
    """
    lost = np.flatnonzero(~is_wind_known(scenario, times, places))
    if not lost.size:
        return ""
    at, place = float(times[lost[0]]), _spelled(places[lost[0]])
    return (
        f"at {at:.4g} s the flight is at {place} m, where wind.field = "
        f"{shown(str(scenario.wind.field))} "
        'has no wind: keep out of there, give more of the field, or set wind.beyond = "hold".'
    )


def _spelled(place: Sequence[float] | FloatArray) -> str:
    return f"({', '.join(f'{float(number):.4g}' for number in place)})"
