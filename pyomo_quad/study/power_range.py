"""Whether the power model and the motors are used where they are sound."""

from collections.abc import Iterator

import numpy as np

from pyomo_quad.flight.steady import SteadyFlight
from pyomo_quad.model.finding import Finding, Severity
from pyomo_quad.scenario import PowerModel, Scenario

__all__ = ["power_findings"]

# Rotor speeds of a usual flight over that of hover, and how finely they are searched.
_SLOWEST, _FASTEST = 0.6, 1.1
_SPEEDS = 11
_ACCELERATIONS = 16
# A saving below this share of the power is within the rounding of the floors.
_SAVING = 1e-3


def power_findings(scenario: Scenario, steady: SteadyFlight) -> Iterator[Finding]:
    """Yield where the power model leaves its sound range near the mission's hover.

    Parameters
    ----------
    scenario : Scenario
        The mission.
    steady : SteadyFlight
        Of its vehicle.

    Yields
    ------
    Finding
        Cautions: the numbers can be computed, but mean less.
    """
    if scenario.power.model is PowerModel.EFFICIENCY:
        yield from _efficiency_findings(scenario, steady)
    yield from _voltage_findings(scenario, steady)


def _caution(subject: str, message: str) -> Finding:
    return Finding(severity=Severity.CAUTION, subject=subject, message=f"{subject} = {message}")


def _efficiency_findings(scenario: Scenario, steady: SteadyFlight) -> Iterator[Finding]:
    power, acceleration = scenario.power, scenario.limits.rotor_acceleration_max
    if power.regeneration:
        yield _caution(
            "power.regeneration",
            "true: with power.model efficiency braking earns more than it gave, so the least "
            "energy may be unbounded; set it false.",
        )
    hovering = steady.rotor_value("power.efficiency_polynomial", steady.hover_speed)
    if hovering < power.efficiency_floor:
        yield _caution(
            "power.efficiency_floor",
            f"{power.efficiency_floor:.4g}: above f_r = {hovering:.4g} at hover, so the floor and "
            "not f_r sets the energy; lower it.",
        )
    torque = steady.rotor_value("rotors.motor_torque", steady.hover_speed)
    if torque < power.torque_floor:
        yield _caution(
            "power.torque_floor",
            f"{power.torque_floor:.4g} N m: above the torque of hover, {torque:.4g} N m, so f_r is "
            "not read where the flight is; lower it.",
        )
    dearest = _fastest_chattering(steady, acceleration)
    if dearest is not None:
        yield _caution(
            "power.model",
            f"efficiency: at rotor speeds up to {dearest:.3g} rad/s (hover "
            f"{steady.hover_speed:.4g}) speeding up and slowing down in turn costs less than a "
            f"steady speed, so the optimum depends on limits.rotor_acceleration_max = "
            f"{acceleration:.4g} rad/s^2 and on the mesh; compare with power.model motor.",
        )


def _fastest_chattering(steady: SteadyFlight, limit: float) -> float | None:
    """Return the highest usual rotor speed at which changing speed is cheaper than keeping it."""
    hover = steady.hover_speed
    for speed in np.linspace(_FASTEST * hover, _SLOWEST * hover, _SPEEDS):
        # The chord from braking to speeding up, where it passes the steady speed.
        up = np.linspace(0.0, limit, _ACCELERATIONS)[1:]
        faster = steady.rotor_value("power.rotor_power", speed, up)
        slower = steady.rotor_value("power.rotor_power", speed, -up)
        mixed = (up[:, None] * slower + faster[:, None] * up) / (up[:, None] + up)
        keeping = steady.rotor_value("power.rotor_power", speed)
        if mixed.min() < keeping * (1 - _SAVING):
            return float(speed)
    return None


def _voltage_findings(scenario: Scenario, steady: SteadyFlight) -> Iterator[Finding]:
    hovering = steady.hover
    if hovering.power_W > hovering.greatest_battery_power_W:
        return  # the pack has no voltage under such a load, which is a finding of its own
    pack = hovering.battery_voltage_V
    motor = steady.rotor_value("rotors.motor_voltage", steady.hover_speed)
    if motor > pack:
        yield _caution(
            "battery.cells_series",
            f"{scenario.battery.cells_series}: hover needs {motor:.4g} V at the motors, the pack "
            f"gives {pack:.4g} V; add cells in series.",
        )
