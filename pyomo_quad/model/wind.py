"""Wind in world axes: eq. (11)-(12) of Yacef et al., a measured table, or a field over places.

symbol | name | unit | meaning
v_0 | mean | m/s | mean value, with the scenario's steady wind added
A_k, Omega_k | amplitudes[k], frequencies[k] | m/s, rad/s | three harmonics
v_gmax, T_g | gust_amplitude, gust_period | m/s, s | gust
t | wind_time | s | wind time: time in flight plus the scenario's offset

The gust of eq. (12) peaks at v_gmax a quarter of a period after its start. With a vertical profile
(table `wind.profile`), the horizontal wind is the wind at the reference height h_r times a factor:

law | factor at height h | source
power | (h / h_r)^exponent | Justus and Mikhail (1976)
logarithmic | ln(h / z_0) / ln(h_r / z_0), of roughness z_0 | Stull (1988), section 9.7

h is the vehicle's height above the ground: z over flat ground, and over terrain the height over a
smooth surface that is nowhere below the ground (see `model.ground`). Both laws are valid only above
a lowest height, max(0.1 m, z_0). A smooth maximum of h and the lowest height therefore replaces h.
Half a metre or more above the lowest height, the smooth maximum equals h to 1e-12 m. Half a metre
or more below, it equals the lowest height to 1e-12 m, and the wind is constant.

A wind measured over heights is a cubic spline in the height above the ground, constant below the
lowest and above the highest measurement, with a smooth transition. In a wind field, by contrast,
heights are coordinates z.

A wind measured over time is a cubic spline in the wind time, constant after the last measurement.
It is twice differentiable, so that the duration and the passing times of waypoints may be variables
of the optimisation.

A wind that varies from place to place is declared in `wind_field`.
"""

from collections.abc import Callable, Sequence
from functools import cached_property, partial
from math import cos, pi, tau
from math import sin as sine
from typing import Any

import numpy as np
from pyomo.core import Block, ConcreteModel, Expression, Param, exp, log, sin
from pyomo.core.base.units_container import UnitsError, units
from pyomo.core.expr import NumericExpression

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import Table
from pyomo_quad.model.ground import height_above_ground
from pyomo_quad.model.parameters import (
    Parameter,
    declare_parameters,
    fields_of,
    parameters_in,
)
from pyomo_quad.model.wind_field import FIELD_UNIT, declare_field, smooth_positive
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.wind import (
    USUAL_HEIGHT,
    FrequencyUnit,
    Wind,
    WindAxis,
    WindLaw,
    WindSeries,
)

HARMONICS = (1, 2, 3)
_CUBIC = 3
_SPEED = units.get_units(units.m / units.s)

# Least height at which a law of the wind over height is applied.
_LEAST_HEIGHT_M = 0.1
# Range of height over which the constant wind below blends into the law.
HEIGHT_SMOOTHING = 0.1 * units.m

_TIME_OFFSET = fields_of("wind", "time_offset")
_VERTICAL = fields_of("wind", "vertical")
_MEASURED = Parameter(
    name="measured_unit",
    units=_SPEED,
    value=lambda _s: 1.0,
    doc="unit of the speeds of a wind measured over time",
)
_LEAST_HEIGHT = Parameter(
    name="least_height",
    units=units.m,
    value=lambda s: _least_height(s.wind),
    doc="h_0: height below which the wind is constant",
)
_GREATEST_HEIGHT = Parameter(
    name="greatest_height",
    units=units.m,
    value=lambda s: _measured_heights(s.wind)[-1],
    doc="h_1: height above which the wind is constant",
)
_PROFILE = (
    *fields_of("wind.profile", "reference_height"),
    _LEAST_HEIGHT,
    *fields_of("wind.profile", "roughness", "exponent"),
)


def _measured_heights(wind: Wind) -> tuple[float, ...]:
    return () if wind.series is None else wind.series.heights


def _least_height(wind: Wind) -> float:
    """Return the lowest height above ground at which the wind of a scenario is defined [m]."""
    if wind.profile is not None:
        # The logarithmic law is not valid below the roughness length.
        return max(_LEAST_HEIGHT_M, wind.profile.roughness or 0.0)
    return _measured_heights(wind)[0]


@parameters_in("wind")
def parameters_of(scenario: Scenario) -> tuple[Parameter, ...]:
    """Return the parameters of block `wind`, which depend on the scenario's kind of wind."""
    wind = scenario.wind
    return (
        *(() if wind.grid is None else (FIELD_UNIT,)),
        *(_TIME_OFFSET if wind.series is None else ()),
        *(_VERTICAL if wind.vertical else ()),
        *(() if wind.profile is None else _PROFILE),
        *((_MEASURED,) if wind.series is not None and wind.series.times else ()),
        *((_LEAST_HEIGHT, _GREATEST_HEIGHT) if _measured_heights(wind) else ()),
    )


def _axis(scenario: Scenario, name: str) -> WindAxis:
    return scenario.wind.x if name == "x" else scenario.wind.y


def _mean(scenario: Scenario, name: str) -> float:
    direction = scenario.wind.direction
    share = cos(direction) if name == "x" else sine(direction)
    return _axis(scenario, name).mean + scenario.wind.speed * share


def mean_wind(scenario: Scenario) -> FloatArray:
    """Return the mean horizontal wind along world x and y, shape (2,) [m/s].

    For a formula, the mean is v_0. For a profile, it is the wind at the reference height; for
    measured heights, that at 10 m above the ground (`USUAL_HEIGHT`); for a field, that over all
    places.
    """
    wind = scenario.wind
    if wind.grid is not None:
        # Over the places with wind.
        told = wind.grid.components[:2].reshape(2, -1)
        return np.asarray(wind.field_scale * np.nanmean(told, axis=1))
    if wind.series is None:
        return np.array([_mean(scenario, name) for name in _HORIZONTAL])
    heights = wind.series.heights or (USUAL_HEIGHT,)
    return np.array(
        [
            np.interp(USUAL_HEIGHT, heights, np.reshape(speeds, (-1, len(heights))).mean(axis=0))
            for speeds in (wind.series.wind_x, wind.series.wind_y)
        ]
    )


def _angular_frequencies(scenario: Scenario, name: str) -> dict[int, float]:
    is_hertz = scenario.wind.frequency_unit is FrequencyUnit.HERTZ
    factor = tau if is_hertz else 1.0
    frequencies = _axis(scenario, name).frequencies
    return {k: factor * frequencies[k - 1] for k in HARMONICS}


def _axis_parameters(name: str, scenario: Scenario) -> tuple[Parameter, ...]:
    """Return the parameters of eqs. (11) and (12) of Yacef et al. along the world axis `name`.

    The result is empty if the wind comes from a file.
    """
    of_axis = (
        Parameter(name="mean", units=_SPEED, value=lambda s: _mean(s, name), doc="v_0: mean value"),
        Parameter(
            name="amplitudes",
            units=_SPEED,
            value=lambda s: dict(zip(HARMONICS, _axis(s, name).amplitudes, strict=True)),
            doc="A_k: amplitudes of the harmonics",
        ),
        Parameter(
            name="frequencies",
            units=units.rad / units.s,
            value=lambda s: _angular_frequencies(s, name),
            doc="Omega_k: frequencies of the harmonics",
        ),
        *fields_of(f"wind.{name}", "gust_amplitude", "gust_period"),
    )
    return of_axis if scenario.wind.is_formula else ()


_HORIZONTAL = ("x", "y")
for _name in _HORIZONTAL:
    parameters_in(f"wind.{_name}")(partial(_axis_parameters, _name))


def declare_wind(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare the wind velocity over time in block `wind`, from a formula, a table or a field.

    The expressions are `velocity_x`, `velocity_y` and, if the wind has a vertical part,
    `velocity_z` [m/s]. `m` already has the empty block `wind` and the parameter `clock`.
    """
    b, wind = m.wind, scenario.wind
    declare_parameters(b, scenario)
    if wind.profile is not None or _measured_heights(wind):
        _declare_height(b, m)
    if wind.profile is not None:
        _declare_profile(b, m, wind.profile.law)
    if wind.series is None:
        _declare_time(b, m)
    field = [] if wind.grid is None else declare_field(m, wind.grid, scenario)
    if field:
        for name, part in zip(_HORIZONTAL, field, strict=False):
            _add_velocity(b, m, name, partial(_of_field, part))
    elif wind.series is not None:
        _declare_series(m, wind.series, scenario)
    else:
        _declare_formula(m, scenario)
    rising = field[2:]
    if wind.vertical or rising:

        @b.Expression(m.time, doc="wind along world z [m/s]")
        def velocity_z(b: Block, t: float) -> NumericExpression:
            steady = 1 * b.vertical if wind.vertical else 0.0 * b.field_unit
            return sum((part[t] for part in rising), start=steady)


def _declare_time(b: Block, m: ConcreteModel) -> None:
    @b.Expression(m.time, doc="wind time [s]")
    def wind_time(b: Block, t: float) -> NumericExpression:
        return b.parent_block().clock[t] + b.time_offset


def _of_field(part: Expression, _b: Block, t: float) -> NumericExpression:
    return 1 * part[t]


def _declare_height(b: Block, m: ConcreteModel) -> None:
    """Declare the height above ground at which the wind is evaluated [m], at least `least_height`.

    The lower limit is smooth.
    """

    @b.Expression(m.time, doc="height above the least height [m]")
    def height_above(b: Block, t: float) -> NumericExpression:
        return height_above_ground(m, t) - b.least_height

    @b.Expression(m.time, doc="height at which the wind is read [m]")
    def height(b: Block, t: float) -> NumericExpression:
        return b.least_height + smooth_positive(b.height_above[t], HEIGHT_SMOOTHING)


def _declare_profile(b: Block, m: ConcreteModel, law: WindLaw) -> None:
    """Declare the ratio of the wind at the vehicle's height to the wind at the reference height.

    The docstring of this module has the two laws.
    """

    def power(b: Block, t: float) -> NumericExpression:
        return (b.height[t] / b.reference_height) ** b.exponent

    def logarithmic(b: Block, t: float) -> NumericExpression:
        return log(b.height[t] / b.roughness) / log(b.reference_height / b.roughness)

    rule = power if law is WindLaw.POWER else logarithmic
    b.profile = Expression(
        m.time, rule=rule, doc=f"{law.value} law: wind divided by the wind at h_r"
    )


def _at_height(b: Block, t: float, velocity: NumericExpression) -> NumericExpression:
    """Return the wind at the vehicle's height [m/s], given the wind `velocity` at h_r [m/s].

    Without a wind profile, the two are equal. h_r is the reference height of the profile.
    """
    profile = b.component("profile")
    return velocity if profile is None else profile[t] * velocity


def still_air(m: ConcreteModel) -> dict[str, float | Callable[[float], float]]:
    """Return the parameter values that set the wind of a model to zero, by full name.

    The parameters are all mutable speeds of block `wind`, such as "wind.x.mean". The value of a
    parameter over time is a function that returns zero. A user's own wind without such parameters
    is not changed.
    """
    calm: dict[str, float | Callable[[float], float]] = {}
    block = m.component("wind")
    for speed in () if block is None else block.component_objects(Param, descend_into=True):
        if not speed.mutable or not _is_speed(speed):
            continue
        if speed.index_set() is m.time:
            calm[speed.name] = lambda _t: 0.0
        else:
            calm |= {member.name: 0.0 for member in speed.values()}
    return calm


def _is_speed(parameter: Param) -> bool:
    try:
        units.convert_value(1.0, from_units=parameter.get_units(), to_units=_SPEED)
    except UnitsError:
        return False
    return True


def _declare_formula(m: ConcreteModel, scenario: Scenario) -> None:
    b = m.wind
    for name in _HORIZONTAL:
        axis = Block(doc=f"numbers of the wind along world {name}")
        b.add_component(name, axis)
        declare_parameters(axis, scenario)
        _declare_gust(axis, m)
        _add_velocity(b, m, name, partial(_velocity, name), "Yacef et al., eq. (11): wind")


def _add_velocity(
    b: Block,
    m: ConcreteModel,
    name: str,
    rule: Callable[[Block, float], NumericExpression],
    said: str = "wind",
) -> None:
    """Declare the wind along the world axis `name` at the vehicle's height, over time [m/s].

    It becomes a component of block `b`, over the time set of the model `m`. The rule `rule` returns
    the wind at the reference height [m/s]. `said` begins the component's documentation.
    """

    def velocity(b: Block, t: float) -> NumericExpression:
        return _at_height(b, t, rule(b, t))

    doc = f"{said} along world {name} [m/s]"
    b.add_component(f"velocity_{name}", Expression(m.time, rule=velocity, doc=doc))


def _velocity(name: str, b: Block, t: float) -> NumericExpression:
    """Return the wind along the world axis `name` at time `t` in flight [m/s], as a Pyomo rule.

    The wind is the sum of mean, harmonics and gust, eq. (11) of Yacef et al. `b` is the block
    `wind` of the model.
    """
    axis, wind_time = b.component(name), b.wind_time[t]
    harmonics = sum(axis.amplitudes[k] * sin(axis.frequencies[k] * wind_time) for k in HARMONICS)
    return axis.mean + harmonics + axis.gust[t]


def _declare_gust(axis: Block, m: ConcreteModel) -> None:
    @axis.Expression(m.time, doc="Yacef et al., eq. (12): gust [m/s]")
    def gust(axis: Block, t: float) -> NumericExpression:
        phase = 2 * pi * units.rad / axis.gust_period * axis.parent_block().wind_time[t]
        return 2 * axis.gust_amplitude / (1 + exp(-4 * (sin(phase) - 1)))


def _declare_series(m: ConcreteModel, series: WindSeries, scenario: Scenario) -> None:
    b = m.wind
    heights = np.array(series.heights)
    if series.heights:
        _declare_shapes(b, m, heights)
    for name, speeds in (("x", series.wind_x), ("y", series.wind_y)):
        table = np.reshape(speeds, (-1, max(1, len(heights))))
        weights = np.linalg.solve(_shapes(heights), table.T) if series.heights else table.T
        components = [f"measured_{name}", *(f"measured_{name}_{k}" for k in range(len(weights)))]
        components = components[1:] if series.heights else components[:1]
        for component, row in zip(components, weights, strict=True):
            doc = f"{component} along its world axis"
            if series.times:
                doc = f"{doc}, cubic spline, in measured_unit"
                held = _OverTime(series.times, row, scenario)
                table = Param(m.time, initialize=held.rule, mutable=True, doc=doc)
            else:
                table = Param(initialize=float(row[0]), mutable=True, units=_SPEED, doc=doc)
            b.add_component(component, table)
        _add_velocity(b, m, name, partial(_measured, components))


def _measured(components: Sequence[str], b: Block, t: float) -> NumericExpression:
    first, *parts = [
        b.measured_unit * held[t] if held.is_indexed() else held
        for held in map(b.component, components)
    ]
    return first + sum(part * b.shape[k, t] for k, part in enumerate(parts, start=1))


def _declare_shapes(b: Block, m: ConcreteModel, heights: FloatArray) -> None:
    """Declare the basis functions of the spline over height, for a wind measured at some heights.

    Below the lowest and above the highest measurement, the functions are constant, after a smooth
    transition.
    """
    shares, functions = _shares(heights), _truncated_powers(_shares(heights))

    @b.Expression(m.time, doc="height below the greatest height [m]")
    def height_below(b: Block, t: float) -> NumericExpression:
        return b.greatest_height - b.height[t]

    @b.Expression(m.time, doc="share of the measured heights below the vehicle")
    def height_share(b: Block, t: float) -> NumericExpression:
        read = b.greatest_height - smooth_positive(b.height_below[t], HEIGHT_SMOOTHING)
        return (read - b.least_height) / (b.greatest_height - b.least_height)

    doc = "basis functions of the cubic spline over height"

    @b.Expression(range(1, len(shares)), m.time, doc=doc)
    def shape(b: Block, k: int, t: float) -> NumericExpression:
        return functions[k](b.height_share[t])


def _shares(heights: FloatArray) -> FloatArray:
    return (heights - heights[0]) / (heights[-1] - heights[0])


def _shapes(heights: FloatArray) -> FloatArray:
    """Return the values of the spline's basis functions at the measured heights.

    The matrix has one row per height and one column per function.
    """
    shares = _shares(heights)
    return np.column_stack([[f(share) for share in shares] for f in _truncated_powers(shares)])


def _truncated_powers(shares: FloatArray) -> list[Callable[[Any], Any]]:
    """Return the truncated power basis of a cubic not-a-knot spline in height.

    `shares` are the measured heights, scaled to 0 to 1, ends included. The functions of a scaled
    height h are 1, h, h^2, h^3, and max(h - k, 0)^3 for each k in ``shares[2:-2]``.
    """
    # Three heights permit only a parabola, two heights a line.
    degree = min(_CUBIC, len(shares) - 1)
    begun = [partial(_power_from, float(share)) for share in shares[2:-2]]
    return [*(partial(_power, degree=n) for n in range(degree + 1)), *begun]


def _power(share: Any, degree: int) -> Any:
    return share**degree


def _power_from(start: float, share: Any) -> Any:
    beyond = share - start
    return ((beyond + abs(beyond)) / 2) ** _CUBIC


# Width over which the spline blends into the constant wind after the last row, relative to the
# median time between rows.
_PASSING_STEPS = 0.1
# Rows kept on either side of the rows within the time of a flight. The effect of a row on the
# spline decreases by a factor of 3.7 per row, so that rows farther away are below rounding.
_ROWS_BESIDE = 30


class _OverTime:
    """Wind speed along one axis, measured over time, as a spline that a Pyomo model can evaluate.

    `speeds` holds the speed [m/s] at each of `times` [s]. A wind measured over time and height has
    one such object for each coefficient of the spline over height. `speeds` then holds this
    coefficient at each time.
    """

    def __init__(self, times: Sequence[float], speeds: FloatArray, scenario: Scenario) -> None:
        from scipy.interpolate import CubicSpline  # noqa: PLC0415  for measured wind alone

        self._offset = scenario.wind.time_offset
        self._end = times[-1]
        self._width = _PASSING_STEPS * float(np.median(np.diff(times)))
        self._spline = CubicSpline(times, speeds)
        ends = self._offset, self._offset + scenario.mission.duration_limits[1]
        first, last = (int(row) for row in np.searchsorted(times, ends))
        # Rows far away in time are left out: the cost of an evaluation grows with the number of
        # rows.
        self._rows = slice(max(first - _ROWS_BESIDE, 0), last + _ROWS_BESIDE)

    def rule(self, _b: Block, t: Any) -> Any:
        """Return the wind speed (or coefficient) at a time in flight [m/s], as a Pyomo rule.

        A number `t` gives a number, a Pyomo expression `t` an expression. The result has no Pyomo
        unit.
        """
        if isinstance(t, int | float):
            return float(self._spline(self._until(t, self._end)))
        return self._table(self._until(t, float(self._spline.x[self._rows][-1])))

    def _until(self, t: Any, end: float) -> Any:
        # After the last measurement, the wind is constant, with a smooth transition.
        return end - smooth_positive(end - (t + self._offset), self._width)

    @cached_property
    def _table(self) -> Table:
        """Spline through the measurements during the longest permitted flight.

        It includes up to 30 measurements before and after this time, and leaves the others out.
        """
        times = self._spline.x[self._rows]
        return Table(times, self._spline(times), name="measured wind")
