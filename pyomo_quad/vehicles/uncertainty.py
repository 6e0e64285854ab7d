"""Uncertainty of an estimated vehicle's power: causes, range, and most informative measurement.

Method: see docs/theory/vehicle_from_data.md, eq. (10).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pyomo_quad.arrays import FloatArray
from pyomo_quad.flight import Planner
from pyomo_quad.identification.steady import level_powers
from pyomo_quad.vehicles.files import scenario_of
from pyomo_quad.vehicles.owner import (
    BLADE_RANGE,
    DRIVE_RANGE,
    MEASUREMENT_ERROR,
    EstimatedVehicle,
)

Numbers = Mapping[str, float]
_Change = Callable[[float], Numbers]

#: Airspeeds at which power and uncertainty are computed [m/s].
AIRSPEEDS = (0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 15.0)
_SCALED_BY_DRIVE = (
    "induced_power_factor",
    "profile_power_coefficient",
    "climb_power_factor",
    "descent_power_factor",
)


@dataclass(frozen=True, kw_only=True)
class Cause:
    """Cause of uncertainty of a vehicle's power.

    Attributes
    ----------
    name : str
        The uncertain quantity.
    measurement : str
        The measurement that would determine the quantity.
    low, high : ndarray, shape (len(AIRSPEEDS),)
        Power of level flight [W] with the quantity at the lower and at the upper end of its range,
        for each airspeed in `AIRSPEEDS` [m/s]; NaN at airspeeds that the vehicle cannot hold.
    """

    name: str
    measurement: str
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True, kw_only=True)
class PowerBand:
    """Power of level flight over airspeed, with its range of uncertainty.

    Attributes
    ----------
    power, low, high : ndarray, shape (len(AIRSPEEDS),)
        Best estimate, lower end and upper end of the power [W]. There is one value for each
        airspeed in the constant `AIRSPEEDS` [m/s]; NaN at airspeeds that the vehicle cannot hold.
    causes : tuple of Cause
        Causes of the uncertainty.
    """

    power: FloatArray
    low: FloatArray
    high: FloatArray
    causes: tuple[Cause, ...]

    def ranked(self) -> tuple[tuple[Cause, float], ...]:
        """Return each cause with its mean relative effect on the power, the largest effect first.

        The effect at one airspeed is abs(high - low) / (2 power). `low` and `high` are the powers
        at the two ends of the cause's range.
        """
        shares = [
            float(np.nanmean(np.abs(one.high - one.low) / (2 * self.power))) for one in self.causes
        ]
        order = np.argsort(shares)[::-1]
        return tuple((self.causes[k], shares[k]) for k in order)


def power_band(vehicle: EstimatedVehicle, planner: Planner | None = None) -> PowerBand:
    """Compute the power of an estimated vehicle over airspeed, with its range of uncertainty.

    Parameters
    ----------
    vehicle : EstimatedVehicle
        The vehicle, whose numbers have ranges.
    planner : Planner, optional
        Planner whose compiled models are used again in further calls; a new one by default.
    """
    scenario, planner = scenario_of(vehicle), planner or Planner()
    power = level_powers(scenario, AIRSPEEDS, planner)
    causes = []
    for name, measurement, low, high in _causes(vehicle):
        ends = [
            level_powers(
                scenario.with_values({f"vehicle.{field}": v for field, v in numbers.items()}),
                AIRSPEEDS,
                planner,
            )
            for numbers in (low, high)
        ]
        causes.append(Cause(name=name, measurement=measurement, low=ends[0], high=ends[1]))
    below = [np.minimum(np.minimum(c.low, c.high) - power, 0.0) for c in causes]
    above = [np.maximum(np.maximum(c.low, c.high) - power, 0.0) for c in causes]
    return PowerBand(
        power=power,
        low=power - _together(below),
        high=power + _together(above),
        causes=tuple(causes),
    )


def _together(changes: Sequence[FloatArray]) -> FloatArray:
    """Combine the effects of independent causes on the power to one change of the power [W].

    The result is the root of the sum of squares at each airspeed.
    """
    return np.sqrt(np.nansum(np.square(changes), axis=0))


def _causes(vehicle: EstimatedVehicle) -> list[tuple[str, str, Numbers, Numbers]]:
    """Return the uncertain quantities that affect a vehicle's power, with the ends of their ranges.

    The texts are the quantity and the measurement that would determine it. Each end maps affected
    fields of the table `vehicle` to values.
    """
    value = {name: one.value for name, one in vehicle.fields.items()}
    ends = {name: (one.low, one.high) for name, one in vehicle.fields.items()}
    drive = DRIVE_RANGE
    if vehicle.is_measured:
        drive = (1 - MEASUREMENT_ERROR, 1 + MEASUREMENT_ERROR)

    def drive_at(factor: float) -> Numbers:
        scaled = {name: factor * value[name] for name in _SCALED_BY_DRIVE}
        return scaled | {"induced_power_factor": max(1.0, scaled["induced_power_factor"])}

    def blades_at(factor: float) -> Numbers:
        changed = {"profile_power_coefficient": factor * value["profile_power_coefficient"]}
        if not vehicle.is_measured:
            return changed
        # The measured hover power is kept: a larger blade loss means a smaller induced power.
        more = (factor - 1) * value["profile_power_coefficient"] * np.sqrt(2)
        return changed | {"induced_power_factor": max(1.0, value["induced_power_factor"] - more)}

    def both(change: _Change, factors: tuple[float, float]) -> tuple[Numbers, Numbers]:
        return change(factors[0]), change(factors[1])

    def alone(name: str) -> tuple[Numbers, Numbers]:
        low, high = ends[name]
        return {name: low}, {name: high}

    def electronics_at(watts: float) -> Numbers:
        if vehicle.known.hover_power is None:
            return {"electronics_power": watts}
        rest = vehicle.known.hover_power - watts
        changed = drive_at(rest / (vehicle.known.hover_power - value["electronics_power"]))
        return {**changed, "electronics_power": watts}

    hover = (
        "a second sensor for the hover power"
        if vehicle.is_measured
        else "current and voltage in hover (--hover-current, --hover-voltage)"
    )
    ground = "current on the ground, motors off"
    level = "power of level flight at 5, 10 and 15 m/s (identify --steady)"
    return [
        ("efficiency of motors and controllers", hover, *both(drive_at, drive)),
        ("drag of the blades", level, *both(blades_at, BLADE_RANGE)),
        ("drag of the body over airspeed squared", level, *alone("drag_quadratic")),
        ("drag of the rotors over airspeed", level, *alone("drag_linear")),
        ("electronics", ground, *both(electronics_at, ends["electronics_power"])),
    ]
