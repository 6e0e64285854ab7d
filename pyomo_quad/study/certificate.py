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

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Chebyshev
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, minimize

from pyomo_quad.flight import Planner
from pyomo_quad.flight.steady import MomentumDemand, SteadyFlight
from pyomo_quad.scenario import PowerModel, Scenario
from pyomo_quad.study.thrust_moments import ThrustMoments

__all__ = ["Certificate", "certify"]

FloatArray = NDArray[np.float64]

_ROUNDING = 1e-10
# Every declared power is a polynomial of the rotor speed in steady flight, of degree four at
# most; the fit has room to spare, and a power that it misses is refused.
_DEGREE = 8
_READINGS = 24
_SAMPLES = 3001
# The speed, over that of hover, up to which the power is sampled finely.
_USUAL_SPEED = 2.0
_FIT_ERROR = 1e-10
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


def certify(scenario: Scenario, *, planner: Planner | None = None) -> Certificate:
    """Bound the energy of every flight of a mission from below.

    Parameters
    ----------
    scenario : Scenario
        The mission, in its true wind; ``scenario.as_forecast()`` gives the bound in the wind
        that the optimiser is told.
    planner : Planner, optional
        One that may hold the compiled equations already.

    Returns
    -------
    Certificate
        Derived in the module's documentation.
    """
    planner = planner or Planner()
    hover_energy = planner.steady_flight(scenario).hover_power * scenario.mission.duration
    bound, reason = _bound(scenario, planner)
    return Certificate(
        lower_bound_J=bound,
        hover_energy_J=hover_energy,
        applies=bound is not None,
        reason=reason,
    )


def _bound(scenario: Scenario, planner: Planner) -> tuple[float | None, str]:
    reason = _obstacle(scenario)
    if reason:
        return None, reason
    demand = MomentumDemand(planner.dynamics(scenario))
    if not demand.is_linear:
        return None, (
            f"vehicle.drag_quadratic = {scenario.vehicle.drag_quadratic:g} kg/m: with quadratic "
            "drag the mean thrust depends on the path, so no bound is known."
        )
    power = _SteadyPower(scenario, planner.steady_flight(scenario))
    if not power.is_polynomial:
        return None, "the power of steady flight is not a polynomial of the rotor speed."
    mission = scenario.mission
    displacement = np.subtract(mission.goal.position, mission.start.position)
    # A bound above what full power for the whole flight would spend proves that there is none.
    ceiling = float(np.max(power.power)) * mission.duration * (1 + _ROUNDING)
    moments = ThrustMoments(demand, displacement, mission.duration)
    found = _best_bound(moments, power, ceiling)
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


def _best_bound(moments: ThrustMoments, power: _SteadyPower, ceiling: float) -> float:
    """Return the largest bound found, at least that of Jensen's inequality.

    `ceiling` is where the search may stop, since no flight spends so much.
    """

    def negative(multipliers: FloatArray) -> tuple[float, FloatArray]:
        given = multipliers.reshape(2, 3)
        size, direction = moments.price(given)
        conjugate, thrust = power.conjugate(size)
        slope = moments.supplied(thrust[:, None] * direction) - moments.demanded
        bound = np.sum(given * moments.demanded) - moments.widths @ conjugate
        return -float(bound), slope.ravel()

    def stop_above(intermediate_result: OptimizeResult) -> None:
        if -intermediate_result.fun > ceiling:
            raise StopIteration

    thrust = float(np.linalg.norm(moments.mean_thrust))
    jensen = np.zeros((2, 3))
    jensen[0] = power.slope(thrust) * moments.mean_thrust / thrust
    found = minimize(
        negative,
        jensen.ravel(),
        jac=True,
        method="L-BFGS-B",
        callback=stop_above,
        options={"maxiter": _ITERATIONS},
    )
    return max(-negative(jensen.ravel())[0], -float(found.fun))


class _SteadyPower:
    """Thrust and power with all rotors at one constant speed, over the speeds allowed.

    Power is that before anything is said of braking: one that earns nothing is the larger.

    Attributes
    ----------
    thrust, power : ndarray, shape (n,)
        Total thrust [N], rising, and total power [W] at equal steps of the rotor speed.
    is_polynomial : bool
        Whether the readings of the declared model are met to rounding.
    """

    def __init__(self, scenario: Scenario, steady: SteadyFlight) -> None:
        slowest, fastest = scenario.limits.rotor_speed_min, scenario.limits.rotor_speed_max
        between = 0.5 * (1 - np.cos(np.pi * np.arange(_READINGS) / (_READINGS - 1)))
        speeds = slowest + (fastest - slowest) * between
        # Close together where vehicles fly, however high the limit is.
        usual = np.clip(_USUAL_SPEED * steady.hover_speed, slowest, fastest)
        samples = np.union1d(
            np.linspace(slowest, usual, _SAMPLES), np.linspace(usual, fastest, _SAMPLES)
        )
        thrust, self.thrust, has_thrust = _fit(steady.thrust(speeds), speeds, samples)
        power, self.power, has_power = _fit(steady.uncredited_power(speeds), speeds, samples)
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
    readings: FloatArray, speeds: FloatArray, samples: FloatArray
) -> tuple[Chebyshev, FloatArray, bool]:
    """Return a polynomial of the rotor speed, its samples, and whether it meets the readings."""
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
