"""The vehicle in the wind that its flights meet: turbulence, and what was told wrongly.

A user knows the wind to come, the mass and the power of hover only roughly.  Each of these errors
is a normal number of its own, with the standard deviation that the scenario states.
"""

from math import cos, hypot, sin

import numpy as np
from numpy.typing import NDArray

from pyomo_quad.collocation import Dynamics, Problem, compile
from pyomo_quad.flight.ensemble import Draws
from pyomo_quad.flight.planning import Planner
from pyomo_quad.flight.recent import Recent
from pyomo_quad.model import build_in_turbulence, parameter_values, structure_key
from pyomo_quad.model.build import guess_key
from pyomo_quad.model.limits import without_reserve
from pyomo_quad.model.turbulence import (
    FILTER_STATES,
    NOISE,
    Gusts,
    mean_wind,
    turbulence_values,
)
from pyomo_quad.scenario import Scenario

FloatArray = NDArray[np.float64]

# Of a mission as planned and as flown at a cruise speed, with a neighbour each.
_MOST = 4
_PROBLEMS: Recent[Problem] = Recent(_MOST)


def vehicle_flown(planner: Planner, scenario: Scenario) -> Dynamics:
    """Return the vehicle as `Planner.dynamics` does, in the turbulence of the scenario's wind.

    Where the wind has no turbulence they are the same.

    Parameters
    ----------
    scenario : Scenario
        Of a fixed duration.
    """
    if scenario.wind.turbulence is None:
        return planner.dynamics(scenario)
    end = scenario.mission.fixed_duration
    numbers = without_reserve(parameter_values(scenario) | turbulence_values(scenario)) or {}
    noise = Gusts.of(scenario).steps(end)
    return problem_in_turbulence(scenario).dynamics(
        parameters={**numbers, **noise}, horizon=(0.0, end)
    )


def draw(planner: Planner, scenario: Scenario, count: int, seed: int) -> tuple[Dynamics, Draws]:
    """Draw the winds of many flights, and what is known only roughly.

    Returns
    -------
    Dynamics
        The vehicle in the mean wind.
    Draws
        Turbulence and errors of each flight, the same for a seed whatever count and duration.
    """
    changes = unknowns(planner, scenario)
    if scenario.wind.turbulence is None and not changes:
        return planner.dynamics(scenario), Draws(count=count)
    end = scenario.mission.fixed_duration
    numbers = without_reserve(parameter_values(scenario) | turbulence_values(scenario)) or {}
    dynamics = problem_in_turbulence(scenario).dynamics(parameters=numbers, horizon=(0.0, end))
    gusts = [Gusts((seed, flight)) for flight in range(count)]
    noise = np.stack([gust.noise(end) for gust in gusts], axis=-1)
    start = [gust.start for gust in gusts]
    errors = np.array(
        [np.random.default_rng((seed, k, 1)).standard_normal(4) for k in range(count)]
    )
    drawn: dict[str, FloatArray] = {}
    for number, change in enumerate(changes):
        for name, by in change.items():
            middle = drawn.get(name, np.full(count, numbers.get(name, 0.0)))
            drawn[name] = middle + by * errors[:, number]
    return dynamics, Draws(
        count=count,
        numbers=drawn,
        noise=dict(zip(NOISE, np.swapaxes(noise, 0, 1), strict=True)),
        start={name: np.array([begun[name] for begun in start]) for name in FILTER_STATES},
    )


def problem_in_turbulence(scenario: Scenario) -> Problem:
    """Return the compiled equations of a mission as it is flown in turbulence."""
    turbulence = scenario.wind.turbulence
    key = structure_key(scenario), guess_key(scenario), turbulence
    problem = _PROBLEMS.get(key)
    if problem is None:
        problem = _PROBLEMS.store(key, compile(build_in_turbulence(scenario)))
    return problem


def as_expected(scenario: Scenario) -> Scenario:
    """Return the scenario in the wind that plans expect: the forecast, with the turbulence."""
    told = scenario.as_forecast()
    turbulence = {"turbulence": scenario.wind.turbulence}
    return told.model_copy(update={"wind": told.wind.model_copy(update=turbulence)})


def unknowns(planner: Planner, scenario: Scenario) -> tuple[dict[str, float], ...]:
    """Return what is known roughly, each as the change of parameters by one standard deviation.

    The parameters, by full name, are those of `problem_in_turbulence`; changes add up.
    """
    told = scenario.as_forecast()
    along, aside = mean_wind(told.wind).tolist()
    speed = hypot(along, aside)
    # In calm air the error of the speed has the direction in which a steady wind would blow.
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


_WIND_ERROR = "wind.error[{}]"


def _direction(told: Scenario) -> tuple[float, float]:
    return cos(told.wind.direction), sin(told.wind.direction)
