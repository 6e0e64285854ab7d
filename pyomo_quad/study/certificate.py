"""A lower bound on the energy of every flight that meets a mission's boundary conditions.

A local optimiser finds a flight that no small change improves.  The bound here says how far any
flight whatever, small change or not, can lie below it.  It rests on three facts.

**The momentum balance.**  Whatever the attitude does, the thrust vector F(t) in world axes obeys
F = m v' + d v + S(t) along each axis: m is the mass, d the linear drag (zero when the wind is an
acceleration), and S the weight less the force of the wind on a vehicle at rest.  The flight is at
rest at both ends and covers the displacement D in the duration T, so integrating once,

    integral F dt            = d D + integral S dt,                                    (a)

and integrating with the weight k(t) = (m/d) (1 - exp(-(T - t) d/m)), which is T - t without drag,

    integral k F dt          = m D + integral k S dt.                                  (b)

The mean wind alone enters (a).  Neither depends on the path taken.

**The rotor accelerations cost, and earn, nothing.**  At rotor speed w and acceleration a the
motor needs the power p = v i, with torque tau = kappa w^2 + I a, i = tau/k_t and
v = R i + w/k_v.  Multiplied out, p is h(w) + a g(w) + (R I^2/k_t^2) a^2, where h(w) is the power
at constant speed and g a polynomial.  The second term is the time derivative of a function of w
and integrates to zero, since the rotor speeds agree at both ends; the third is never negative.
Hence E >= integral sum_j h(w_j) dt.  With friction tau gains T_f + D_f w and the same holds.
Shaft power has no third term.  Constant efficiency divides shaft power by a number; where braking
earns nothing its power is the larger, so the bound with regeneration serves.

**Duality.**  With u = |F| = sum_j kappa_b w_j^2, any vectors l and n give, with s = |l + n k|,

    E >= integral [sum_j h(w_j) - (l + n k).F] dt + l.(a) + n.(b)
      >= l.(a) + n.(b) - integral P*(s) dt,        P*(s) = max over u of s u - P(u),

where P(u) is the power of steady flight at thrust u: (l + n k).F <= s u, and the maximum over the
rotors separates into four equal ones.  No convexity is needed for the bound to hold; for a power
convex in thrust the best l and n close the gap of this step.  With n = 0 the best l gives
Jensen's inequality, E >= T P(|mean F|), the power of flying at the mean thrust vector; n adds that
the vehicle must start and stop.  The best (l, n) is found by a concave maximisation, but the bound
holds for whatever is found, and is evaluated so that sampling errors can only lower it.

Where none exists: with `efficiency` h + a g + ... does not hold, and accelerating and coasting in
turn can undercut every steady flight; with quadratic drag (a) and (b) depend on the path.  A
model of the user's own has not been looked into.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, minimize

from pyomo_quad.model import hover_power
from pyomo_quad.model.momentum import MomentumDemand
from pyomo_quad.scenario import PowerModel, Scenario
from pyomo_quad.study.steady_power import SteadyPower

__all__ = ["Certificate", "certify"]

FloatArray = NDArray[np.float64]

_GAUSS_NODES = 6
_FEWEST_PANELS = 16
_MOST_PANELS = 4096
_QUADRATURE_ERROR = 1e-10
_ITERATIONS = 200

_IMPOSSIBLE = "no flight meets the mission within the rotor speed limits, so none is bounded."


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """The lower bound of a mission, or why there is none.

    Attributes
    ----------
    lower_bound_J : float or None
        No flight of the mission spends less; None where no bound exists.
    hover_energy_J : float
        Energy of hovering in still air for the same time.
    applies : bool
        Whether there is a bound.
    reason : str
        What the bound rests on, or why there is none.
    """

    lower_bound_J: float | None
    hover_energy_J: float
    applies: bool
    reason: str

    def gap_percent(self, energy_J: float) -> float | None:
        """Return by how much any flight could undercut an energy, in per cent of it.

        Parameters
        ----------
        energy_J : float
            Energy of a flight of the same mission.

        Returns
        -------
        float or None
            None where no bound exists.
        """
        if self.lower_bound_J is None:
            return None
        return 100.0 * (energy_J - self.lower_bound_J) / energy_J


def certify(scenario: Scenario) -> Certificate:
    """Bound the energy of every flight of a mission from below.

    Parameters
    ----------
    scenario : Scenario
        The mission, in its true wind; ``scenario.as_forecast()`` gives the bound in the wind
        that the optimiser is told.

    Returns
    -------
    Certificate
        Derived in the module's documentation.
    """
    hover_energy = hover_power(scenario) * scenario.mission.duration
    bound, reason = _bound(scenario)
    return Certificate(
        lower_bound_J=bound,
        hover_energy_J=hover_energy,
        applies=bound is not None,
        reason=reason,
    )


def _bound(scenario: Scenario) -> tuple[float | None, str]:
    reason = _obstacle(scenario)
    if reason:
        return None, reason
    demand = MomentumDemand(scenario)
    if not demand.is_linear:
        return None, (
            f"vehicle.drag_quadratic = {scenario.vehicle.drag_quadratic:g} kg/m: with quadratic "
            "drag the mean thrust depends on the path, so no bound is known."
        )
    power = SteadyPower(scenario.with_values({"power.regeneration": True}))
    if not power.is_polynomial:
        return None, "the power of steady flight is not a polynomial of the rotor speed."
    mission = scenario.mission
    displacement = np.subtract(mission.goal.position, mission.start.position)
    # A bound above what full power for the whole flight would spend proves that there is none.
    ceiling = float(np.max(power.power)) * mission.duration * (1 + _QUADRATURE_ERROR)
    found = _Dual(demand, power, displacement, mission.duration).best(ceiling)
    if found > ceiling:
        return None, _IMPOSSIBLE
    return found, (
        "momentum balance and displacement fix two means of the thrust vector, and steady power "
        f"under power.model {scenario.power.model.value} bounds what they cost; holds for every "
        "flight that meets the boundary conditions within the rotor speed limits."
    )


def _obstacle(scenario: Scenario) -> str:
    if scenario.model is not None:
        return f"no bound is known for a model of one's own ({scenario.model})."
    if scenario.power.model is PowerModel.EFFICIENCY:
        return (
            "power.model efficiency has no bound: its power is not convex in the rotor "
            "acceleration, so flights that accelerate and coast in turn can undercut it."
        )
    if scenario.limits.rotor_speed_min >= scenario.limits.rotor_speed_max:
        return _IMPOSSIBLE
    return ""


class _Dual:
    """The concave function of l and n whose every value is a lower bound.

    Parameters
    ----------
    demand : MomentumDemand
    power : SteadyPower
    displacement : ndarray, shape (3,)
        From start to goal, m.
    duration : float
        Duration of the mission, s.
    """

    def __init__(
        self,
        demand: MomentumDemand,
        power: SteadyPower,
        displacement: FloatArray,
        duration: float,
    ) -> None:
        self._power = power
        self._duration = duration
        rate = demand.drag / demand.mass
        self._times, self._widths = _gauss(duration, _FEWEST_PANELS)
        plain, lever = _weights(self._times, rate, duration)
        # Of the span of both weights any basis will do; a centred one lets n change little else.
        middle = self._widths @ lever / duration
        self._weights = np.stack([plain, (lever - middle) / duration])
        mean, moment = _standing_moments(demand, rate, duration)
        total = demand.drag * displacement + mean
        levered = demand.mass * displacement + moment
        self._demanded = np.stack([total, (levered - middle * total) / duration])

    def best(self, ceiling: float) -> float:
        """Return the largest bound found, at least that of Jensen's inequality.

        Parameters
        ----------
        ceiling : float
            Where the search may stop, since no flight spends so much, J.

        Returns
        -------
        float
            Lower bound on the energy, J.
        """

        def stop_above(intermediate_result: OptimizeResult) -> None:
            if -intermediate_result.fun > ceiling:
                raise StopIteration

        mean_thrust = self._demanded[0] / self._duration
        thrust = float(np.linalg.norm(mean_thrust))
        jensen = np.zeros((2, 3))
        jensen[0] = self._power.slope(thrust) * mean_thrust / thrust
        found = minimize(
            self._negative,
            jensen.ravel(),
            jac=True,
            method="L-BFGS-B",
            callback=stop_above,
            options={"maxiter": _ITERATIONS},
        )
        return float(max(-self._negative(jensen.ravel())[0], -found.fun))

    def _negative(self, multipliers: FloatArray) -> tuple[float, FloatArray]:
        """Return the bound and its gradient, both with the sign changed."""
        given = multipliers.reshape(2, 3)
        price = np.einsum("ki,kti->ti", given, self._weights)
        size = np.linalg.norm(price, axis=1)
        conjugate, thrust = self._power.conjugate(size)
        direction = price / np.maximum(size, np.finfo(float).tiny)[:, None]
        supplied = self._widths[:, None] * thrust[:, None] * direction
        slope = np.einsum("kti,ti->ki", self._weights, supplied) - self._demanded
        return float(self._widths @ conjugate - np.sum(given * self._demanded)), slope.ravel()


def _gauss(duration: float, panels: int) -> tuple[FloatArray, FloatArray]:
    """Return nodes and widths of Gauss-Legendre quadrature on equal panels."""
    nodes, widths = np.polynomial.legendre.leggauss(_GAUSS_NODES)
    panel = duration / panels
    starts = panel * np.arange(panels)
    times = (starts[:, None] + panel * (nodes + 1) / 2).ravel()
    return times, np.tile(widths * panel / 2, panels)


def _weights(times: FloatArray, rate: FloatArray, duration: float) -> tuple[FloatArray, FloatArray]:
    """Return the weights of (a) and (b) at times, each of shape (n, 3)."""
    left = (duration - times)[:, None] * np.ones_like(rate)
    has_drag = rate > 0.0
    divisor = np.where(has_drag, rate, 1.0)
    return np.ones_like(left), np.where(has_drag, -np.expm1(-left * rate) / divisor, left)


def _standing_moments(
    demand: MomentumDemand, rate: FloatArray, duration: float
) -> tuple[FloatArray, FloatArray]:
    """Return the integrals over the flight of the standing force, plain and with the lever."""
    previous = None
    for panels in _panel_counts():
        times, widths = _gauss(duration, panels)
        standing = np.array([demand.thrust(float(t)) for t in times])
        moments = [widths @ (weight * standing) for weight in _weights(times, rate, duration)]
        found = np.stack(moments)
        if previous is not None:
            scale = np.max(np.abs(found), axis=1, keepdims=True)
            if np.all(np.abs(found - previous) <= _QUADRATURE_ERROR * scale):
                break
        previous = found
    return found[0], found[1]


def _panel_counts() -> Iterator[int]:
    for doubling in count():
        panels = _FEWEST_PANELS * 2**doubling
        yield panels
        if panels >= _MOST_PANELS:
            return
