"""The vehicle: airframe, rotors, motors and aerodynamic drag."""

from math import sqrt

from pyomo_quad.scenario.fields import ONE_LINE, Number, Part, Text, Triple, quantity

__all__ = ["ROTOR_COUNT", "EfficiencyMap", "Vehicle"]

ROTOR_COUNT = 4


class EfficiencyMap(Part):
    """Coefficients of f_r(tau, omega), each row (a, b, c) of a omega^2 + b omega + c."""

    cubic: Triple = quantity("", "row of tau^3; f_r is a pure number, tau in N m, omega in rad/s")
    quadratic: Triple = quantity("", "row of tau^2")
    linear: Triple = quantity("", "row of tau")
    constant: Triple = quantity("", "row without tau")


class Vehicle(Part):
    """A quadrotor: four equal rotors on arms along body x and y, numbered as in the paper."""

    use: Text = quantity("", "name of the vehicle in the library")
    title: Text = quantity(
        "", "name for people", pattern=ONE_LINE, allowed="one line", max_length=200
    )
    mass: Number = quantity("kg", "mass without payload", gt=0)
    payload: Number = quantity("kg", "mass carried, at the centre of mass", 0.0, ge=0)
    arm_length: Number = quantity("m", "centre of mass to rotor shaft (l)", gt=0)
    Ix: Number = quantity("kg*m^2", "moment of inertia about body x", gt=0)
    Iy: Number = quantity("kg*m^2", "moment of inertia about body y", gt=0)
    Iz: Number = quantity("kg*m^2", "moment of inertia about body z", gt=0)
    thrust_coefficient: Number = quantity("N*s^2", "thrust over rotor speed squared (kb)", gt=0)
    drag_torque_coefficient: Number = quantity(
        "N*m*s^2", "drag torque over rotor speed squared (kappa)", gt=0
    )
    rotor_inertia: Number = quantity("kg*m^2", "inertia of rotor and propeller (Ir)", gt=0)
    torque_constant: Number = quantity("N*m/A", "motor torque over current (kt)", gt=0)
    voltage_constant: Number = quantity("rad/s/V", "motor speed over voltage (kv)", gt=0)
    motor_resistance: Number = quantity("ohm", "winding resistance (R)", gt=0)
    friction_torque: Number = quantity("N*m", "dry friction of one motor (Tf)", 0.0, ge=0)
    viscous_damping: Number = quantity("N*m*s", "viscous friction of one motor (Df)", 0.0, ge=0)
    drag_linear: Number = quantity("kg/s", "linear drag on the relative airspeed", 0.0, ge=0)
    drag_quadratic: Number = quantity("kg/m", "quadratic drag on the relative airspeed", 0.0, ge=0)
    efficiency_map: EfficiencyMap = quantity("", "the recovered efficiency function f_r")

    @property
    def total_mass(self) -> float:
        """Mass in flight, kg."""
        return self.mass + self.payload

    def hover_speed(self, gravity: float) -> float:
        """Return the rotor speed at which the thrust balances the weight.

        Parameters
        ----------
        gravity : float
            Acceleration of gravity, m/s^2.

        Returns
        -------
        float
            Speed of each rotor, rad/s.
        """
        return sqrt(self.total_mass * gravity / (ROTOR_COUNT * self.thrust_coefficient))
