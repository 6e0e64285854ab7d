"""The paper's vehicle written a second time, flat, in vector Newton-Euler form.

From the paper (equation numbers in brackets) and the corrections to it that the README lists,
not from the package: a typo in a declared equation would pass every test that reads the same
declaration, and fails against this.
"""

import numpy as np

GRAVITY = 9.81
MASS = 1.3
ARM = 0.175
INERTIA = np.diag([0.081, 0.081, 0.142])
KB = 3.8305e-6
KAPPA = 2.2518e-8
IR = 4.1904e-5
KT = 0.0104
KV = 96.342
RESISTANCE = 0.2
SPIN = np.array([1.0, -1.0, 1.0, -1.0])
# Rotor 1 ahead, 2 to the left, 3 behind, 4 to the right, as the signs of (7) say.
POSITIONS = ARM * np.array([[1.0, 0, 0], [0, 1.0, 0], [-1.0, 0, 0], [0, -1.0, 0]])
UP = np.array([0.0, 0.0, 1.0])

# Rows of f_r: powers 3 to 0 of the torque; columns: powers 2 to 0 of the speed.
F_R = np.array(
    [
        [-1.72e-5, 0.014, -0.8796],
        [1.95e-5, -0.0157, 0.3385],
        [-6.98e-6, 5.656e-3, 0.2890],
        [4.09e-7, -3.908e-4, 0.1626],
    ]
)

# Table 2: v_0, A_k, Omega_k, v_gmax, T_g.
TABLE_2 = {
    "x": (1.0, (0.10, 0.25, 0.30), (0.5, 0.7, 1.0), 0.20, 10.0),
    "y": (0.5, (-0.05, -0.10, -0.30), (0.6, 1.0, 1.5), 0.20, 10.0),
}


def rotation(phi, theta, psi):
    """Body to world, yaw-pitch-roll."""
    cx, sx, cy, sy, cz, sz = (
        np.cos(phi), np.sin(phi), np.cos(theta), np.sin(theta), np.cos(psi), np.sin(psi)
    )  # fmt: skip
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def wind(t, hertz=False):
    """(11)-(12) with Table 2, m/s, three components."""
    components = []
    for mean, amplitudes, frequencies, gust, period in (TABLE_2["x"], TABLE_2["y"]):
        factor = 2 * np.pi if hertz else 1.0
        speed = mean + np.dot(amplitudes, np.sin(factor * np.array(frequencies) * t))
        speed += 2 * gust / (1 + np.exp(-4 * (np.sin(2 * np.pi / period * t) - 1)))
        components.append(speed)
    return np.array([*components, 0.0])


def angle_rates(phi, theta, spin):
    """Roll, pitch and yaw rates of which each turns about its own axis, together the spin."""
    level = rotation(phi, 0, 0).T
    axes = [[1, 0, 0], level @ [0, 1, 0], level @ rotation(0, theta, 0).T @ UP]
    return np.linalg.solve(np.transpose(axes), spin)


def air_on_body(body, omega, wind_velocity, plane=0.0, axis=0.0, lift=0.0, parasitic=(0, 0, 0)):
    """Force and moment of the air in body axes, on each rotor where it is and on the airframe."""
    spin, to_body = body[9:12], rotation(*body[6:9]).T
    air = body[3:6] - wind_velocity
    at_rotors = to_body @ air + np.cross(spin, POSITIONS)
    forces = -omega[:, None] * at_rotors * [plane, plane, axis]
    forces += lift * (at_rotors[:, :2] ** 2).sum(axis=1)[:, None] * UP
    pressed = np.sqrt(air @ air + 1e-6) * np.array(parasitic) * (to_body @ air)
    return forces.sum(axis=0) - pressed, np.cross(POSITIONS, forces).sum(axis=0)


def rates(body, omega, alpha, wind_velocity, drag=None, is_exact=False, rotor_air=None):
    """Time derivative of the 16 states; `drag` = (linear, quadratic) replaces (9)'s W.

    Exact attitude, unlike (9)'s, tells the angles' rates from the spin and has the body turn
    against rotors that gather speed.
    """
    velocity, (phi, theta, psi), spin = body[3:6], body[6:9], body[9:12]
    thrusts = KB * omega**2
    force = rotation(phi, theta, psi) @ (thrusts.sum() * UP) - MASS * GRAVITY * UP
    if drag is None:
        acceleration = force / MASS + wind_velocity
    else:
        air = velocity - wind_velocity
        # The package rounds the norm at 1 mm/s so that it can be differentiated.
        speed = np.sqrt(air @ air + 1e-6)
        acceleration = (force - drag[0] * air - drag[1] * speed * air) / MASS
    moment = np.cross(POSITIONS, thrusts[:, None] * UP).sum(axis=0)
    moment += (SPIN * KAPPA * omega**2).sum() * UP
    if is_exact:
        moment += IR * (SPIN * alpha).sum() * UP
    drum = IR * (SPIN * omega).sum() * np.cross(spin, UP)
    angular = np.linalg.solve(INERTIA, moment + drum - np.cross(spin, INERTIA @ spin))
    if rotor_air is not None:
        force_of_air, moment_of_air = air_on_body(body, omega, wind_velocity, **rotor_air)
        acceleration = acceleration + rotation(phi, theta, psi) @ force_of_air / MASS
        angular = angular + np.linalg.solve(INERTIA, moment_of_air)
    turning = angle_rates(phi, theta, spin) if is_exact else spin
    return np.concatenate([velocity, acceleration, turning, angular, alpha])


def shaft_torque(omega, alpha):
    """(1)."""
    return IR * alpha + KAPPA * omega**2


def motor(omega, alpha, friction=(0.0, 0.0)):
    """Current, voltage and power of each motor, (2)-(3)."""
    torque = shaft_torque(omega, alpha) + friction[0] + friction[1] * omega
    current = torque / KT
    voltage = RESISTANCE * current + omega / KV
    return current, voltage, voltage * current


def f_r(torque, omega):
    """The efficiency function of (8), as recovered."""
    return np.sum(
        [
            np.polyval(row, omega) * torque**power
            for row, power in zip(F_R, (3, 2, 1, 0), strict=True)
        ],
        axis=0,
    )


def smooth_maximum(a, b, width):
    return 0.5 * (a + b + np.sqrt((a - b) ** 2 + width**2))


def efficiency_power(omega, alpha, torque_floor, efficiency_floor, smoothing):
    """(8) with the regularisation that the README states."""
    torque = shaft_torque(omega, alpha)
    efficiency = f_r(smooth_maximum(torque, torque_floor, 1e-4), omega)
    efficiency = smooth_maximum(efficiency, efficiency_floor, 1e-3)
    return smooth_maximum(torque * omega / efficiency, 0.0, smoothing)


def battery(charge, power, cell, series, parallel):
    """State of charge, open-circuit voltage, voltage and current of the pack, (4)-(5)."""
    e0, k, a, b, capacity, resistance = cell
    drawn = charge / parallel
    open_circuit = series * (e0 - k * capacity / (capacity - drawn) + a * np.exp(-b * drawn))
    pack_resistance = resistance * series / parallel
    # V i = P with V = e - R i, the root that vanishes with P.
    current = np.min(np.roots([pack_resistance, -open_circuit, power]).real)
    voltage = open_circuit - pack_resistance * current
    return 100 * (1 - drawn / capacity), open_circuit, voltage, current


# A Matrice 100, for the momentum model: mass, thrust and drag of a rotor, drum and motor.
M100 = {
    "mass": 3.715, "kb": 3.7e-5, "radius": 0.1651, "density": 1.17, "induced": 1.12,
    "profile": 0.55, "advance": 4.65, "climb": 1.03, "descent": 0.47, "electronics": 10.0,
    "drum": 1.4e-4, "kt": 0.0273, "resistance": 0.12,
}  # fmt: skip


def airflow(body, wind_velocity):
    """Airspeed along the thrust and the size of that across it."""
    air = body[3:6] - wind_velocity
    axis = rotation(*body[6:9]) @ UP
    return axis @ air, np.linalg.norm(air - (axis @ air) * axis)


def induced_velocity(thrust, axial, in_plane, density, disc_area):
    """Glauert's equation with a term of the descent that leaves one root, by bisection."""
    sinking = 0.5 * (np.sqrt(axial**2 + 1e-4) - axial)

    def excess(v):
        flow = np.sqrt(in_plane**2 + (axial + v) ** 2 + sinking**2 / 7.67 + 1e-4)
        return 2 * density * disc_area * flow * v - thrust

    low, high = 0.0, 1e3
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) < 0 else (low, middle)
    return 0.5 * (low + high)


def momentum_power(body, omega, alpha, wind_velocity, craft):
    """Power of each rotor, and of all with the electronics, with v_i; SI units throughout."""
    axial, in_plane = airflow(body, wind_velocity)
    thrusts, area = craft["kb"] * omega**2, np.pi * craft["radius"] ** 2
    v_i = induced_velocity(thrusts.sum(), axial, in_plane, craft["density"], 4 * area)
    climbing = 0.5 * (1 + axial / np.hypot(axial, 0.5))
    factor = craft["climb"] * climbing + craft["descent"] * (1 - climbing)
    advance_ratio = in_plane / (omega * craft["radius"])
    profile = craft["profile"] * thrusts**1.5 / np.sqrt(craft["density"] * area)
    profile *= 1 + craft["advance"] * advance_ratio**2
    torque = craft["drum"] * alpha
    accelerating = torque * omega + craft["resistance"] * (torque / craft["kt"]) ** 2
    each = thrusts * (craft["induced"] * v_i + factor * axial) + profile + accelerating
    return each, each.sum() + craft["electronics"], v_i
