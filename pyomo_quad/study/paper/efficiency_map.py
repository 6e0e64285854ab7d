"""The efficiency function f_r over motor torque and rotor speed, for a picture of it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pyomo_quad.study.paper.chattering import rotor_map
from pyomo_quad.study.paper.missions import Experiment, paper_scenario
from pyomo_quad.study.paper.readings import Reading

__all__ = ["EfficiencyMap", "sample_efficiency_map"]

FloatArray = NDArray[np.float64]

_SPEEDS = 106
_TORQUES = 101
#: Torques that the picture shows, N m: braking hard to accelerating hard.
TORQUE_RANGE = (-0.12, 0.14)


@dataclass(frozen=True, kw_only=True)
class EfficiencyMap:
    """f_r without floors on a grid.

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
    """Sample the recovered f_r as declared.

    Returns
    -------
    EfficiencyMap
        Over the speeds allowed.
    """
    scenario = paper_scenario(Experiment.CALM, Reading.LITERAL.values())
    dynamics = Reading.LITERAL.planner().dynamics(scenario)
    speed = np.linspace(0.0, scenario.limits.rotor_speed_max, _SPEEDS)
    steady = rotor_map(dynamics, speed, np.zeros(1), None).torque[:, 0]
    torque = np.linspace(*TORQUE_RANGE, _TORQUES)
    efficiency = np.empty((speed.size, torque.size))
    inertia = scenario.vehicle.rotor_inertia
    for row, (one, drag) in enumerate(zip(speed, steady, strict=True)):
        # Eq. (1) is linear in the acceleration, so each torque belongs to one acceleration.
        alpha = (torque - drag) / inertia
        efficiency[row] = rotor_map(
            dynamics, np.array([one]), alpha, "power.efficiency_polynomial"
        ).efficiency[0]
    return EfficiencyMap(speed=speed, torque=torque, efficiency=efficiency, steady_torque=steady)
