"""Airspeed and battery current of a vehicle's steady return flight.

The charge that a mission must reserve for a return to the start or to a rally point follows from
them. The airspeed is the one that takes the least charge per metre over the ground against the wind
at the start of the mission. The current is evaluated at this airspeed and at the lowest state of
charge that the return may reach, because the current is greatest then.
"""

from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import minimize_scalar

from pyomo_quad.collocation import SolveError
from pyomo_quad.flight.steady import SteadyFlight
from pyomo_quad.scenario import Scenario

if TYPE_CHECKING:
    from pyomo_quad.flight.problems import Problems

# Range of the return flight's airspeed, above the wind speed [m/s].
_SLOWEST_M_S, _FASTEST_M_S = 1.0, 25.0
# Tolerance of the airspeed of least charge [m/s]: the charge per metre is flat near its minimum.
_TOLERANCE_M_S = 1e-3
# The model counts charge in A h, rates in A h/s.
_SECONDS_PER_HOUR = 3600.0


def with_return_flight(problems: "Problems", scenario: Scenario) -> Scenario:
    """Return the scenario with airspeed and current of the return flight filled in.

    A scenario is returned unchanged if it reserves no charge for a return, or if it gives both
    values.

    Raises
    ------
    SolveError
        If the vehicle cannot fly against the wind.
    """
    mission = scenario.mission
    told = mission.return_flight
    if not mission.return_reserve or None not in {told.airspeed, told.current}:
        return scenario
    plain = scenario.as_forecast().with_mission(return_reserve=False)
    steady = problems.steady_flight(plain)
    wind = float(np.hypot(*problems.winds_at(plain, mission.start.position)[0]))
    airspeed = told.airspeed or _cheapest(scenario, steady, wind)
    current = told.current or _current(scenario, steady, airspeed)
    held = told.model_copy(update={"airspeed": airspeed, "current": current})
    return scenario.with_mission(return_flight=held)


def _cheapest(scenario: Scenario, steady: SteadyFlight, wind: float) -> float:
    """Return the airspeed of least charge per metre over the ground in a head wind [m/s]."""

    def cost(airspeed: float) -> float:
        try:
            return _current(scenario, steady, airspeed) / (airspeed - wind)
        except SolveError:
            return np.inf

    bounds = (wind + _SLOWEST_M_S, wind + _FASTEST_M_S)
    found = minimize_scalar(
        cost, bounds=bounds, method="bounded", options={"xatol": _TOLERANCE_M_S}
    )
    if not np.isfinite(found.fun):
        raise SolveError(
            f"mission.return_reserve: no steady flight goes against the wind of {wind:.3g} m/s; "
            "fly in less wind, or give mission.return_flight.airspeed and current."
        )
    return float(found.x)


def _current(scenario: Scenario, steady: SteadyFlight, airspeed: float) -> float:
    """Return the battery current [A] of steady flight at the lowest state of charge allowed."""
    drawn = (1.0 - scenario.limits.least_charge) * steady.pack_capacity
    rate, reserve = steady.charge_rates(steady.trim([airspeed, 0.0, 0.0]), np.array([drawn]))
    if reserve[0] < 0.0:
        raise SolveError(f"the pack cannot give the power of flight at {airspeed:g} m/s.")
    return float(rate[0] * _SECONDS_PER_HOUR)
