"""Flights made up from the plain second writing of the vehicle, as a log would have them."""

import numpy as np
import pandas as pd

from tests.agreement import plain_quadrotor as plain

# What the made-up vehicle is: that of the plain writing but for drag, and with a true anemometer.
DRAG = (0.3, 0.04)
CRAFT = plain.M100
VEHICLE = f"""use = "dji_matrice_100"

[fields]
title = "Pr\u00fcfling \U0001f681 \u2116 1"
mass = {CRAFT["mass"]}
thrust_coefficient = {CRAFT["kb"]}
rotor_radius = {CRAFT["radius"]}
induced_power_factor = {CRAFT["induced"]}
electronics_power = {CRAFT["electronics"]}
drag_linear = {DRAG[0]}
drag_quadratic = {DRAG[1]}
anemometer_factor = 1.0
profile_power_coefficient = 0.4
"""


def flight(number, speed, payload, seconds=50, noise_W=0.0):
    """A climb, a cruise against a steady wind, and a descent."""
    generator = np.random.default_rng(number)
    t = np.arange(seconds, dtype=float)
    phase = np.where(t < 10, 1, np.where(t < seconds - 10, 2, 3))
    along = speed * np.clip(np.minimum(t - 10, seconds - 10 - t) / 4, 0.0, 1.0)
    heading = 0.3 * number
    velocity = np.column_stack(
        [
            along * np.cos(heading),
            along * np.sin(heading),
            np.select([phase == 1, phase == 3], [2.5, -2.0], 0.2 * np.sin(t)),
        ]
    )
    wind = np.array([1.5, -1.0, 0.0])
    air = velocity - wind
    mass, density = CRAFT["mass"] + payload, 1.15 + 0.01 * number
    acceleration = np.gradient(velocity, t, axis=0)
    airspeed = np.sqrt(np.sum(air**2, axis=1, keepdims=True) + 1e-6)
    force = mass * (acceleration + plain.GRAVITY * plain.UP) + (DRAG[0] + DRAG[1] * airspeed) * air
    power = [_power(*row, density) for row in zip(force, air, strict=True)]
    return pd.DataFrame(
        {
            "flight": number,
            "time_s": t,
            "phase": phase,
            "payload_kg": payload,
            "air_density_kg_m3": density,
            "power_W": np.array(power) + noise_W * generator.standard_normal(seconds),
            "vel_north_m_s": velocity[:, 0],
            "vel_east_m_s": velocity[:, 1],
            "vel_up_m_s": velocity[:, 2],
            "air_vel_north_m_s": air[:, 0],
            "air_vel_east_m_s": air[:, 1],
        }
    )


def _power(force, air, density):
    """Power of the plain vehicle with its thrust along a force."""
    thrust = np.linalg.norm(force)
    axis = force / thrust
    body = np.zeros(12)
    body[3:6] = air
    body[6:8] = -np.arcsin(axis[1]), np.arctan2(axis[0], axis[2])
    omega = np.full(4, np.sqrt(thrust / 4 / CRAFT["kb"]))
    craft = CRAFT | {"density": density}
    return plain.momentum_power(body, omega, np.zeros(4), np.zeros(3), craft)[1]


def flights(noise_W=0.0):
    plans = [(1, 4.0, 0.0), (2, 8.0, 0.0), (3, 12.0, 0.25), (4, 6.0, 0.5), (5, 10.0, 0.5)]
    return pd.concat([flight(*plan, noise_W=noise_W) for plan in plans], ignore_index=True)
