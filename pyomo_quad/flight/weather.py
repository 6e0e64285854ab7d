"""The vehicle in the actual wind of its flights: turbulence, and errors of the forecast.

A user knows the future wind, the mass and the hover power only approximately. Each of these errors
is an independent normal number with the standard deviation stated in the scenario.
"""

from math import cos, hypot, sin

from pyomo_quad.collocation import Dynamics, Problem, compile
from pyomo_quad.flight.planning import Planner
from pyomo_quad.flight.recent import Recent
from pyomo_quad.model import build_in_turbulence, parameter_values, structure_key
from pyomo_quad.model.build import guess_key
from pyomo_quad.model.limits import without_reserve
from pyomo_quad.model.turbulence import Gusts, mean_wind, turbulence_values
from pyomo_quad.scenario import Scenario

# Missions as planned and as flown at a cruise speed, with one neighbour each.
_MOST = 4
_PROBLEMS: Recent[Problem] = Recent(_MOST)


def vehicle_flown(planner: Planner, scenario: Scenario) -> Dynamics:
    """Return the vehicle of `Planner.dynamics` in the turbulence of the scenario's wind.

    Without turbulence the two are the same.

    Parameters
    ----------
    scenario : Scenario
        A scenario with a fixed duration.
    """
    if scenario.wind.turbulence is None:
        return planner.dynamics(scenario)
    end = scenario.mission.fixed_duration
    numbers = without_reserve(parameter_values(scenario) | turbulence_values(scenario)) or {}
    noise = Gusts.of(scenario).steps(end)
    return problem_in_turbulence(scenario).dynamics(
        parameters={**numbers, **noise}, horizon=(0.0, end)
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
    """Return the scenario in the wind that plans assume: the forecast, plus the turbulence."""
    told = scenario.as_forecast()
    turbulence = {"turbulence": scenario.wind.turbulence}
    return told.model_copy(update={"wind": told.wind.model_copy(update=turbulence)})


def unknowns(planner: Planner, scenario: Scenario) -> tuple[dict[str, float], ...]:
    """Return the uncertain quantities, each as the change of parameters by one standard deviation.

    The parameters, by full name, are those of `problem_in_turbulence`; changes are added.
    """
    told = scenario.as_forecast()
    along, aside = mean_wind(told.wind).tolist()
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


_WIND_ERROR = "wind.error[{}]"


def _direction(told: Scenario) -> tuple[float, float]:
    return cos(told.wind.direction), sin(told.wind.direction)
