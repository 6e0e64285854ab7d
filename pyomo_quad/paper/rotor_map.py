"""Power and efficiency of one rotor, sampled from the declared equations; floors of the energy.

`docs/theory` has no page on these floors: `examination.md.j2` prints their derivation beside them.
"""

from dataclasses import dataclass

import numpy as np

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import Dynamics
from pyomo_quad.flight.columns import ROTORS
from pyomo_quad.paper.experiments import Experiment, paper_scenario
from pyomo_quad.paper.readings import Reading
from pyomo_quad.scenario import Scenario

#: Bounds on the rotor acceleration for which the floors are computed, rad/s².
BOUNDS = (10, 30, 100, 200, 300, 500, 600, 700, 800, 900, 1000, 1100, 1150, 1250, 1500, 2000, 3000)
_HIGHER_BOUNDS = (5000, 7500, 10000, 20000)
# Samples of the floors: twice as many move a floor by 0.6 % at most.
_SPEEDS, _ACCELERATIONS = 141, 90
_SMALLEST_ACCELERATION = 1.0  # rad/s², of the logarithmic samples
# Samples of the figure of f_r.
_MAP_SPEEDS, _TORQUES = 106, 101
#: Torques that the figure shows, N m: from hard braking to hard acceleration.
TORQUE_RANGE = (-0.12, 0.14)


@dataclass(frozen=True, kw_only=True)
class RotorMap:
    """Power and efficiency of one rotor, sampled.

    Attributes
    ----------
    speed : ndarray, shape (n,)
        rad/s, rising from 0.
    acceleration : ndarray, shape (k,)
        rad/s², rising, symmetric about 0.
    thrust : ndarray, shape (n,)
        Thrust of one rotor, N.
    torque, power : ndarray, shape (n, k)
        N m and W.
    efficiency : ndarray, shape (n, k)
        f_r without floors where the model has it, else 1.
    """

    speed: FloatArray
    acceleration: FloatArray
    thrust: FloatArray
    torque: FloatArray
    power: FloatArray
    efficiency: FloatArray


def rotor_map(
    dynamics: Dynamics, speed: FloatArray, acceleration: FloatArray, efficiency: str | None
) -> RotorMap:
    """Sample the declared power of one rotor.

    Parameters
    ----------
    speed, acceleration : ndarray
        rad/s and rad/s².
    efficiency : str, optional
        Component that holds the efficiency.
    """
    count = speed.size * acceleration.size
    states = np.zeros((count, len(dynamics.state_names)))
    controls = np.zeros((count, len(dynamics.control_names)))
    speeds, accelerations = np.meshgrid(speed, acceleration, indexing="ij")
    for rotor in ROTORS:
        states[:, dynamics.state_names.index(f"rotors.omega[{rotor}]")] = speeds.ravel()
        controls[:, dynamics.control_names.index(f"rotors.alpha[{rotor}]")] = accelerations.ravel()
    components = ["rotors.motor_torque", "power.rotor_power", *([efficiency] if efficiency else [])]
    keys = [("rotors.total_thrust", None), *((name, ROTORS[0]) for name in components)]
    table = dynamics.table(tuple(keys), np.zeros(count), states, controls)
    thrust, torque, power, *efficiencies = (column.reshape(speeds.shape) for column in table.T)
    return RotorMap(
        speed=speed,
        acceleration=acceleration,
        thrust=thrust[:, 0] / len(ROTORS),
        torque=torque,
        power=power,
        efficiency=efficiencies[0] if efficiencies else np.ones_like(power),
    )


def envelope_at(x: FloatArray, y: FloatArray, at: float) -> FloatArray:
    """Return the convex envelope of sampled functions at one place.

    Parameters
    ----------
    x : ndarray, shape (k,)
        Rising.
    y : ndarray, shape (..., k)
        Values of one or more functions.
    at : float
        Between the ends of x.

    Returns
    -------
    ndarray, shape (...)
        The least chord over the place.
    """
    left, right = x <= at, x >= at
    width = x[right][None, :] - x[left][:, None]
    share = np.divide(at - x[left][:, None], width, out=np.zeros_like(width), where=width > 0)
    chords = y[..., left][..., :, None] * (1 - share) + y[..., right][..., None, :] * share
    return chords.min(axis=(-2, -1))


def chattering_floors(
    reading: Reading, bounds: tuple[float, ...] = BOUNDS + _HIGHER_BOUNDS
) -> FloatArray:
    """Return the least energies of any flight of the paper's mission, with alternating speeds.

    Parameters
    ----------
    bounds : tuple of float
        Bounds on the rotor acceleration, rad/s².

    Returns
    -------
    ndarray, shape (len(bounds), 2)
        Bound and energy [J], minus infinity where f_r passes zero.
    """
    scenario = paper_scenario(Experiment.CALM, reading.values())
    largest = max(bounds)
    upward = np.union1d(np.geomspace(_SMALLEST_ACCELERATION, largest, _ACCELERATIONS), bounds)
    sampled = rotor_map(
        reading.planner().dynamics(scenario),
        np.linspace(0.0, scenario.limits.rotor_speed_max, _SPEEDS),
        np.concatenate([-upward[::-1], [0.0], upward]),
        "power.drive_efficiency",
    )
    return np.array([[bound, floor_energy(scenario, sampled, bound)] for bound in bounds])


def floor_energy(scenario: Scenario, sampled: RotorMap, bound: float) -> float:
    """Return the least energy, J, of a flight whose rotors keep a bound on |alpha|, rad/s²."""
    allowed = np.abs(sampled.acceleration) <= bound
    if sampled.efficiency[:, allowed].min() <= 0.0:
        return -np.inf
    steady = envelope_at(sampled.acceleration[allowed], sampled.power[:, allowed], 0.0)
    weight = scenario.vehicle.total_mass * scenario.gravity
    least = envelope_at(sampled.thrust, steady, weight / len(ROTORS))
    return float(least) * len(ROTORS) * scenario.mission.fixed_duration


def critical_acceleration(samples: int = 151) -> tuple[float, float]:
    """Return the least bound on the rotor acceleration at which f_r reaches zero.

    Parameters
    ----------
    samples : int
        Number of samples of speed, and of acceleration between the bounds around the zero.

    Returns
    -------
    bound, speed : float
        Smallest |alpha| [rad/s²] with f_r = 0, and the rotor speed [rad/s] there.
    """
    scenario = paper_scenario(Experiment.CALM, Reading.LITERAL.values())
    dynamics = Reading.LITERAL.planner().dynamics(scenario)
    speed = np.linspace(0.0, scenario.limits.rotor_speed_max, samples)
    braking = -np.linspace(0.0, max(BOUNDS), samples)[::-1]
    sampled = rotor_map(dynamics, speed, braking, "power.efficiency_polynomial")
    zeros = [_last_zero(braking, row) for row in sampled.efficiency]
    nearest = int(np.argmax(zeros))
    return -zeros[nearest], float(speed[nearest])


def _last_zero(braking: FloatArray, efficiency: FloatArray) -> float:
    """Return the weakest braking at which an efficiency vanishes, or minus infinity."""
    below = np.flatnonzero(efficiency <= 0.0)
    if not below.size:
        return -np.inf
    around = slice(below[-1], below[-1] + 2)
    return float(np.interp(0.0, efficiency[around], braking[around]))


@dataclass(frozen=True, kw_only=True)
class EfficiencyMap:
    """Samples of f_r without floors over speed and torque.

    Attributes
    ----------
    speed : ndarray, shape (n,)
        rad/s.
    torque : ndarray, shape (k,)
        N m.
    efficiency : ndarray, shape (n, k)
        Negative where the polynomial is.
    steady_torque : ndarray, shape (n,)
        Torque of a rotor that does not accelerate, N m.
    """

    speed: FloatArray
    torque: FloatArray
    efficiency: FloatArray
    steady_torque: FloatArray


def sample_efficiency_map() -> EfficiencyMap:
    """Sample the recovered f_r as declared."""
    scenario = paper_scenario(Experiment.CALM, Reading.LITERAL.values())
    dynamics = Reading.LITERAL.planner().dynamics(scenario)
    speed = np.linspace(0.0, scenario.limits.rotor_speed_max, _MAP_SPEEDS)
    steady = rotor_map(dynamics, speed, np.zeros(1), None).torque[:, 0]
    torque = np.linspace(*TORQUE_RANGE, _TORQUES)
    # Eq. (1) is linear in the acceleration, so each torque belongs to one acceleration.
    alphas = (torque - steady[:, None]) / scenario.vehicle.rotor_inertia
    rows = [
        rotor_map(dynamics, np.array([at]), alpha, "power.efficiency_polynomial").efficiency[0]
        for at, alpha in zip(speed, alphas, strict=True)
    ]
    return EfficiencyMap(
        speed=speed, torque=torque, efficiency=np.array(rows), steady_torque=steady
    )
