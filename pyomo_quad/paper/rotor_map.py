"""Power and efficiency of one rotor, and the least energy of any flight under f_r.

f_r is the efficiency of motor and rotor of Yacef et al. Power and f_r are sampled from the
equations of the Pyomo model.

The least energy is a lower bound on the energy of every flight. The bound also holds for
"chattering" flights, whose rotors alternate arbitrarily fast between speeds and accelerations:
their mean power is at least the convex envelope of the power. The report's template
`examination.md.j2` has the derivation.
"""

from dataclasses import dataclass

import numpy as np

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import Dynamics
from pyomo_quad.flight.columns import ROTORS
from pyomo_quad.paper.experiments import Experiment, paper_scenario
from pyomo_quad.paper.readings import Reading
from pyomo_quad.scenario import Scenario

#: Bounds on the rotor acceleration for which the least energies are computed [rad/s²].
BOUNDS = (10, 30, 100, 200, 300, 500, 600, 700, 800, 900, 1000, 1100, 1150, 1250, 1500, 2000, 3000)
_HIGHER_BOUNDS = (5000, 7500, 10000, 20000)
# Numbers of samples for the least energies, which change by at most 0.6 % with twice as many.
_SPEEDS, _ACCELERATIONS = 141, 90
_SMALLEST_ACCELERATION = 1.0  # least of the logarithmic samples [rad/s²]
# Numbers of samples for the figure of f_r.
_MAP_SPEEDS, _TORQUES = 106, 101
#: Range of torques in the figure of f_r [N m]: from hard braking to hard acceleration.
TORQUE_RANGE = (-0.12, 0.14)


@dataclass(frozen=True, kw_only=True)
class RotorMap:
    """Samples of the thrust, torque, power and efficiency of one rotor.

    Attributes
    ----------
    speed : ndarray, shape (n,)
        Rotor speeds [rad/s], ascending from 0.
    acceleration : ndarray, shape (k,)
        Rotor accelerations [rad/s²], ascending.
    thrust : ndarray, shape (n,)
        Thrust [N].
    torque, power : ndarray, shape (n, k)
        Torque [N m] and power [W].
    efficiency : ndarray, shape (n, k)
        f_r of Yacef et al.; 1 if no efficiency was sampled.
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
    """Sample thrust, torque, power and efficiency of one rotor from the model's equations.

    Speeds are in rad/s, accelerations in rad/s². `efficiency` is a model component, such as
    "power.drive_efficiency". With None, the efficiency is 1.
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
    """Return the convex envelope (greatest convex lower bound) of sampled functions at `at`.

    `x`, shape (k,), has the ascending arguments, and `y`, shape (..., k), the values of the
    functions. `at` lies between the ends of `x`.
    """
    left, right = x <= at, x >= at
    width = x[right][None, :] - x[left][:, None]
    share = np.divide(at - x[left][:, None], width, out=np.zeros_like(width), where=width > 0)
    chords = y[..., left][..., :, None] * (1 - share) + y[..., right][..., None, :] * share
    # The envelope is the least value at `at` of all straight lines between two samples.
    return chords.min(axis=(-2, -1))


def chattering_floors(
    reading: Reading, bounds: tuple[float, ...] = BOUNDS + _HIGHER_BOUNDS
) -> FloatArray:
    """Compute lower bounds on the energy of any flight in calm air under the efficiency f_r.

    `reading` is the interpretation of f_r where it is small or negative. `bounds` are limits on the
    absolute rotor acceleration [rad/s²]. The result has one row for each limit. A row holds the
    limit [rad/s²] and the lower bound on the energy [J], computed by `floor_energy`.
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
    """Compute a lower bound on the energy of any flight whose rotor acceleration is bounded [J].

    `bound` is on the absolute acceleration [rad/s²]. The result holds for chattering flights, too.
    If f_r reaches zero at a permitted acceleration, it is minus infinity.
    """
    allowed = np.abs(sampled.acceleration) <= bound
    if sampled.efficiency[:, allowed].min() <= 0.0:
        return -np.inf
    steady = envelope_at(sampled.acceleration[allowed], sampled.power[:, allowed], 0.0)
    weight = scenario.vehicle.total_mass * scenario.gravity
    least = envelope_at(sampled.thrust, steady, weight / len(ROTORS))
    return float(least) * len(ROTORS) * scenario.mission.fixed_duration


def critical_acceleration(samples: int = 151) -> tuple[float, float]:
    """Find the weakest braking of a rotor at which the polynomial f_r reaches zero.

    The results are its absolute acceleration [rad/s²] and its rotor speed [rad/s]. If the rotors
    may brake harder, the energy of flights has no minimum. `samples` is the number of speeds and of
    accelerations.
    """
    scenario = paper_scenario(Experiment.CALM, Reading.LITERAL.values())
    dynamics = Reading.LITERAL.planner().dynamics(scenario)
    speed = np.linspace(0.0, scenario.limits.rotor_speed_max, samples)
    # Braking up to 3000 rad/s² is searched.
    braking = -np.linspace(0.0, max(BOUNDS), samples)[::-1]
    sampled = rotor_map(dynamics, speed, braking, "power.efficiency_polynomial")
    zeros = [_last_zero(braking, row) for row in sampled.efficiency]
    nearest = int(np.argmax(zeros))
    return -zeros[nearest], float(speed[nearest])


def _last_zero(braking: FloatArray, efficiency: FloatArray) -> float:
    """Return the weakest braking at which a sampled efficiency of the rotor is zero [rad/s²].

    The result is a negative acceleration, or minus infinity if all samples are positive. `braking`
    ascends to zero.
    """
    below = np.flatnonzero(efficiency <= 0.0)
    if not below.size:
        return -np.inf
    around = slice(below[-1], below[-1] + 2)
    return float(np.interp(0.0, efficiency[around], braking[around]))


@dataclass(frozen=True, kw_only=True)
class EfficiencyMap:
    """Samples of the efficiency f_r of Yacef et al. over rotor speed and torque.

    Attributes
    ----------
    speed : ndarray, shape (n,)
        Rotor speeds [rad/s].
    torque : ndarray, shape (k,)
        Motor torques [N m].
    efficiency : ndarray, shape (n, k)
        Efficiency f_r, a polynomial of speed and torque without lower limit. Values may be
        negative.
    steady_torque : ndarray, shape (n,)
        Motor torque that keeps the rotor at each speed [N m].
    """

    speed: FloatArray
    torque: FloatArray
    efficiency: FloatArray
    steady_torque: FloatArray


def sample_efficiency_map() -> EfficiencyMap:
    """Sample the efficiency f_r of Yacef et al. over rotor speed and torque, for a figure.

    f_r is the polynomial that was recovered from public re-implementations of the paper.
    """
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
