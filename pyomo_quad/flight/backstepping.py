r"""Adaptive backstepping of a double integrator, used for position and for attitude alike.

Plant: e'' = a + d - a_r, with e the tracking error, a the acceleration that the actuators really
give (known from rotor speeds and attitude), a_r that of the reference, d unknown and constant.

The law.  sigma(e) = e / sqrt(1 + |e|^2/L^2) is the gradient of
Phi(e) = L^2 (sqrt(1 + |e|^2/L^2) - 1); for L infinite they are e and |e|^2/2.

1. Virtual control: close the error at the rate -k1 sigma(e); what is missing is
   w = e' + k1 sigma(e).
2. Acceleration to ask for: a_d = a_r - k1 d/dt sigma(e) - d_hat - k1^2 sigma(e_bar) - k2 w.
3. Adaptation: d_hat' = Proj(gamma z), with z and e_bar the *compensated* errors
   z = w - xi_v,  e_bar = e - xi_p, which discount what the actuators did not deliver:
   xi_v' = -k2 xi_v + (a - a_d),  xi_p' = xi_v - k1 (sigma(e) - sigma(e_bar)).

Lyapunov argument.  Substitution gives, for *any* a, saturated, delayed or neither,

    e_bar' = z - k1 sigma(e_bar),    z' = -k1^2 sigma(e_bar) - k2 z + d_tilde,

with d_tilde = d - d_hat.  With V = k1^2 Phi(e_bar) + |z|^2/2 + |d_tilde|^2/(2 gamma),

    V' = -k1^3 |sigma(e_bar)|^2 - k2 |z|^2 + d_tilde . (z - d_hat'/gamma)
      <= -k1^3 |sigma(e_bar)|^2 - k2 |z|^2 <= 0,

since the last term vanishes without projection and is not positive with it.  V bounds e_bar, z
and d_hat; Barbalat's lemma takes e_bar and z to zero, and then z' to zero, so d_hat tends to d.
Where the actuators deliver, a = a_d, xi decays with k2 and k1 and e itself goes to zero: the
adaptive law of the textbook.  Where they do not, the estimate is not fooled by it: no wind-up.
For a slowly varying d the same V shows an error bounded in proportion to |d'|.

The weight k1^2 of Phi gives all terms of V one unit.

References
----------
Krstic, Kanellakopoulos, Kokotovic: Nonlinear and Adaptive Control Design, Wiley 1995 (the law,
projection).  Farrell, Polycarpou, Sharma, Dong: Command filtered backstepping, IEEE Trans.
Automatic Control 54(6), 2009 (the compensated errors).  Bouabdallah and Siegwart, ICRA 2005, and
Madani and Benallegue, IROS 2006 (backstepping of quadrotors).
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from pyomo_quad.flight.saturation import project

__all__ = ["STATES_PER_LOOP", "BacksteppingLoop"]

FloatArray = NDArray[np.float64]

_AXES = 3
STATES_PER_LOOP = 3 * _AXES


@dataclass(frozen=True, kw_only=True)
class BacksteppingLoop:
    """Adaptive backstepping of three double integrators; see the module for law and proof.

    Its states, in order: xi_p (3), xi_v (3), d_hat (3).
    """

    outer: FloatArray
    """k1, 1/s, one for each axis; equal ones where `reach` is finite."""
    inner: FloatArray
    """k2, 1/s, one for each axis."""
    reach: float
    """L: size of the error beyond which the closing rate no longer grows; may be infinite."""
    identification: float
    """kappa, 1/s: rate at which the compensated error settles."""
    effort_max: float
    """Largest correcting acceleration; may be infinite."""
    adaptation: float
    """gamma, 1/s^2; zero for a law that does not adapt."""
    disturbance_max: float
    """Bound of the estimate, in the unit of the acceleration."""

    def __call__(
        self,
        error: FloatArray,
        error_rate: FloatArray,
        reference_acceleration: FloatArray,
        achieved_acceleration: FloatArray,
        states: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Return the acceleration to ask for and the rates of the loop's own states.

        Parameters
        ----------
        error, error_rate : ndarray, shape (3,)
            Tracking error e and e'.
        reference_acceleration : ndarray, shape (3,)
            Acceleration of the reference.
        achieved_acceleration : ndarray, shape (3,)
            Acceleration that the actuators give now, without the disturbance.
        states : ndarray, shape (9,)
            The loop's states.

        Returns
        -------
        demand : ndarray, shape (3,)
            a_d.
        rates : ndarray, shape (9,)
            Derivatives of the states by time.
        """
        lag, lag_rate, estimate = states[:3], states[3:6], states[6:]
        shrink = _shrink(error, self.reach)
        closing = self.outer * shrink * error
        turning = float(error @ error_rate) * (shrink / self.reach) ** 2
        closing_rate = self.outer * shrink * (error_rate - turning * error)
        compensated = error - lag
        compensated_closing = self.outer * _shrink(compensated, self.reach) * compensated
        missing = error_rate + closing
        discounted = missing - lag_rate
        backstep = closing_rate + self.outer * compensated_closing
        effort = backstep + self.inner * missing
        known = reference_acceleration - estimate
        rates = np.empty(STATES_PER_LOOP)
        rates[:3] = lag_rate - closing + compensated_closing
        rates[3:6] = achieved_acceleration - known + backstep + self.identification * discounted
        rates[6:] = project(estimate, self.adaptation * discounted, self.disturbance_max)
        return known - _shrink(effort, self.effort_max) * effort, rates


def _shrink(vector: FloatArray, reach: float) -> float:
    """Return sigma(v) / v."""
    return 1 / sqrt(1 + float(vector @ vector) / reach**2)
