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

    Parameters
    ----------
    planner : Planner
        Planner that has compiled the equations without turbulence.
    scenario : Scenario
        A scenario with a fixed duration.

    Returns
    -------
    Dynamics
        With turbulence, equations that include the states of the turbulence filters. Without
        turbulence, the planner's own equations.
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
    """Draw random winds, masses and powers for many simulated flights.

    If the scenario states the error of its wind forecast, each flight has its own wind: the
    forecast plus a random error. Otherwise all flights have the actual wind.

    Parameters
    ----------
    planner : Planner
        Planner that has compiled the equations.
    scenario : Scenario
        A scenario with a fixed duration.
    count : int
        Number of flights.
    seed : int
        Seed of the random numbers.

    Returns
    -------
    Dynamics
        Equations of the vehicle for all flights, with parameter values free of random errors. With
        turbulence or uncertain quantities, the states include those of the turbulence filters.
    Draws
        Random parameter values, filter noise and initial filter states of each flight. They are
        empty if the scenario has neither turbulence nor uncertain quantities. The random numbers of
        a flight depend only on the seed and the index of the flight.
    """
    told = scenario.as_forecast().wind
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
    """Return a copy of a scenario whose wind is the forecast wind, with turbulence.

    Plans are made for the forecast wind. The turbulence is that of the wind in `scenario`.
    """
    told = scenario.as_forecast()
    turbulence = {"turbulence": scenario.wind.turbulence}
    return told.model_copy(update={"wind": told.wind.model_copy(update=turbulence)})


def unknowns(planner: Planner, scenario: Scenario) -> tuple[dict[str, float], ...]:
    """Return the change of the model's parameters by one standard deviation of each uncertainty.

    The uncertain quantities are speed and direction of the wind, mass, and hover power. A quantity
    without standard deviation in the scenario is left out. In calm air, the direction is left out,
    too.

    Parameters
    ----------
    planner : Planner
        Planner with which the hover power is computed, if the hover power is uncertain.
    scenario : Scenario
        Scenario that states the standard deviations and the forecast wind.

    Returns
    -------
    tuple of dict
        One dictionary for each uncertain quantity: full name of a parameter of
        `problem_in_turbulence` -> change of the parameter's value.
    """
    told = scenario.as_forecast()
    along, aside = mean_wind(told).tolist()
    speed = hypot(along, aside)
    # In calm air, the error of the speed has the direction of the scenario's steady wind.
    ahead = (along / speed, aside / speed) if speed else _direction(told)
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
