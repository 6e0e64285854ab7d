"""The least energy of any flight under f_r, however fast its rotors alternate.

Claim.  Let P(w, a) be the power of one rotor, |a| <= A its acceleration, C(w) the convex envelope
of P(w, .) at a = 0, and D the convex envelope of C over the rotor's thrust k w^2.  A flight from
hover to hover of duration T spends at least T times four times D at the hover thrust.

Reason.  Over such a flight each rotor returns to its first speed, so at every speed it passes
upward as much as downward: the mean acceleration at each speed is zero, and the mean power there
is C(w) at least.  The vertical momentum balance makes the mean of the vertical thrust equal the
weight, so the mean thrust is the weight at least, and D rises with thrust.  Horizontal wind
changes none of this.

Rotors come near the bound only by alternating ever faster, and no flight reaches it.  Where f_r
passes zero within the bound on the acceleration there is no bound: minus infinity.  The envelopes
are taken over samples of the declared power; they converge from above as the samples grow dense.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pyomo_quad.collocation import Dynamics
from pyomo_quad.flight.columns import ROTORS
from pyomo_quad.scenario import Scenario
from pyomo_quad.study.paper.missions import Experiment, paper_scenario
from pyomo_quad.study.paper.readings import Reading

__all__ = [
    "BOUNDS",
    "RotorMap",
    "chattering_floors",
    "critical_acceleration",
    "envelope_at",
    "rotor_map",
]

FloatArray = NDArray[np.float64]

#: Bounds on the rotor acceleration at which the floors are taken, rad/s².
BOUNDS = (10, 30, 100, 200, 300, 500, 600, 700, 800, 900, 1000, 1100, 1150, 1250, 1500, 2000, 3000)
_HIGHER_BOUNDS = (5000, 7500, 10000, 20000)
_SPEEDS = 141
_ACCELERATIONS = 90
_SMALLEST_ACCELERATION = 1.0


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
        Of one rotor, N.
    torque, power : ndarray, shape (n, k)
        N m and W.
    efficiency : ndarray, shape (n, k)
        f_r without floors where the model has one, else one.
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
    dynamics : Dynamics
        The declared vehicle.
    speed, acceleration : ndarray
        rad/s and rad/s².
    efficiency : str or None
        Name of the declared efficiency to sample.

    Returns
    -------
    RotorMap
        The four rotors share each sample.
    """
    count = speed.size * acceleration.size
    states = np.zeros((count, len(dynamics.state_names)))
    controls = np.zeros((count, len(dynamics.control_names)))
    speeds, accelerations = np.meshgrid(speed, acceleration, indexing="ij")
    for rotor in ROTORS:
        states[:, dynamics.state_names.index(f"rotors.omega[{rotor}]")] = speeds.ravel()
        controls[:, dynamics.control_names.index(f"rotors.alpha[{rotor}]")] = accelerations.ravel()
    first = ROTORS[0]
    keys = [("rotors.total_thrust", None), ("rotors.motor_torque", first)]
    keys += [("power.rotor_power", first)]
    keys += [] if efficiency is None else [(efficiency, first)]
    table = dynamics.table(tuple(keys), np.zeros(count), states, controls)
    grids = [column.reshape(speeds.shape) for column in table.T]
    return RotorMap(
        speed=speed,
        acceleration=acceleration,
        thrust=grids[0][:, 0] / len(ROTORS),
        torque=grids[1],
        power=grids[2],
        efficiency=grids[3] if efficiency is not None else np.ones_like(grids[2]),
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
    """Return the least energy of any flight of the paper's mission.

    Parameters
    ----------
    reading : Reading
        Of f_r.
    bounds : tuple of float
        Bounds on the rotor acceleration, rad/s².

    Returns
    -------
    ndarray, shape (len(bounds), 2)
        Bound and energy [J], minus infinity where f_r passes zero.
    """
    scenario = paper_scenario(Experiment.CALM, reading.values())
    smallest, largest = _SMALLEST_ACCELERATION, max(bounds)
    upward = np.union1d(np.geomspace(smallest, largest, _ACCELERATIONS), bounds)
    sampled = rotor_map(
        reading.planner().dynamics(scenario),
        np.linspace(0.0, scenario.limits.rotor_speed_max, _SPEEDS),
        np.concatenate([-upward[::-1], [0.0], upward]),
        "power.drive_efficiency",
    )
    return np.array([[bound, floor_energy(scenario, sampled, bound)] for bound in bounds])


def floor_energy(scenario: Scenario, sampled: RotorMap, bound: float) -> float:
    """Return the least energy of a flight whose rotors accelerate no faster than a bound.

    Parameters
    ----------
    scenario : Scenario
        Gives weight and duration.
    sampled : RotorMap
        The rotor under the scenario's power model.
    bound : float
        rad/s².

    Returns
    -------
    float
        J.
    """
    allowed = np.abs(sampled.acceleration) <= bound
    if sampled.efficiency[:, allowed].min() <= 0.0:
        return -np.inf
    steady = envelope_at(sampled.acceleration[allowed], sampled.power[:, allowed], 0.0)
    weight = scenario.vehicle.total_mass * scenario.gravity
    least = envelope_at(sampled.thrust, steady, weight / len(ROTORS))
    return float(least) * len(ROTORS) * scenario.mission.duration


def critical_acceleration(samples: int = 151) -> tuple[float, float]:
    """Return where f_r first passes zero as the bound on the acceleration grows.

    Parameters
    ----------
    samples : int
        Of speed, and of acceleration between the two bounds that enclose the zero.

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
    zeros = [
        np.interp(0.0, row[last : last + 2], braking[last : last + 2])
        if (last := _last_negative(row)) >= 0
        else -np.inf
        for row in sampled.efficiency
    ]
    nearest = int(np.argmax(zeros))
    return -float(zeros[nearest]), float(speed[nearest])


def _last_negative(row: FloatArray) -> int:
    below = np.flatnonzero(row <= 0.0)
    return int(below[-1]) if below.size else -1
