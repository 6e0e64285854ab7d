"""Equations of the vehicle in the wind of simulated flights, with turbulence and random errors.

The wind, the mass and the hover power are known only approximately before a flight. Their errors
are independent normal random numbers. The scenario gives the standard deviations.
"""

from math import cos, hypot, sin
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.collocation import Dynamics, Problem, compile
from pyomo_quad.flight.caches import IN_TURBULENCE
from pyomo_quad.flight.ensemble import Draws
from pyomo_quad.flight.planning import Planner
from pyomo_quad.model import build_in_turbulence, parameter_values, structure_key
from pyomo_quad.model.build import guess_key
from pyomo_quad.model.limits import without_reserve
from pyomo_quad.model.turbulence import FILTER_STATES, NOISE, Gusts, turbulence_values
from pyomo_quad.model.wind import mean_wind
from pyomo_quad.scenario import Scenario

if TYPE_CHECKING:
    from pyomo_quad.arrays import FloatArray


def vehicle_flown(planner: Planner, scenario: Scenario) -> Dynamics:
    """Return the equations of the vehicle in the actual wind and its turbulence, for simulation.

    With turbulence, the states include those of the turbulence filters. The duration of the flight
    must be fixed.
    """
    if scenario.wind.turbulence is None:
        return planner.dynamics(scenario)
    end = scenario.mission.fixed_duration
    numbers = without_reserve(parameter_values(scenario) | turbulence_values(scenario)) or {}
    noise = Gusts.of(scenario).steps(end)
    problem = problem_in_turbulence(scenario)
    dynamics = problem.dynamics(parameters={**numbers, **noise}, horizon=(0.0, end))
    return dynamics.without_iterations()


def draw(planner: Planner, scenario: Scenario, count: int, seed: int) -> tuple[Dynamics, Draws]:
    """Draw random winds, masses and powers for `count` simulated flights of fixed duration.

    A scenario has an actual wind, and may have a forecast. If the scenario states an error of the
    forecast, each flight has the forecast wind plus a random error. Otherwise, all flights have the
    actual wind. Turbulence is drawn for each flight. The draws of a flight depend only on `seed`
    and its index. The returned equations are without random errors.
    """
    told = scenario.as_forecast().wind
    # With an error of the forecast, each wind is the forecast plus a random error.
    if told.speed_deviation or told.direction_deviation:
        scenario = as_expected(scenario)
    changes = unknowns(planner, scenario)
    if scenario.wind.turbulence is None and not changes:
        return planner.dynamics(scenario), Draws(count=count)
    end = scenario.mission.fixed_duration
    given = without_reserve(parameter_values(scenario) | turbulence_values(scenario)) or {}
    problem = problem_in_turbulence(scenario)
    dynamics = problem.dynamics(parameters=given, horizon=(0.0, end)).without_iterations()
    errors = np.array(
        [
            np.random.default_rng((seed, k, _OF_ERRORS)).standard_normal(len(changes))
            for k in range(count)
        ]
    )
    numbers: dict[str, FloatArray] = {}
    for change, error in zip(changes, errors.T, strict=True):
        for name, size in change.items():
            numbers[name] = numbers.get(name, given.get(name, 0.0)) + size * error
    gusts = [Gusts((seed, k)) for k in range(count)]
    noise = np.stack([gust.noise(end) for gust in gusts], axis=-1)
    start = [gust.start for gust in gusts]
    return dynamics, Draws(
        count=count,
        numbers=numbers,
        noise=dict(zip(NOISE, np.swapaxes(noise, 0, 1), strict=True)),
        start={name: np.array([begun[name] for begun in start]) for name in FILTER_STATES},
    )


# Part of the seed of the generator of a flight's errors, so that it differs from that of the gusts.
_OF_ERRORS = 1


def problem_in_turbulence(scenario: Scenario) -> Problem:
    """Return the compiled equations of a scenario with turbulence in its wind.

    The equations include the states of the turbulence filters. They are compiled once and then read
    from a cache.
    """
    turbulence = scenario.wind.turbulence
    key = structure_key(scenario), guess_key(scenario), turbulence
    problem = IN_TURBULENCE.get(key)
    if problem is None:
        problem = IN_TURBULENCE.store(key, compile(build_in_turbulence(scenario)))
    return problem


def as_expected(scenario: Scenario) -> Scenario:
    """Return a copy of a scenario with the forecast wind and the turbulence of the actual wind."""
    told = scenario.as_forecast()
    turbulence = {"turbulence": scenario.wind.turbulence}
    return told.model_copy(update={"wind": told.wind.model_copy(update=turbulence)})


def unknowns(planner: Planner, scenario: Scenario) -> tuple[dict[str, float], ...]:
    """Return the change of the model's parameters by one standard deviation of each uncertainty.

    For each uncertain quantity (speed and direction of the wind, mass, hover power), a dictionary
    maps full names of parameters of `problem_in_turbulence` to their changes. Quantities without
    standard deviation are left out.
    """
    told = scenario.as_forecast()
    along, aside = mean_wind(told).tolist()
    speed = hypot(along, aside)
    # In calm air, the error of the speed has the direction of the scenario's steady wind.
    ahead = (along / speed, aside / speed) if speed else _direction(told)
    # In calm air, `turned` is 0, and the direction is left out at the end.
    faster, turned = told.wind.speed_deviation, told.wind.direction_deviation * speed
    watts = scenario.power.hover_power_deviation
    share = watts / planner.steady_flight(told).hover_power if watts else 0.0
    changes: tuple[dict[str, float], ...] = (
        {_WIND_ERROR.format(a): faster * d for a, d in zip("xy", ahead, strict=True)},
        {
            _WIND_ERROR.format(a): turned * d
            for a, d in zip("yx", (ahead[0], -ahead[1]), strict=True)
        },
        {"vehicle.mass": scenario.vehicle.mass_deviation},
        {"power.error": share},
    )
    return tuple(change for change in changes if any(change.values()))


# Parameter with the forecast error of the wind along an axis [m/s].
_WIND_ERROR = "wind.error[{}]"


def _direction(told: Scenario) -> tuple[float, float]:
    return cos(told.wind.direction), sin(told.wind.direction)
