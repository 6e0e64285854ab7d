"""The vehicle written flat from the paper, with what a controlled flight asks of it."""

from math import cos, sin

import numpy as np

BODY = ("x", "y", "z", "vx", "vy", "vz", "phi", "theta", "psi", "p", "q", "r")


class FlatDynamics:
    """Eq. (6)-(7) and motor power for one scenario; `disturbance(t)` is an acceleration (3,)."""

    def __init__(self, scenario, disturbance=lambda t: np.zeros(3)):
        self.state_names = (
            *(f"rigid_body.{name}" for name in BODY),
            *(f"rotors.omega[{j}]" for j in range(1, 5)),
        )
        self.control_names = tuple(f"rotors.alpha[{j}]" for j in range(1, 5))
        self.v, self.g = scenario.vehicle, scenario.gravity
        self.disturbance = disturbance
        kb, k, arm = self.v.thrust_coefficient, self.v.drag_torque_coefficient, self.v.arm_length
        self.mixer = np.array(
            [[kb] * 4, [0, arm * kb, 0, -arm * kb], [-arm * kb, 0, arm * kb, 0], [k, -k, k, -k]]
        )
        self.start = np.zeros(16)
        self.start[:3] = scenario.mission.start.position
        self.start[8] = scenario.mission.start.yaw
        self.start[12:] = np.sqrt(self.v.total_mass * self.g / (4 * kb))

    def rates_and_integrand(self, t, x, u):
        return self.rates(t, x, u), self.power(x, u)

    def rates(self, t, x, u):
        v = self.v
        phi, theta, psi, p, q, r = x[6:12].tolist()
        w = x[12:]
        thrust, roll, pitch, yaw = (self.mixer @ w**2).tolist()
        direction = np.array(
            [
                cos(phi) * sin(theta) * cos(psi) + sin(phi) * sin(psi),
                cos(phi) * sin(theta) * sin(psi) - sin(phi) * cos(psi),
                cos(phi) * cos(theta),
            ]
        )
        acceleration = thrust / v.total_mass * direction + self.disturbance(t)
        acceleration[2] -= self.g
        imbalance = w[0] - w[1] + w[2] - w[3]
        moments = np.array(
            [
                (v.Iy - v.Iz) * q * r + v.rotor_inertia * q * imbalance + roll,
                (v.Iz - v.Ix) * p * r - v.rotor_inertia * p * imbalance + pitch,
                (v.Ix - v.Iy) * p * q + yaw,
            ]
        )
        return np.concatenate([x[3:6], acceleration, x[9:12], moments / (v.Ix, v.Iy, v.Iz), u])

    def power(self, x, u):
        v, w = self.v, x[12:]
        torque = v.rotor_inertia * u + v.drag_torque_coefficient * w**2
        current = torque / v.torque_constant
        voltage = v.motor_resistance * current + w / v.voltage_constant
        return float(voltage @ current)

    def evaluate(self, component, t, X, U):
        rows = ("total_thrust", "roll_moment", "pitch_moment", "yaw_moment")
        return X[:, 12:] ** 2 @ self.mixer[rows.index(component.removeprefix("rotors."))]


def table_2_wind(t):
    """Wind of the paper's Table 2 as the acceleration of eq. (9)."""
    gust = 2 * 0.2 / (1 + np.exp(-4 * (sin(2 * np.pi / 10 * t) - 1)))
    x = 1.0 + 0.10 * sin(0.5 * t) + 0.25 * sin(0.7 * t) + 0.30 * sin(t) + gust
    y = 0.5 - 0.05 * sin(0.6 * t) - 0.10 * sin(t) - 0.30 * sin(1.5 * t) + gust
    return np.array([x, y, 0.0])
