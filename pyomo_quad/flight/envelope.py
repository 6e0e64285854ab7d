"""Check of a plan against the validated range of its vehicle.

The validated range of airspeed, climb, descent and payload is the range that measured flights of
the vehicle cover.
"""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.arrays import FloatArray
from pyomo_quad.flight.columns import TIME, WIND, column_of
from pyomo_quad.flight.flight import VELOCITY_STATES
from pyomo_quad.scenario import Scenario

if TYPE_CHECKING:
    from pyomo_quad.flight.plan import Plan


_SPEEDS = tuple(column_of(name).name for name in VELOCITY_STATES)
# Relative excess over the validated range that is ignored: a plan with this range as a limit may
# exceed it by as much between its collocation points.
_ROUNDING = 1e-3
# Number of times at which a plan is sampled.
_SAMPLES = 2001


def departures(plan: "Plan") -> tuple[str, ...]:
    """Return a message for each quantity of a plan that leaves its vehicle's validated range.

    An example is "airspeed to 17.2 m/s, 16 m/s confirmed, for 3.1 s". It states the largest value,
    the bound of the validated range, and the time beyond this bound.
    """
    return tuple(
        departures_of(
            plan.scenario, plan.columns(np.linspace(*plan.trajectories.horizon, _SAMPLES))
        )
    )


def departures_of(scenario: Scenario, flown: Mapping[str, FloatArray]) -> Iterator[str]:
    """Yield a message for each quantity of a flight that is outside its vehicle's validated range.

    `flown` is the table of the flight: column name -> values over time. Without columns for
    velocity and wind, only the payload is checked.
    """
    validated, carried = scenario.vehicle.validated, scenario.vehicle.payload
    if validated.payload is not None and carried > validated.payload:
        yield f"payload {carried:g} kg, {validated.payload:g} kg confirmed"
    if not {*_SPEEDS, *WIND} <= set(flown):
        return
    vx, vy, vz = (np.asarray(flown[name], dtype=float) for name in _SPEEDS)
    wind_x, wind_y = (np.asarray(flown[name], dtype=float) for name in WIND)
    relative = vx - wind_x, vy - wind_y, vz - scenario.as_forecast().wind.vertical
    for words, speeds, most in (
        ("airspeed", np.linalg.norm(relative, axis=0), validated.airspeed),
        ("climb", vz, validated.climb_speed),
        ("descent", -vz, validated.descent_speed),
    ):
        if most is None or speeds.max() <= most * (1 + _ROUNDING):
            continue
        beyond = (speeds > most).astype(float)
        seconds = float(np.trapezoid(beyond, np.asarray(flown[TIME], dtype=float)))
        yield f"{words} to {speeds.max():.3g} m/s, {most:g} m/s confirmed, for {seconds:.2g} s"
