"""What the declared momentum balance asks of the thrust, read off the balance itself.

With the rotors at rest the difference between the two sides of each balance is the force that
the thrust has to supply, whatever the attitude.  Where it is linear in the acceleration and the
velocity, each axis of it reads

    thrust(t) = mass * acceleration + drag * velocity + standing(t)

with the weight and the wind in `standing`.  Mass, drag and standing force come from evaluating
the declared balances, so an equation changed there changes here.
"""

import numpy as np
from numpy.typing import NDArray
from pyomo.environ import ConcreteModel, value

from pyomo_quad.model.build import build_model
from pyomo_quad.model.wind import move_clock
from pyomo_quad.scenario import Scenario

__all__ = ["MomentumDemand"]

FloatArray = NDArray[np.float64]

_BALANCES = ("x_momentum_balance", "y_momentum_balance", "z_momentum_balance")
_VELOCITY = ("vx", "vy", "vz")
_ACCELERATION = ("dvx_dt", "dvy_dt", "dvz_dt")
_STILL = np.zeros(3)
# Velocities at which linearity is tried, m/s: each axis alone, and all of them together.
_TRIALS = np.array([[3.0, 0, 0], [0, 3.0, 0], [0, 0, 3.0], [-5.0, 7.0, -2.0]])
_ROUNDING = 1e-9


class MomentumDemand:
    """The thrust vector that the momentum balance asks for.

    Parameters
    ----------
    scenario : Scenario
        The mission whose declared model is evaluated.

    Attributes
    ----------
    mass, drag : ndarray, shape (3,)
        Force per acceleration [kg] and per velocity [kg/s] along each world axis.
    is_linear : bool
        Whether the demand is linear in the velocity and separate in the axes; `drag` has no
        meaning when it is not.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._model: ConcreteModel = build_model(scenario)
        self._instant = self._model.time.first()
        for j in self._model.rotors.rotor:
            self._model.rotors.omega[j, self._instant].set_value(0.0)
        at_rest = self.thrust(0.0)
        axes = range(len(_BALANCES))
        self.mass = np.array([self.thrust(0.0, acceleration=np.eye(3)[i])[i] for i in axes])
        self.mass -= at_rest
        self.drag = np.array([self.thrust(0.0, velocity=np.eye(3)[i])[i] for i in axes]) - at_rest
        scale = float(np.max(np.abs(at_rest)) + np.max(np.abs(self.drag)))
        errors = [
            self.thrust(0.0, velocity=velocity) - at_rest - self.drag * velocity
            for velocity in _TRIALS
        ]
        self.is_linear = bool(np.max(np.abs(errors)) <= _ROUNDING * scale)

    def thrust(
        self, time: float, velocity: FloatArray = _STILL, acceleration: FloatArray = _STILL
    ) -> FloatArray:
        """Return the thrust vector that a motion needs at a time.

        Parameters
        ----------
        time : float
            Time in flight, s.
        velocity, acceleration : ndarray, shape (3,), optional
            In world axes, m/s and m/s^2; at rest by default.

        Returns
        -------
        ndarray, shape (3,)
            In world axes, N.
        """
        body, instant = self._model.rigid_body, self._instant
        move_clock(self._model, instant, time)
        for names, numbers in ((_VELOCITY, velocity), (_ACCELERATION, acceleration)):
            for name, number in zip(names, numbers, strict=True):
                body.component(name)[instant].set_value(float(number))
        return np.array([self._residual(name) for name in _BALANCES])

    def _residual(self, name: str) -> float:
        inertia, forces = self._model.rigid_body.component(name)[self._instant].expr.args
        return float(value(inertia) - value(forces))
