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

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, minimize

from pyomo_quad.model import hover_power
from pyomo_quad.model.momentum import MomentumDemand
from pyomo_quad.scenario import PowerModel, Scenario
from pyomo_quad.study.steady_power import SteadyPower
from pyomo_quad.study.thrust_moments import ThrustMoments

__all__ = ["Certificate", "certify"]

FloatArray = NDArray[np.float64]

_ROUNDING = 1e-10
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


def _best_bound(moments: ThrustMoments, power: SteadyPower, ceiling: float) -> float:
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
