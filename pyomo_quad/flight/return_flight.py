"""Airspeed and battery currents of a vehicle's steady return flight.

A mission may reserve battery charge for a return to the start or to a rally point. The airspeed
minimises the charge per metre over the ground, against the wind at the mission's start. Over
terrain, the return begins with a climb, which has its own current. Both currents are those at the
lowest allowed state of charge, where the voltage is lowest. See docs/theory/homing.md.
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
    """Return the scenario with airspeed and battery currents of the return flight filled in.

    Given values are kept. `problems` computes steady flights of the vehicle, and the wind. The
    current of the climb is filled in only over terrain. A scenario without
    `mission.return_reserve` is returned unchanged. Raises a SolveError if the vehicle or its pack
    cannot fly against the wind, or climb.
    """
    mission = scenario.mission
    told = mission.return_flight
    is_hilly = scenario.airspace.ground is not None
    needed = {told.airspeed, told.current, *([told.climb_current] if is_hilly else [])}
    if not mission.return_reserve or None not in needed:
        return scenario
    plain = scenario.as_forecast().with_mission(return_reserve=False)
    steady = problems.steady_flight(plain)
    wind = float(np.hypot(*problems.winds_at(plain, mission.start.position)[0]))
    airspeed = told.airspeed or _cheapest(scenario, steady, wind)
    current = told.current or _current(scenario, steady, airspeed)
    held = told.model_copy(update={"airspeed": airspeed, "current": current})
    if is_hilly:
        climbing = told.climb_current or climb_current(scenario, steady, airspeed)
        held = held.model_copy(update={"climb_current": climbing})
    return scenario.with_mission(return_flight=held)


def _cheapest(scenario: Scenario, steady: SteadyFlight, wind: float) -> float:
    """Return the airspeed of least battery charge per metre over the ground [m/s].

    `wind` is the head wind [m/s]. Raises a SolveError if no airspeed is possible.
    """

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


def climb_current(scenario: Scenario, steady: SteadyFlight, airspeed: float) -> float:
    """Return the battery current [A] of the climb of a return flight, at the lowest charge allowed.

    It is the greater of the currents at zero airspeed and at `airspeed` [m/s]; see
    docs/theory/homing.md, eq. (10). Raises a SolveError if the climb is impossible.
    """
    rate = scenario.mission.return_flight.climb_rate
    return max(_current(scenario, steady, level, rate) for level in (0.0, airspeed))


def _current(
    scenario: Scenario, steady: SteadyFlight, airspeed: float, climb: float = 0.0
) -> float:
    """Return the battery current [A] of steady flight at the lowest state of charge allowed.

    `airspeed` (horizontal) and `climb` are in m/s. Raises a SolveError if the pack cannot give the
    power.
    """
    drawn = (1.0 - scenario.limits.least_charge) * steady.pack_capacity
    rate, reserve = steady.charge_rates(steady.trim([airspeed, 0.0, climb]), np.array([drawn]))
    if reserve[0] < 0.0:
        raise SolveError(
            f"the pack cannot give the power of flight at {airspeed:g} m/s"
            f"{f' in a climb at {climb:g} m/s' if climb > 0.0 else ''}."
        )
    return float(rate[0] * _SECONDS_PER_HOUR)
