"""The horizontal wind in world axes, eq. (11)-(12), or one measured and given as a table.

symbol | name | unit | meaning
v_0 | mean | m/s | mean value, with the scenario's steady wind added
A_k, Omega_k | amplitudes[k], frequencies[k] | m/s, rad/s | three harmonics
v_gmax, T_g | gust_amplitude, gust_period | m/s, s | gust
t | wind_time | s | wind time: time in flight plus the scenario's offset

The gust of eq. (12) peaks at v_gmax a quarter of a period after its start.
"""

from collections.abc import Callable
from math import cos, pi, tau
from math import sin as sine

from pyomo.core.base.units_container import UnitsError
from pyomo.core.expr import NumericExpression
from pyomo.environ import Block, ConcreteModel, Param, exp, sin, units
from scipy.interpolate import CubicSpline

from pyomo_quad.model.parameters import Parameter, declare_parameters
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.wind import FrequencyUnit, WindAxis, WindSeries

HARMONICS = (1, 2, 3)
_SPEED = units.get_units(units.m / units.s)

PARAMETERS = (
    Parameter(
        name="time_offset",
        units=units.s,
        value=lambda s: s.wind.time_offset,
        doc="wind time at the start of the flight",
    ),
)


def _axis(scenario: Scenario, name: str) -> WindAxis:
    return scenario.wind.x if name == "x" else scenario.wind.y


def _mean(scenario: Scenario, name: str) -> float:
    direction = scenario.wind.direction
    share = cos(direction) if name == "x" else sine(direction)
    return _axis(scenario, name).mean + scenario.wind.speed * share


def _angular_frequencies(scenario: Scenario, name: str) -> dict[int, float]:
    is_hertz = scenario.wind.frequency_unit is FrequencyUnit.HERTZ
    factor = tau if is_hertz else 1.0
    frequencies = _axis(scenario, name).frequencies
    return {k: factor * frequencies[k - 1] for k in HARMONICS}


def _axis_parameters(name: str) -> tuple[Parameter, ...]:
    return (
        Parameter(name="mean", units=_SPEED, value=lambda s: _mean(s, name), doc="v_0: mean value"),
        Parameter(
            name="amplitudes",
            units=_SPEED,
            value=lambda s: {k: _axis(s, name).amplitudes[k - 1] for k in HARMONICS},
            doc="A_k: amplitudes of the harmonics",
            index=HARMONICS,
        ),
        Parameter(
            name="frequencies",
            units=units.rad / units.s,
            value=lambda s: _angular_frequencies(s, name),
            doc="Omega_k: frequencies of the harmonics",
            index=HARMONICS,
        ),
        Parameter(
            name="gust_amplitude",
            units=_SPEED,
            value=lambda s: _axis(s, name).gust_amplitude,
            doc="v_gmax: gust amplitude",
        ),
        Parameter(
            name="gust_period",
            units=units.s,
            value=lambda s: _axis(s, name).gust_period,
            doc="T_g: gust period",
        ),
    )


AXIS_PARAMETERS = {name: _axis_parameters(name) for name in ("x", "y")}


def declare_wind(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare the wind velocity in block `wind`, as a formula or as a splined table.

    Parameters
    ----------
    m : ConcreteModel
        With `time` and `clock`.
    """
    m.wind = Block(doc="wind, eq. (11)-(12)")
    series = scenario.wind.series
    if series is None:
        _declare_formula(m, scenario)
    else:
        _declare_series(m, series, scenario.wind.time_offset)


def still_air(m: ConcreteModel) -> dict[str, float | Callable[[float], float]]:
    """Return the parameters of a model, with the values at which no wind blows.

    Every mutable parameter of block `wind` that is a speed is nought, so that a wind of the user's
    own is stilled as well; one that is no parameter keeps blowing.
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
    declare_parameters(b, PARAMETERS, scenario)

    @b.Expression(m.time, doc="wind time [s]")
    def wind_time(b: Block, t: float) -> NumericExpression:
        return b.parent_block().clock[t] + b.time_offset

    for name, table in AXIS_PARAMETERS.items():
        axis = Block(doc=f"numbers of the wind along world {name}")
        b.add_component(name, axis)
        declare_parameters(axis, table, scenario)
        _declare_gust(axis, m)

    @b.Expression(m.time, doc="eq. (11): wind along world x [m/s]")
    def velocity_x(b: Block, t: float) -> NumericExpression:
        return _velocity(b.x, t)

    @b.Expression(m.time, doc="eq. (11): wind along world y [m/s]")
    def velocity_y(b: Block, t: float) -> NumericExpression:
        return _velocity(b.y, t)


def _velocity(axis: Block, t: float) -> NumericExpression:
    """Return eq. (11): mean, harmonics and gust."""
    wind_time = axis.parent_block().wind_time[t]
    harmonics = sum(axis.amplitudes[k] * sin(axis.frequencies[k] * wind_time) for k in HARMONICS)
    return axis.mean + harmonics + axis.gust[t]


def _declare_gust(axis: Block, m: ConcreteModel) -> None:
    @axis.Expression(m.time, doc="eq. (12): gust [m/s]")
    def gust(axis: Block, t: float) -> NumericExpression:
        phase = 2 * pi * units.rad / axis.gust_period * axis.parent_block().wind_time[t]
        return 2 * axis.gust_amplitude / (1 + exp(-4 * (sin(phase) - 1)))


def _declare_series(m: ConcreteModel, series: WindSeries, offset: float) -> None:
    b = m.wind
    splines = {
        f"measured_{name}": _spline(series.times, speeds, offset)
        for name, speeds in (("x", series.wind_x), ("y", series.wind_y))
    }
    for name, spline in splines.items():

        def measured(_b: Block, t: float, spline: Callable[[float], float] = spline) -> float:
            return spline(t)

        table = Param(
            m.time,
            initialize=measured,
            mutable=True,
            units=_SPEED,
            doc=f"{name} along its world axis, cubic spline [m/s]",
        )
        b.add_component(name, table)

    @b.Expression(m.time, doc="wind along world x [m/s]")
    def velocity_x(b: Block, t: float) -> NumericExpression:
        return b.measured_x[t]

    @b.Expression(m.time, doc="wind along world y [m/s]")
    def velocity_y(b: Block, t: float) -> NumericExpression:
        return b.measured_y[t]


def _spline(
    times: tuple[float, ...], speeds: tuple[float, ...], offset: float
) -> Callable[[float], float]:
    """Return measured speed as a function of the time in flight."""
    spline = CubicSpline(times, speeds)
    return lambda t: float(spline(t + offset))
