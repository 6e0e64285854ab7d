"""Wind that varies from place to place: a spline over place and time for each component.

symbol | name | unit | meaning
s | field_unit | m/s | factor on the dimensionless splines: `wind.field_scale` times 1 m/s
x, y, z, t | - | m, s | place of the vehicle, and time on the time axis of the wind data

Each component of the wind velocity is a tensor product of cubic not-a-knot B-splines through its
values on the grid (`collocation.Table`). It is twice differentiable with exact derivatives, and the
cost of an evaluation does not grow with the grid. Along an axis of two points, the component is a
line through the values; along an axis of three points, a parabola. A spline needs a value at every
grid point: points without wind, such as those inside a building, get the wind of the nearest point
with wind.

In each cell of the grid, the spline is a cubic polynomial of each coordinate. The control points of
a cell are the Bernstein coefficients of this polynomial, four along each axis. The wind in the cell
lies within their convex hull.

The scenario's field `wind.beyond` selects what happens where the field has no wind:

- With "refuse", the default, flights are permitted only where the wind is known. Constraints of the
  module `model.airspace` keep flights inside the grid. A flight is also refused if it passes a
  place whose nearest grid point has no wind; `unknown_wind` writes the message.
- With "hold", the nearest known wind is used, and flights may leave the grid. Outside of the grid
  the wind of the border blows, because the vehicle's place is clipped smoothly to the grid. At more
  than a tenth of a grid step inside the border, the clipped place equals the vehicle's place to
  1e-10 of a grid step.
"""

from collections.abc import Sequence
from dataclasses import dataclass
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

_HORIZONTAL = ("x", "y")
COMPONENTS = ("velocity_x", "velocity_y", "velocity_z")
FIELD_UNIT = Parameter(
    name="field_unit",
    units=units.get_units(units.m / units.s),
    value=lambda s: s.wind.field_scale,
    doc="s: factor on the wind of the field, as a speed",
)
_SPLINE_POINTS = 4
# Sides of the horizontal polygon that contains all winds.
_SIDES = 8
# Width over which the clipping of a place to the grid is rounded, relative to the axis's smallest
# step.
_PASSING_STEPS = 0.02


def smooth_positive(number: Any, width: Any) -> Any:
    """Return a smooth max(number, 0), rounded near zero over a width of the same unit.

    If abs(number) exceeds a few widths, the result equals max(number, 0) up to rounding.
    """
    # `parameters.positive_part` approaches max(number, 0) much more slowly.
    rounding = width**2 * exp(-((number / width) ** 2))
    return (number + sqrt(number**2 + rounding)) / 2


def declare_field(m: ConcreteModel, grid: WindGrid, scenario: Scenario) -> list[Expression]:
    """Declare the splines of a wind field and return the wind components at the vehicle [m/s].

    They are along x, y and, if the field has it, z. If `wind.beyond` is "hold", place and time are
    clipped to the grid. The block `wind` of `m` already has `wind_time` and `field_unit`.
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
    """Return a coordinate or time of the vehicle, clipped smoothly to the range of a grid axis.

    `axis` holds the values at the grid points as numbers, and `unit` is their Pyomo unit.
    """
    width = _PASSING_STEPS * float(np.diff(axis).min()) * unit
    first, last = float(axis[0]) * unit, float(axis[-1]) * unit
    above = first + smooth_positive(argument - first, width)
    return last - smooth_positive(last - above, width)


def _filled(grid: WindGrid) -> tuple[list[FloatArray], FloatArray]:
    """Return axes and values of a wind field after filling gaps and resampling short axes.

    Points without wind get the nearest wind. Each axis gets four or more points. The first array
    axis of the values [m/s] is the component. `wind.field_scale` is left out.
    """
    from scipy.interpolate import BarycentricInterpolator  # noqa: PLC0415  for fields alone

    values, axes = with_nearest_wind(grid), [np.array(axis) for axis in grid.axes]
    for number, axis in enumerate(axes):
        # A cubic spline needs four points; the polynomial through fewer points is resampled.
        if axis.size < _SPLINE_POINTS:
            axes[number] = np.linspace(axis[0], axis[-1], _SPLINE_POINTS)
            through = BarycentricInterpolator(axis, values, axis=number + 1)
            values = through(axes[number])
    return axes, values


def with_nearest_wind(grid: WindGrid) -> FloatArray:
    """Return the wind [m/s] of a grid, with the nearest known wind at points without wind.

    The first array axis is the component, the other array axes are those of the grid.
    """
    from scipy.ndimage import distance_transform_edt  # noqa: PLC0415  for fields alone

    values = np.array(grid.components)
    has_wind = np.isfinite(values).all(axis=0)
    if has_wind.all():
        return values
    steps = [float(np.diff(axis).mean()) for axis in grid.axes]
    nearest = distance_transform_edt(
        ~has_wind, sampling=steps, return_distances=False, return_indices=True
    )
    return np.asarray(values[(slice(None), *nearest)])


def wind_corners(scenario: Scenario) -> FloatArray:
    """Return the corners of a prism that contains every wind that a flight may meet, shape (n, 3).

    The prism [m/s] along z has an octagon as base; see docs/theory/bound.md, eq. (21). Without a
    wind field, a ValueError is raised.
    """
    _, points, is_open = _controlled(scenario)
    # The wind in a cell lies within the control points of its spline there.
    winds = points[:, is_open]
    angles = 2 * np.pi * np.arange(_SIDES) / _SIDES
    sides = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    # The smallest octagon of these directions that contains the horizontal wind of all control
    # points.
    reach = (sides @ winds[:2]).max(axis=1)
    # Two neighbouring sides meet where both of their distances from the origin are reached.
    corners = [
        np.linalg.solve([side, after], [far, farther])
        for side, after, far, farther in zip(
            sides, np.roll(sides, -1, axis=0), reach, np.roll(reach, -1), strict=True
        )
    ]
    rising = winds[2] if len(winds) > len(_HORIZONTAL) else np.zeros(1)
    heights = sorted({float(rising.min()), float(rising.max())})
    return np.array([[*c, scenario.wind.vertical + height] for height in heights for c in corners])


def _controlled(
    scenario: Scenario,
) -> tuple[list[FloatArray], FloatArray, NDArray[np.bool_]]:
    """Return axes and control points of a wind field, and whether flights may enter their cells.

    The axes are x, y, z [m] and time [s], as far as the field has them. The first array axis of the
    control points [m/s] is the wind component. The others have four points for each cell.
    """
    grid = scenario.wind.grid
    if grid is None:
        raise ValueError(f"{scenario.name} has no wind.field")
    axes, points = _filled(grid)
    for number, axis in enumerate(axes):
        points = np.moveaxis(
            _control_points(axis, np.moveaxis(points, number + 1, 0)), 0, number + 1
        )
    is_held = scenario.wind.beyond is Beyond.HOLD
    # With "hold", flights may enter all cells, otherwise those with wind at one corner or more.
    is_open = np.ones(points.shape[1:], dtype=bool) if is_held else _near_wind(grid, points.shape)
    return axes, scenario.wind.field_scale * points, is_open


@dataclass(frozen=True, kw_only=True)
class ColumnWinds:
    """Bounds of the horizontal wind in each vertical column of a wind field's grid.

    Attributes
    ----------
    x, y : ndarray, shapes (nx + 1,) and (ny + 1,)
        Edges of the columns [m].
    low, high : ndarray, shape (2, nx, ny)
        Bounds of the wind along x (index 0) and y (index 1) at all times and heights of the cells
        that a flight may enter [m/s]; inf and -inf without such cells.
    is_open : ndarray of bool, shape (nx, ny)
        Whether a flight may enter the column.
    """

    x: FloatArray
    y: FloatArray
    low: FloatArray
    high: FloatArray
    is_open: NDArray[np.bool_]


def winds_of_columns(scenario: Scenario) -> ColumnWinds:
    """Return bounds of the horizontal wind in each vertical column of a wind field's grid.

    The bounds are the extreme control points of the wind's spline in the cells that flights may
    enter; see docs/theory/bound.md, eq. (21). Without a wind field, a ValueError is raised.
    """
    axes, points, is_open = _controlled(scenario)
    cells = (points.shape[1] // _SPLINE_POINTS, points.shape[2] // _SPLINE_POINTS)
    shape = (cells[0], _SPLINE_POINTS, cells[1], _SPLINE_POINTS, -1)
    winds, near = points[:2].reshape(2, *shape), is_open.reshape(shape)
    return ColumnWinds(
        x=axes[0],
        y=axes[1],
        low=np.where(near, winds, np.inf).min(axis=(2, 4, 5)),
        high=np.where(near, winds, -np.inf).max(axis=(2, 4, 5)),
        is_open=np.asarray(near.any(axis=(1, 3, 4))),
    )


def _control_points(axis: FloatArray, values: FloatArray) -> FloatArray:
    """Return the control points (Bernstein coefficients) of the cubic spline through `values`.

    Along the first array axis, the result has four control points for each interval of `axis`, in
    order.
    """
    from scipy.interpolate import make_interp_spline  # noqa: PLC0415  for fields alone

    spline = make_interp_spline(axis, values, k=3)
    held, slopes = spline(axis), spline(axis, 1)
    thirds = np.diff(axis).reshape(-1, *[1] * (values.ndim - 1)) / 3
    # A cubic over the width w with end values v_0 and v_1 and end slopes s_0 and s_1 has the
    # control points v_0, v_0 + w s_0 / 3, v_1 - w s_1 / 3 and v_1.
    of_cells = (
        held[:-1],
        held[:-1] + thirds * slopes[:-1],
        held[1:] - thirds * slopes[1:],
        held[1:],
    )
    return np.asarray(np.stack(of_cells, axis=1).reshape(-1, *values.shape[1:]))


def _near_wind(grid: WindGrid, shape: Sequence[int]) -> NDArray[np.bool_]:
    """Return which control points belong to a cell with known wind at one corner or more.

    `shape` is the shape of the array of control points: components, then four points per cell along
    each grid axis. The result has shape `shape[1:]`.
    """
    near: NDArray[np.bool_] = np.asarray(np.isfinite(grid.components).all(axis=0))
    for number, count in enumerate(shape[1:]):
        first = np.moveaxis(near, number, 0)
        if len(first) < _SPLINE_POINTS:
            # The axis is resampled, and has other cells.
            cells = np.repeat(np.asarray(first.any(axis=0))[None], count, axis=0)
        else:
            cells = np.repeat(first[:-1] | first[1:], _SPLINE_POINTS, axis=0)
        near = np.moveaxis(cells, 0, number)
    return near


def is_wind_known(
    scenario: Scenario, times: FloatArray | float, places: FloatArray
) -> NDArray[np.bool_]:
    """Return whether the wind field has a value at each place and time of a flight, shape (n,).

    `times` are times in flight [s], `places` world coordinates [m], shape (n, 3). Without a field,
    or if `wind.beyond` is "hold", the result is always true.
    """
    wind = scenario.wind
    if wind.grid is None or wind.beyond is Beyond.HOLD:
        return np.ones(len(places), dtype=bool)
    return wind.grid.is_known(places, times + wind.time_offset)


def unknown_wind(scenario: Scenario, times: FloatArray, places: FloatArray) -> str:
    """Return a message on the first place of a flight at which the wind field has no value.

    `times` are times in flight [s], and `places` world coordinates [m], shape (n, 3). If the wind
    is known on the whole flight, the message is empty.
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
