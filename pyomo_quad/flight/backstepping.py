r"""Adaptive backstepping of a double integrator, used for position and for attitude alike.

Plant: e'' = a + d - a_r, with e the tracking error, a the acceleration that the actuators really
give (known from rotor speeds and attitude), a_r that of the reference, d unknown and constant.

The law.  sigma(e) = e / sqrt(1 + |e|^2/L^2) is the gradient of
Phi(e) = L^2 (sqrt(1 + |e|^2/L^2) - 1); for L infinite they are e and |e|^2/2.

1. Virtual control: close the error at the rate -k1 sigma(e); what is missing is
   w = e' + k1 sigma(e).
2. Acceleration to ask for: a_d = a_r - d_hat - k1 d/dt sigma(e) - k1^2 sigma(e_bar) - k2 w, the
   last three together cut off smoothly at the largest effort allowed.
3. Adaptation: d_hat' = Proj(gamma z), with z and e_bar the *compensated* errors
   z = w - xi_v,  e_bar = e - xi_p, which discount what the actuators did not deliver:
   xi_v' = a - a_r + d_hat + k1 d/dt sigma(e) + k1^2 sigma(e_bar) + kappa z,
   xi_p' = xi_v - k1 (sigma(e) - sigma(e_bar)).
4. Start: xi_p = e and xi_v = w, so that e_bar = z = 0 (trajectory initialisation): a far goal
   is no evidence of a disturbance and excites no adaptation.

Lyapunov argument.  Substitution gives, for *any* a, saturated, delayed or neither,

    e_bar' = z - k1 sigma(e_bar),    z' = -k1^2 sigma(e_bar) - kappa z + d_tilde,

with d_tilde = d - d_hat.  With V = k1^2 Phi(e_bar) + |z|^2/2 + |d_tilde|^2/(2 gamma),

    V' = -k1^3 |sigma(e_bar)|^2 - kappa |z|^2 + d_tilde . (z - d_hat'/gamma)
      <= -k1^3 |sigma(e_bar)|^2 - kappa |z|^2 <= 0,

since the last term vanishes without projection and is not positive with it.  V bounds e_bar, z
and d_hat; Barbalat's lemma takes e_bar and z to zero, and then z' to zero, so d_hat tends to d.
V starts at |d|^2/(2 gamma), whatever the distance to the goal.

The error itself: where the actuators deliver, a = a_d,

    w' = -k2 w - k1^2 sigma(e_bar) + d_tilde,    e' = w - k1 sigma(e),

a stable filter fed by what V takes to zero, and after it a system whose Phi(e) falls wherever
|w| < k1 |sigma(e)|: w and e vanish.  Where they do not deliver, the estimate is not fooled by
it (no wind-up), but V says nothing of e; that the error returns from saturation is shown by
flights, not proven.  For a slowly varying d, V shows an error bounded in proportion to |d'|.

The weight k1^2 of Phi gives all terms of V one unit.

References
----------
Krstic, Kanellakopoulos, Kokotovic: Nonlinear and Adaptive Control Design, Wiley 1995 (the law,
projection, trajectory initialisation).  Farrell, Polycarpou, Sharma, Dong: Command filtered
backstepping, IEEE Trans. Automatic Control 54(6), 2009 (the compensated errors).  Bouabdallah and
Siegwart, ICRA 2005, and Madani and Benallegue, IROS 2006 (backstepping of quadrotors).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

from pyomo_quad.flight.saturation import project

__all__ = ["STATES_PER_LOOP", "BacksteppingLoop"]

_AXES = 3
STATES_PER_LOOP = 3 * _AXES


@dataclass(frozen=True, kw_only=True)
class BacksteppingLoop:
    """Adaptive backstepping of three double integrators; see the module for law and proof.

    Its states, in order: xi_p (3), xi_v (3), d_hat (3).  Plain floats: on three axes they are
    several times as fast as arrays, and the loop is evaluated thousands of times in a flight.
    """

    outer: tuple[float, float, float]
    """k1, 1/s, one for each axis; equal ones where `reach` is finite."""
    inner: tuple[float, float, float]
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

    def started(self, error: Sequence[float], error_rate: Sequence[float]) -> list[float]:
        """Return the states to start with: nothing learnt, compensated errors zero.

        Parameters
        ----------
        error, error_rate : sequence of three floats
            Tracking error e and e' at the start.

        Returns
        -------
        list of nine floats
            The loop's states.
        """
        shrink = _shrink(error, self.reach)
        missing = [
            v + k * shrink * e for k, e, v in zip(self.outer, error, error_rate, strict=True)
        ]
        return [*error, *missing, *(0.0,) * _AXES]

    def __call__(
        self,
        error: Sequence[float],
        error_rate: Sequence[float],
        reference_acceleration: Sequence[float],
        achieved_acceleration: Sequence[float],
        states: Sequence[float],
    ) -> tuple[list[float], list[float]]:
        """Return the acceleration to ask for and the rates of the loop's own states.

        Parameters
        ----------
        error, error_rate : sequence of three floats
            Tracking error e and e'.
        reference_acceleration : sequence of three floats
            Acceleration of the reference.
        achieved_acceleration : sequence of three floats
            Acceleration that the actuators give now, without the disturbance.
        states : sequence of nine floats
            The loop's states.

        Returns
        -------
        demand : list of three floats
            a_d.
        rates : list of nine floats
            Derivatives of the states by time.
        """
        lags, lag_rates, estimate = states[:3], states[3:6], states[6:]
        compensated = [e - lag for e, lag in zip(error, lags, strict=True)]
        shrink = _shrink(error, self.reach)
        compensated_shrink = _shrink(compensated, self.reach)
        along = sum(e * v for e, v in zip(error, error_rate, strict=True))
        turning = along * (shrink / self.reach) ** 2
        known, efforts, discounted, position_rates, velocity_rates = [], [], [], [], []
        for i in range(_AXES):
            k1, e, lag_rate = self.outer[i], error[i], lag_rates[i]
            closing = k1 * shrink * e
            closing_rate = k1 * shrink * (error_rate[i] - turning * e)
            compensated_closing = k1 * compensated_shrink * compensated[i]
            missing = error_rate[i] + closing
            backstep = closing_rate + k1 * compensated_closing
            z = missing - lag_rate
            wanted = reference_acceleration[i] - estimate[i]
            known.append(wanted)
            efforts.append(backstep + self.inner[i] * missing)
            discounted.append(z)
            position_rates.append(lag_rate - closing + compensated_closing)
            identified = self.identification * z
            velocity_rates.append(achieved_acceleration[i] - wanted + backstep + identified)
        learning = project(
            estimate, [self.adaptation * z for z in discounted], self.disturbance_max
        )
        cut = _shrink(efforts, self.effort_max)
        demand = [a - cut * effort for a, effort in zip(known, efforts, strict=True)]
        return demand, [*position_rates, *velocity_rates, *learning]


def _shrink(vector: Sequence[float], reach: float) -> float:
    """Return sigma(v) / v."""
    a, b, c = vector
    return 1 / sqrt(1 + (a * a + b * b + c * c) / reach**2)
