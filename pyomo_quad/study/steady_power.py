"""Power of steady flight against thrust, read off the declared model, and its conjugate."""

from collections.abc import Callable

import numpy as np
from numpy.polynomial import Chebyshev
from numpy.typing import NDArray

from pyomo_quad.model.hover import SteadyFlight
from pyomo_quad.scenario import Scenario

__all__ = ["SteadyPower"]

FloatArray = NDArray[np.float64]

# Every declared power is a polynomial of the rotor speed in steady flight, of degree four at
# most; the fit has room to spare, and a power that it misses is refused.
_DEGREE = 8
_READINGS = 24
_SAMPLES = 3001
# The speed, over that of hover, up to which the power is sampled finely.
_USUAL_SPEED = 2.0
_FIT_ERROR = 1e-10


class SteadyPower:
    """Thrust and power with all rotors at one constant speed, over the speeds allowed.

    Parameters
    ----------
    scenario : Scenario
        The mission whose declared model is evaluated.

    Attributes
    ----------
    thrust, power : ndarray, shape (n,)
        Total thrust [N], rising, and total power [W] at equal steps of the rotor speed.
    is_polynomial : bool
        Whether the readings of the declared model are met to rounding.
    """

    def __init__(self, scenario: Scenario) -> None:
        steady = SteadyFlight(scenario)
        slowest, fastest = scenario.limits.rotor_speed_min, scenario.limits.rotor_speed_max
        between = 0.5 * (1 - np.cos(np.pi * np.arange(_READINGS) / (_READINGS - 1)))
        speeds = slowest + (fastest - slowest) * between
        # Close together where vehicles fly, however high the limit is.
        usual = np.clip(_USUAL_SPEED * steady.hover_speed, slowest, fastest)
        samples = np.union1d(
            np.linspace(slowest, usual, _SAMPLES), np.linspace(usual, fastest, _SAMPLES)
        )
        thrust, self.thrust, has_thrust = _fit(steady.thrust, speeds, samples)
        power, self.power, has_power = _fit(steady.power, speeds, samples)
        self._slope = power.deriv()(samples[1:]) / thrust.deriv()(samples[1:])
        self.is_polynomial = has_thrust and has_power
        self._floor = _below(self.thrust, self.power)

    def slope(self, thrust: float) -> float:
        """Return the derivative of power with respect to thrust [W/N]."""
        return float(np.interp(thrust, self.thrust[1:], self._slope))

    def conjugate(self, price: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the largest of price * thrust - power over the thrusts allowed.

        Parameters
        ----------
        price : ndarray, shape (n,)
            Worth of thrust, not negative, W/N.

        Returns
        -------
        value : ndarray, shape (n,)
            Never less than the true maximum, W.
        thrust : ndarray, shape (n,)
            Where it is reached, to the spacing of the samples, N.

        Notes
        -----
        Between two samples the power lies above their chord where it is concave, and above
        the chord before them, extended, where it is convex: the samples are lowered to the
        lesser of the two, so that their maximum is an upper bound of the maximum over all
        thrusts.
        """
        worth = price[:, None] * self.thrust - self._floor
        best = np.argmax(worth, axis=1)
        return worth[np.arange(price.size), best], self.thrust[best]


def _fit(
    reading: Callable[[float], float], speeds: FloatArray, samples: FloatArray
) -> tuple[Chebyshev, FloatArray, bool]:
    """Return a polynomial of the rotor speed, its samples, and whether it meets the readings."""
    readings = np.array([reading(float(speed)) for speed in speeds])
    domain = [speeds[0], speeds[-1]]
    polynomial = Chebyshev.fit(speeds, readings, _DEGREE, domain=domain)
    error = float(np.max(np.abs(polynomial(speeds) - readings)))
    return polynomial, polynomial(samples), error <= _FIT_ERROR * float(np.max(np.abs(readings)))


def _below(thrust: FloatArray, power: FloatArray) -> FloatArray:
    """Return samples whose polygon nowhere lies above the power."""
    chords = np.diff(power) / np.diff(thrust)
    # The power rises with thrust, so the first step extends a level line.
    extended = power[:-1] + np.concatenate([[0.0], chords[:-1]]) * np.diff(thrust)
    return np.concatenate([power[:1], np.minimum(power[1:], extended)])
