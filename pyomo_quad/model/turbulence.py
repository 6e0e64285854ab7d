"""Dryden turbulence at low altitude (MIL-F-8785C, section 3.7.3) as shaping filters.

symbol | name | unit | meaning
W_20 | wind_at_6_m | m/s | wind at 6 m (20 ft), which sets the intensity
h | height | m | height above the ground, from 10 to 1,000 ft
L_u = L_v, L_w | horizontal_length, vertical_length | m | length scales of the turbulence
sigma_u = sigma_v, sigma_w | horizontal_deviation, vertical_deviation | m/s | standard deviations
V | crossing_speed | m/s | speed at which the vehicle crosses the frozen gusts
xi | along, across, across_lag, upwards, upwards_lag | 1 | states of the filters
n | noise_along, noise_across, noise_upwards | 1/s^(1/2) | white noise of unit intensity
u, v, w | gust_along, gust_across, gust_upwards | m/s | along the mean relative wind, across, up

With a = V / L, each filter has one of two state forms (see docs/theory/risk.md, eqs. (1) to (3)):

    xi_1' = -a xi_1 + sqrt(a) n,                                   u = sigma sqrt(2) xi_1
    xi_1' = -a xi_1 + sqrt(a) n,  xi_2' = a (xi_1 - xi_2),
                                          v, w = sigma (sqrt(3) xi_1 + (1 - sqrt(3)) xi_2)

V is the airspeed, with the lower limit sigma_u: Taylor's hypothesis of frozen gusts holds only if
the vehicle crosses a gust faster than the gust changes: L / V < L / sigma.

The gust axes are horizontal and vertical. One horizontal axis has the constant direction of the
mission's mean relative wind. MIL-HDBK-1797 gives the same spectra at low altitude. Turbulence acts
on simulated flights only; plans are made without turbulence.
"""

from collections.abc import Callable, Sequence
from math import atan2, ceil, sqrt
from typing import Any

import numpy as np
from pyomo.core import Block, ConcreteModel, Constraint, Expression, Param, Var, cos, sin
from pyomo.core import sqrt as root
from pyomo.core.base.units_container import units
from pyomo.core.expr import NumericExpression, RelationalExpression
from pyomo.dae import DerivativeVar

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import Steps
from pyomo_quad.model.ground import height_above_ground
from pyomo_quad.model.parameters import (
    Parameter,
    add_parameters,
    floored,
    parameter_items,
)
from pyomo_quad.model.wind import mean_wind
from pyomo_quad.scenario import Scenario

_SPEED = units.m / units.s
_FOOT = 0.3048 * units.m
# Heights between which the low-altitude model is valid, MIL-F-8785C, section 3.7.3.4.
_LOWEST, _HIGHEST = 10.0 * _FOOT, 1000.0 * _FOOT
# Ranges of height and speed over which a law blends into the constant value beyond its range.
_HEIGHT_ROUNDING = 0.1 * units.m
_SPEED_ROUNDING = 0.1 * _SPEED
_ROOT_RATE = units.s**-0.5
_WORLD = ("x", "y", "z")

#: Step over which the noise is constant [s]: at 6 Hz, 5 % of the spectrum is missing.
NOISE_STEP = 0.02
_BLOCK = "wind.turbulence"
#: The noise of each filter, by full name.
NOISE = tuple(f"{_BLOCK}.noise_{axis}" for axis in ("along", "across", "upwards"))
#: The states of the filters, by full name.
FILTER_STATES = tuple(
    f"{_BLOCK}.{state}" for state in ("along", "across", "across_lag", "upwards", "upwards_lag")
)

# In the stationary state, the variances are 1/2 for xi_1 and 1/4 for xi_2, and the covariance is
# 1/4. This is the Cholesky factor of that covariance matrix.
_LAGGING = np.array([[sqrt(1 / 2), 0.0], [sqrt(1 / 8), sqrt(1 / 8)]])
LONG_RUN_FACTOR = np.zeros((5, 5))
LONG_RUN_FACTOR[0, 0] = sqrt(1 / 2)
LONG_RUN_FACTOR[1:3, 1:3] = LONG_RUN_FACTOR[3:5, 3:5] = _LAGGING


def _mean_direction(scenario: Scenario) -> float:
    """Return the direction of the mean airflow over the vehicle, counter-clockwise from x [rad]."""
    mission = scenario.mission
    way = np.subtract(mission.goal.position, mission.start.position)[:2]
    # Mean wind minus the mean velocity of the flight from start to goal.
    along, aside = (mean_wind(scenario) - way / scenario.nominal_duration).tolist()
    return atan2(aside, along)


PARAMETERS = (
    Parameter(
        name="wind_at_6_m",
        units=_SPEED,
        value=lambda s: s.wind.turbulence.strength if s.wind.turbulence else 0.0,
        doc="W_20: wind at 6 m, which sets the intensity",
    ),
    Parameter(
        name="direction",
        units=units.rad,
        value=_mean_direction,
        doc="direction of the mission's mean relative wind, counter-clockwise from x",
    ),
)


def turbulence_values(scenario: Scenario) -> dict[str, float]:
    """Return the values of the parameters in block `wind.turbulence`, by full name.

    `wind.turbulence.wind_at_6_m` is the wind at 6 m above the ground [m/s], zero without
    turbulence. `wind.turbulence.direction` is the direction of the mean airflow over the vehicle
    [rad].
    """
    return dict(parameter_items(_BLOCK, PARAMETERS, scenario))


def horizontal_length(height: Any) -> Any:
    """Return the length scale L_u = L_v of turbulence [m]: MIL-F-8785C, figure 10.

    `height` is the height above the ground [m]. In MIL-HDBK-1797, L_v is half of this length.
    """
    return height / (0.177 + 0.000823 * height / _FOOT) ** 1.2


def vertical_length(height: Any) -> Any:
    """Return the length scale L_w of vertical turbulence [m]: MIL-F-8785C, section 3.7.3.4.

    L_w equals `height`, the height above the ground [m].
    """
    return 1 * height


def vertical_deviation(wind_at_6_m: Any) -> Any:
    """Return the standard deviation sigma_w of gusts [m/s]: MIL-F-8785C, section 3.7.3.4.

    sigma_w applies to the vertical gusts. It is a tenth of `wind_at_6_m`, the mean wind at 6 m
    above the ground [m/s].
    """
    return 0.1 * wind_at_6_m


def horizontal_deviation(wind_at_6_m: Any, height: Any) -> Any:
    """Return the standard deviation sigma_u = sigma_v of gusts [m/s]: MIL-F-8785C, figure 11.

    The gusts are along two horizontal axes. `wind_at_6_m` is the mean wind at 6 m above the ground
    [m/s], and `height` the height above the ground at which the gusts act [m].
    """
    return vertical_deviation(wind_at_6_m) / (0.177 + 0.000823 * height / _FOOT) ** 0.4


def longitudinal_gust(deviation: Any, state: Any) -> Any:
    """Return the longitudinal gust u [m/s].

    `deviation` is the standard deviation of the gust [m/s], and `state` the dimensionless state
    xi_1 of the shaping filter that generates the gust.
    """
    return deviation * sqrt(2) * state


def transverse_gust(deviation: Any, state: Any, lag: Any) -> Any:
    """Return the transverse gust v or w [m/s].

    `deviation` is the standard deviation of the gust [m/s]. `state` and `lag` are the dimensionless
    states xi_1 and xi_2 of the shaping filter that generates the gust; xi_2 lags xi_1.
    """
    return deviation * (sqrt(3) * state + (1 - sqrt(3)) * lag)


def filter_rate(rate: Any, state: Any, noise: Any) -> Any:
    """Return the time derivative [1/s] of the state xi_1 of a Dryden shaping filter.

    `rate` is a = V / L [1/s], `state` is xi_1, and `noise` is white noise of unit intensity
    [1/s^(1/2)]. The stationary variance of xi_1 is 1/2.
    """
    return -rate * state + root(rate) * noise


def lag_rate(rate: Any, state: Any, lag: Any) -> Any:
    """Return the time derivative [1/s] of the state xi_2 of a Dryden shaping filter.

    `rate` is a = V / L [1/s], `state` is xi_1, and `lag` is xi_2, which lags xi_1.
    """
    return rate * (state - lag)


def declare_turbulence(m: ConcreteModel, scenario: Scenario) -> None:
    """Add Dryden turbulence and an error of the wind forecast to the wind of a model.

    The mutable parameter `wind.error` [m/s], initially zero, is the forecast error, which is added
    to the horizontal wind.
    No equation may refer to the wind yet, because its expressions are replaced.
    """
    b = m.wind.turbulence = Block(doc="turbulence, MIL-F-8785C at low altitude")
    add_parameters(b, PARAMETERS, scenario)
    m.wind.error = Param(
        _WORLD[:2], initialize=0.0, mutable=True, units=_SPEED, doc="error of the forecast"
    )
    for axis in _WORLD:
        mean = m.wind.component(f"velocity_{axis}")
        if mean is not None:
            m.wind.del_component(mean)
            m.wind.add_component(f"mean_velocity_{axis}", mean)
    _declare_scales(b, m)
    _declare_filters(b, m, scenario)
    _declare_gusts(b, m)
    _add_gusts(m)


def _declare_scales(b: Block, m: ConcreteModel) -> None:
    """Declare height, standard deviations, crossing speed and rates V / L of the filters.

    The height is clipped to the range for which the specification holds.
    """

    @b.Expression(m.time, doc="h: height at which the laws are read [m]")
    def height(_b: Block, t: float) -> NumericExpression:
        below = _HIGHEST - floored(height_above_ground(m, t), _LOWEST, _HEIGHT_ROUNDING)
        return _HIGHEST - floored(below, 0 * units.m, _HEIGHT_ROUNDING)

    @b.Expression(m.time, doc="standard deviation of u and v [m/s]")
    def deviation_horizontal(b: Block, t: float) -> NumericExpression:
        return horizontal_deviation(b.wind_at_6_m, b.height[t])

    @b.Expression(m.time, doc="standard deviation of w [m/s]")
    def deviation_vertical(b: Block, _t: float) -> NumericExpression:
        return vertical_deviation(b.wind_at_6_m)

    @b.Expression(m.time, doc="V: speed at which gusts are crossed [m/s]")
    def crossing_speed(b: Block, t: float) -> NumericExpression:
        body, wind = m.rigid_body, m.wind
        updraft = wind.component("mean_velocity_z")
        rising = body.vz[t] if updraft is None else body.vz[t] - updraft[t]
        squares = (
            (body.vx[t] - wind.mean_velocity_x[t]) ** 2
            + (body.vy[t] - wind.mean_velocity_y[t]) ** 2
            + rising**2
        )
        airspeed = root(squares + _SPEED_ROUNDING**2)
        return floored(airspeed, b.deviation_horizontal[t], _SPEED_ROUNDING)

    @b.Expression(m.time, doc="V / L_u [1/s]")
    def rate_horizontal(b: Block, t: float) -> NumericExpression:
        return b.crossing_speed[t] / horizontal_length(b.height[t])

    @b.Expression(m.time, doc="V / L_w [1/s]")
    def rate_vertical(b: Block, t: float) -> NumericExpression:
        return b.crossing_speed[t] / vertical_length(b.height[t])


def _declare_filters(b: Block, m: ConcreteModel, scenario: Scenario) -> None:
    """Declare the states, the white noise and the differential equations of the filters.

    The initial values of the states are random, from the seed of the scenario.
    """
    begun = Gusts.of(scenario).start
    for full_name in NOISE:
        noise = Param(m.time, initialize=_no_noise, mutable=True, units=_ROOT_RATE, doc="n")
        b.add_component(full_name.rpartition(".")[2], noise)
    for full_name in FILTER_STATES:
        name = full_name.rpartition(".")[2]
        state = Var(m.time, initialize=begun[full_name], doc=f"state of the filter: {name}")
        b.add_component(name, state)
        b.add_component(f"d{name}_dt", DerivativeVar(state, wrt=m.time, units=1 / units.s))
    rates = {"along": b.rate_horizontal, "across": b.rate_horizontal, "upwards": b.rate_vertical}
    for axis, rate in rates.items():
        _declare_filter(b, m, axis, rate)


def _no_noise(_b: Block, _t: Any) -> float:
    return 0.0


def _declare_filter(b: Block, m: ConcreteModel, axis: str, rate: Expression) -> None:
    state, lag = b.component(axis), b.component(f"{axis}_lag")
    noise = b.component(f"noise_{axis}")

    def shaping(b: Block, t: float) -> RelationalExpression:
        slope = b.component(f"d{axis}_dt")[t]
        return slope == filter_rate(rate[t], state[t], noise[t])

    doc = f"filter of the gust {axis} [1/s]"
    b.add_component(f"{axis}_shaping", Constraint(m.time, rule=shaping, doc=doc))
    if lag is None:
        return

    def lagging(b: Block, t: float) -> RelationalExpression:
        return b.component(f"d{axis}_lag_dt")[t] == lag_rate(rate[t], state[t], lag[t])

    doc = f"lag of the gust {axis} [1/s]"
    b.add_component(f"{axis}_lagging", Constraint(m.time, rule=lagging, doc=doc))


def _declare_gusts(b: Block, m: ConcreteModel) -> None:
    @b.Expression(m.time, doc="u: gust along the mean relative wind [m/s]")
    def gust_along(b: Block, t: float) -> NumericExpression:
        return longitudinal_gust(b.deviation_horizontal[t], b.along[t])

    @b.Expression(m.time, doc="v: gust across it [m/s]")
    def gust_across(b: Block, t: float) -> NumericExpression:
        return transverse_gust(b.deviation_horizontal[t], b.across[t], b.across_lag[t])

    @b.Expression(m.time, doc="w: gust upwards [m/s]")
    def gust_upwards(b: Block, t: float) -> NumericExpression:
        return transverse_gust(b.deviation_vertical[t], b.upwards[t], b.upwards_lag[t])


def _add_gusts(m: ConcreteModel) -> None:
    """Redefine the wind velocity along each world axis as mean wind plus gust.

    Along the horizontal axes, the error of the wind forecast is added, too.
    """
    b = m.wind.turbulence
    turned = {
        "x": lambda t: (
            cos(b.direction) * b.gust_along[t]
            - sin(b.direction) * b.gust_across[t]
            + m.wind.error["x"]
        ),
        "y": lambda t: (
            sin(b.direction) * b.gust_along[t]
            + cos(b.direction) * b.gust_across[t]
            + m.wind.error["y"]
        ),
        "z": lambda t: 1 * b.gust_upwards[t],
    }
    for axis, gust in turned.items():

        def velocity(
            b: Block,
            t: float,
            axis: str = axis,
            gust: Callable[[float], NumericExpression] = gust,
        ) -> NumericExpression:
            mean = b.component(f"mean_velocity_{axis}")
            return gust(t) if mean is None else mean[t] + gust(t)

        doc = f"wind along world {axis}, with its turbulence [m/s]"
        m.wind.add_component(f"velocity_{axis}", Expression(m.time, rule=velocity, doc=doc))


class Gusts:
    """Noise and initial filter states of the turbulence in one simulated flight, from a seed.

    Parameters
    ----------
    seed : int or sequence of int
        Seed of `numpy.random.default_rng`. For a flight of an ensemble, the seed consists of the
        seed of the ensemble and the number of the flight.
    """

    def __init__(self, seed: int | Sequence[int]) -> None:
        self._seed = seed

    @classmethod
    def of(cls, scenario: Scenario) -> "Gusts":
        """Return the turbulence of a single simulated flight, with the scenario's seed.

        The seed is 0 for a scenario without turbulence.
        """
        turbulence = scenario.wind.turbulence
        return cls(0 if turbulence is None else turbulence.seed)

    @property
    def start(self) -> dict[str, float]:
        """Initial values of the states of the turbulence filters, by full name.

        The values are a random sample from the stationary distribution of the states, drawn with
        the seed. An example of a full name is "wind.turbulence.along".
        """
        drawn = LONG_RUN_FACTOR @ np.random.default_rng(self._seed).standard_normal(
            len(FILTER_STATES)
        )
        return dict(zip(FILTER_STATES, drawn.tolist(), strict=True))

    def noise(self, duration: float) -> FloatArray:
        """Return the white noise of a flight per `NOISE_STEP`, shape (n_steps, 3) [1/s^(1/2)].

        The columns are for the filters along, across and upwards. With the same seed, the noise of
        a longer flight begins with the noise of a shorter flight.
        """
        generator = np.random.default_rng(self._seed)
        generator.standard_normal(len(FILTER_STATES))
        steps = ceil(duration / NOISE_STEP) + 1
        # The noise is constant in each time step. Its variance is 1 / NOISE_STEP.
        return generator.standard_normal((steps, len(NOISE))) / sqrt(NOISE_STEP)

    def steps(self, duration: float) -> dict[str, Steps]:
        """Return the white noise of a flight as step functions of time, by full parameter name.

        Each of the three filters has one parameter, such as "wind.turbulence.noise_along", with one
        value [1/s^(1/2)] per step of `NOISE_STEP` [s]. `duration` is the duration of the flight
        [s].
        """
        columns = self.noise(duration).T
        return {
            name: Steps(start=0.0, step=NOISE_STEP, values=tuple(column.tolist()))
            for name, column in zip(NOISE, columns, strict=True)
        }
