"""The vehicle in the wind that its flights meet: the mean wind and its turbulence."""

import numpy as np

from pyomo_quad.collocation import Dynamics, Problem, compile
from pyomo_quad.flight.ensemble import Draws
from pyomo_quad.flight.planning import Planner
from pyomo_quad.flight.recent import Recent
from pyomo_quad.model import build_in_turbulence, parameter_values, structure_key
from pyomo_quad.model.build import guess_key
from pyomo_quad.model.limits import without_reserve
from pyomo_quad.model.turbulence import FILTER_STATES, NOISE, Gusts, turbulence_values
from pyomo_quad.scenario import Scenario

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
    """Draw the winds of many flights.

    Returns
    -------
    Dynamics
        The vehicle in the mean wind.
    Draws
        Turbulence of each flight, the same for a seed whatever the count and the duration.
    """
    if scenario.wind.turbulence is None:
        return planner.dynamics(scenario), Draws(count=count)
    end = scenario.mission.fixed_duration
    numbers = without_reserve(parameter_values(scenario) | turbulence_values(scenario))
    dynamics = problem_in_turbulence(scenario).dynamics(parameters=numbers, horizon=(0.0, end))
    gusts = [Gusts((seed, flight)) for flight in range(count)]
    noise = np.stack([gust.noise(end) for gust in gusts], axis=-1)
    start = [gust.start for gust in gusts]
    return dynamics, Draws(
        count=count,
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
