"""Wind that varies from place to place: a spline over place and time for each component.

symbol | name | unit | meaning
s | field_unit | m/s | factor on the wind of the field, as a speed
x, y, z, t | - | m, s | the vehicle's place, and the wind time

Each component is a tensor product of cubic not-a-knot B-splines through its values on the grid
(`collocation.Table`). It is twice differentiable with exact derivatives, and the cost of an
evaluation does not grow with the grid.  Along an axis of two or three points, the component is the
line or parabola through the values.  Grid points without wind, such as points inside a building,
get the wind of the nearest point with wind, because a spline needs a value everywhere; a flight
through them is refused (`unknown_wind`) unless `wind.beyond` is "hold".

Outside of the grid the spline has no meaning, and may promise a wind that would carry the vehicle
there. Flights therefore stay within the edges of the grid (`model.airspace`).

With `wind.beyond` "hold", there is no such limit: the place is clipped smoothly to the grid, and
outside of the grid the wind of the border blows. Inside of the grid, at more than a tenth of a step
from the border, the clipped place equals the vehicle's place to 1e-10 of a step.
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
# Width over which the clipping of a place to the grid is rounded, relative to the axis's smallest
# step.
_PASSING_STEPS = 0.02


def smooth_positive(number: Any, width: Any) -> Any:
    """Return a smooth max(number, 0), rounded near zero over a width of the same unit.

    Unlike `parameters.positive_part`, it equals max(number, 0) to rounding a few widths from zero.
    """
    rounding = width**2 * exp(-((number / width) ** 2))
    return (number + sqrt(number**2 + rounding)) / 2


def declare_field(m: ConcreteModel, grid: WindGrid, scenario: Scenario) -> list[Expression]:
    """Declare the tables of a wind field and return the wind components at the vehicle [m/s].

    Parameters
    ----------
    m : ConcreteModel
        Model that already declares `time`, `rigid_body` and `wind`, which has `wind_time` and
        `field_unit`.
    grid : WindGrid
        Grid points and wind components of the field.
    scenario : Scenario
        Its `wind.beyond` says whether places are clipped to the grid.

    Returns
    -------
    list of Expression
        Wind over time along world x, y and, if the field has it, z.
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
                    _clipped_to_axis(one, axis, unit)
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


def _clipped_to_axis(argument: Any, axis: FloatArray, unit: Any) -> Any:
    """Clip a coordinate smoothly to the range of a grid axis."""
    width = _PASSING_STEPS * float(np.diff(axis).min()) * unit
    first, last = float(axis[0]) * unit, float(axis[-1]) * unit
    above = first + smooth_positive(argument - first, width)
    return last - smooth_positive(last - above, width)


def _filled(grid: WindGrid) -> tuple[list[FloatArray], FloatArray]:
    """Return axes and wind components of a grid, prepared for a cubic spline.

    Missing values get the wind of the nearest point with wind, and an axis with fewer than four
    points is resampled at four.

    Returns
    -------
    axes : list of ndarray
        Coordinates along each axis [m, m, m, s].
    values : ndarray, shape (n_components, *grid)
        Wind [m/s] relative to `field_unit`.
    """
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
    """Return whether the wind field has a value at each place and time of a flight.

    Parameters
    ----------
    scenario : Scenario
        A wind without field, or with `wind.beyond` "hold", is known everywhere.
    times : ndarray, shape (n,), or float
        Times in flight [s].
    places : ndarray, shape (n, 3)
        Places in world axes [m].

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    wind = scenario.wind
    if wind.grid is None or wind.beyond is Beyond.HOLD:
        return np.ones(len(places), dtype=bool)
    return wind.grid.is_known(places, times + wind.time_offset)


def unknown_wind(scenario: Scenario, times: FloatArray, places: FloatArray) -> str:
    """Return a message on the first place of a flight at which the wind field has no value.

    Parameters
    ----------
    scenario : Scenario
        Holds the wind field.
    times : ndarray, shape (n,)
        Times in flight [s].
    places : ndarray, shape (n, 3)
        Places at these times in world axes [m].

    Returns
    -------
    str
        The message for the user; empty if the wind is known on the whole flight.
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
