"""Steady flight read off the declared model: rotor speed, power and battery at hover."""

from dataclasses import dataclass

from pyomo.environ import ConcreteModel, units, value
from scipy.optimize import brentq

from pyomo_quad.model.battery import CHARGE
from pyomo_quad.model.build import build_model
from pyomo_quad.scenario import Scenario

__all__ = ["Hover", "SteadyFlight", "battery_shortfalls", "charge", "hover", "hover_power"]


@dataclass(frozen=True, kw_only=True)
class Hover:
    """Hover in still air at the start of the mission: what one stands to pay per second."""

    rotor_speed_rad_per_s: float
    thrust_N: float
    power_W: float
    battery_current_A: float
    battery_voltage_V: float
    greatest_battery_power_W: float


class SteadyFlight:
    """The declared model with all rotors at one constant speed.

    Parameters
    ----------
    scenario : Scenario
        The mission whose model is built and evaluated.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.model: ConcreteModel = build_model(scenario)
        self._start = self.model.time.first()
        battery = self.model.battery
        missing_share = 1 - value(battery.initial_state_of_charge) / 100
        battery.charge_drawn[self._start].set_value(missing_share * value(battery.pack_capacity))

    @property
    def hover_speed(self) -> float:
        """Rotor speed that balances the weight, rad/s."""
        return float(value(self.model.mission.hover_speed))

    def set_rotor_speed(self, speed: float) -> None:
        """Give all rotors one speed and no acceleration.

        Parameters
        ----------
        speed : float
            Rotor speed, rad/s.
        """
        rotors = self.model.rotors
        for j in rotors.rotor:
            rotors.omega[j, self._start].set_value(speed)
            rotors.alpha[j, self._start].set_value(0.0)

    def thrust(self, speed: float) -> float:
        """Return the total thrust at a rotor speed.

        Parameters
        ----------
        speed : float
            Rotor speed, rad/s.

        Returns
        -------
        float
            Total thrust, N.
        """
        self.set_rotor_speed(speed)
        return float(value(self.model.rotors.total_thrust[self._start]))

    def power(self, speed: float) -> float:
        """Return the power of steady flight at a rotor speed.

        Parameters
        ----------
        speed : float
            Rotor speed, rad/s.

        Returns
        -------
        float
            Power of all rotors, W.
        """
        self.set_rotor_speed(speed)
        return float(value(self.model.power.total[self._start]))

    def power_at_thrust(self, thrust: float) -> float:
        """Return the power of steady flight at a total thrust.

        Parameters
        ----------
        thrust : float
            Total thrust, N, not negative.

        Returns
        -------
        float
            Power of all rotors, W.
        """
        if thrust <= 0.0:
            return self.power(0.0)
        fastest = self.hover_speed
        while self.thrust(fastest) < thrust:
            fastest *= 2.0
        speed = brentq(lambda s: self.thrust(s) - thrust, 0.0, fastest, xtol=1e-12, rtol=1e-15)
        return self.power(speed)

    def rotor_value(self, name: str, speed: float, acceleration: float = 0.0) -> float:
        """Return a quantity of one rotor at a speed and an acceleration.

        Parameters
        ----------
        name : str
            Full name of an expression over rotors and time, as ``"rotors.motor_torque"``.
        speed : float
            Rotor speed, rad/s.
        acceleration : float, optional
            Rotor acceleration, rad/s^2.

        Returns
        -------
        float
            In the expression's own unit.
        """
        rotors, start = self.model.rotors, self._start
        first = rotors.rotor.first()
        rotors.omega[first, start].set_value(float(speed))
        rotors.alpha[first, start].set_value(float(acceleration))
        return float(value(self.model.find_component(name)[first, start]))

    def yaw_moment(self, odd_speed: float, even_speed: float) -> float:
        """Return the yaw moment with rotors 1 and 3 at one speed, 2 and 4 at another.

        Parameters
        ----------
        odd_speed, even_speed : float
            Rotor speeds, rad/s.

        Returns
        -------
        float
            Moment, N m.
        """
        rotors, start = self.model.rotors, self._start
        for j in rotors.rotor:
            rotors.omega[j, start].set_value(odd_speed if j % 2 else even_speed)
        return float(value(rotors.yaw_moment[start]))

    def pack_under(self, power: float) -> tuple[float, float]:
        """Return the pack's current [A] and voltage [V] under a load, at the start.

        Parameters
        ----------
        power : float
            Power drawn, W.

        Returns
        -------
        tuple of float
            Current and terminal voltage.
        """
        total = self.model.power.total[self._start]
        declared = total.expr
        total.set_value(power * units.W)
        battery = self.model.battery
        found = (
            float(value(battery.current[self._start])),
            float(value(battery.voltage[self._start])),
        )
        total.set_value(declared)
        return found

    @property
    def pack_capacity(self) -> float:
        """Charge of the full pack, A h."""
        return float(value(self.model.battery.pack_capacity))

    def hover(self) -> Hover:
        """Return hover with the battery as it is at the start of the mission."""
        thrust = self.thrust(self.hover_speed)
        m, start = self.model, self._start
        return Hover(
            rotor_speed_rad_per_s=self.hover_speed,
            thrust_N=thrust,
            power_W=float(value(m.power.total[start])),
            battery_current_A=float(value(m.battery.current[start])),
            battery_voltage_V=float(value(m.battery.voltage[start])),
            greatest_battery_power_W=float(value(m.battery.greatest_power[start])),
        )


def hover(scenario: Scenario) -> Hover:
    """Return hover in still air under the scenario's power model.

    Parameters
    ----------
    scenario : Scenario
        The mission.

    Returns
    -------
    Hover
        Evaluated from the declared model.
    """
    return SteadyFlight(scenario).hover()


def hover_power(scenario: Scenario) -> float:
    """Return the power of hover in still air, W.

    Parameters
    ----------
    scenario : Scenario
        The mission.

    Returns
    -------
    float
        Power of all rotors under the scenario's power model.
    """
    return hover(scenario).power_W


def charge(current: float, duration: float) -> float:
    """Return the charge that a current takes in a time.

    Parameters
    ----------
    current : float
        Current, A.
    duration : float
        Time, s.

    Returns
    -------
    float
        Charge, A h.
    """
    return float(
        units.convert_value(current * duration, from_units=units.A * units.s, to_units=CHARGE)
    )


def battery_shortfalls(scenario: Scenario) -> tuple[str, ...]:
    """Say in which ways the pack is too small even for hovering through the mission.

    Parameters
    ----------
    scenario : Scenario
        The mission.

    Returns
    -------
    tuple of str
        One line for each shortfall, empty when the pack suffices.
    """
    steady = SteadyFlight(scenario)
    at_hover = steady.hover()
    pack = scenario.battery
    cells = f"battery {pack.use}, {pack.cells_series} x {pack.cells_parallel} cells"
    greatest = at_hover.greatest_battery_power_W
    if at_hover.power_W > greatest:
        needs = f"hover needs {at_hover.power_W:.4g} W, the pack delivers at most {greatest:.4g} W"
        return (f"{cells}: {needs}; add cells.",)
    duration = scenario.mission.duration
    needed = charge(at_hover.battery_current_A, duration)
    held = steady.pack_capacity * pack.initial_state_of_charge / 100
    if needed > held:
        needs = f"hovering for {duration:.4g} s needs {needed:.4g} Ah, the pack holds {held:.4g} Ah"
        return (f"{cells}: {needs}; add cells or shorten the mission.",)
    return ()
