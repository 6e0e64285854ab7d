"""A lower bound on the energy of every flight that meets a mission's boundary conditions.

A leg is the flight from one waypoint to the next. A pair is a combination of thrust and airspeed.
The basis of a bound is a sentence that says why the bound holds, and for which flights. The
argument `planner` compiles the equations of a scenario and keeps them for later calls; it plans no
flight here.

Derivation, proof and variants: see docs/theory/bound.md, eqs. (1) to (11).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, sqrt
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import Chebyshev
from scipy.linalg import null_space
from scipy.optimize import OptimizeResult, minimize

from pyomo_quad.flight import Planner
from pyomo_quad.flight.steady import MomentumDemand, SteadyFlight
from pyomo_quad.model.aerodynamics import acts_in_body_axes
from pyomo_quad.model.wind_field import wind_corners, winds_of_columns
from pyomo_quad.scenario import PowerModel, Scenario
from pyomo_quad.scenario.mission import Order
from pyomo_quad.scenario.wind import Beyond, WindCoupling
from pyomo_quad.study.legs import Itinerary, Leg, legs_of
from pyomo_quad.study.pairs import POWER_TOLERANCE, Pairs, bound_of_pairs, wind_of
from pyomo_quad.study.potential import Places, bound_by_places

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from pyomo_quad.arrays import FloatArray


_GAUSS_NODES = 6  # of each panel of the quadrature
_PANELS = 16  # for integrals of the conjugate over the flight, which is piecewise smooth
# Numbers of panels for integrals of the wind: doubled until two results agree to the relative
# tolerance below.
_PANEL_COUNTS = [2**doubling for doubling in range(1, 13)]
_QUADRATURE_ERROR = 1e-10


class ThrustMoments:
    """Two weighted integrals of the thrust over a flight, fixed by the boundary conditions alone.

    See docs/theory/bound.md, eqs. (2) and (4). The weights are 1 and (k(t) - mean of k) / duration,
    with k(t) of eq. (3).

    Parameters
    ----------
    demand : MomentumDemand
        Thrust that a motion of the vehicle requires. The drag must be linear in the velocity.
    displacement : ndarray, shape (3,)
        Vector from start to goal, m.
    duration : float
        Duration of the flight, s.

    Attributes
    ----------
    widths : ndarray, shape (n,)
        Weights of the quadrature nodes, s.
    weights : ndarray, shape (2, n, 3)
        Both weights of the thrust at the nodes, along each axis.
    demanded : ndarray, shape (2, 3)
        Values of both integrals that the mission requires, along each axis, N s.
    mean_thrust : ndarray, shape (3,)
        Mean thrust vector that the mission requires, N.
    """

    def __init__(self, demand: MomentumDemand, displacement: FloatArray, duration: float) -> None:
        rate = demand.drag / demand.mass
        times, self.widths = _gauss(duration, _PANELS)
        plain, lever = _weights(times, rate, duration)
        # The bound does not depend on the basis of the two weights; the centred second has zero
        # mean.
        middle = self.widths @ lever / duration
        self.weights = np.stack([plain, (lever - middle) / duration])
        standing, levered = _standing_moments(demand, rate, duration)
        total = demand.drag * displacement + standing
        moment = demand.mass * displacement + levered
        self.demanded = np.stack([total, (moment - middle * total) / duration])
        self.mean_thrust = total / duration

    def price(self, multipliers: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return length [W/N], shape (n,), and direction, shape (n, 3), of the price of thrust.

        The price at a node is the sum of multiplier times weight over both integrals:
        docs/theory/bound.md, eq. (8). `multipliers` has the shape (2, 3), W/N.
        """
        vector = np.einsum("ki,kti->ti", multipliers, self.weights)
        size = np.linalg.norm(vector, axis=1)
        return size, vector / np.maximum(size, np.finfo(float).tiny)[:, None]

    def supplied(self, thrust: FloatArray) -> FloatArray:
        """Return the two weighted integrals of a given thrust over the flight, shape (2, 3), N s.

        `thrust` has the shape (n, 3), N. For every flight of the mission, the integrals equal
        `demanded`.
        """
        return np.einsum("kti,ti->ki", self.weights, self.widths[:, None] * thrust)

    def least_peak(self, axes: tuple[int, ...] = (0, 1, 2)) -> float:
        """Return a lower bound on the peak thrust along `axes` of every flight of the mission, N.

        Implements docs/theory/bound.md, eq. (11). For (0, 1) the bound is on the horizontal thrust.
        """
        counted = np.zeros((2, 3), dtype=bool)
        counted[:, axes] = True
        demanded = self.demanded[counted]
        if not np.any(demanded):
            return 0.0
        one = demanded / (demanded @ demanded)
        free = null_space(demanded[None, :])

        def size(y: FloatArray) -> tuple[float, FloatArray]:
            multipliers = np.zeros((2, 3))
            multipliers[counted] = one + free @ y
            norm, direction = self.price(multipliers)
            return float(self.widths @ norm), free.T @ self.supplied(direction)[counted]

        # The largest quotient of docs/theory/bound.md, eq. (11), belongs to the least integral of
        # |price| with x . demanded = 1. A thrust that attains the bound has a constant length and
        # the direction of the price.
        found = minimize(size, np.zeros(free.shape[1]), jac=True, method="BFGS")
        return float(1.0 / found.fun)


def _gauss(duration: float, panels: int) -> tuple[FloatArray, FloatArray]:
    """Return nodes [s] and weights [s] of Gauss-Legendre quadrature over the duration of a flight.

    Each of the `panels` equal intervals has `_GAUSS_NODES` nodes.
    """
    nodes, widths = np.polynomial.legendre.leggauss(_GAUSS_NODES)
    panel = duration / panels
    starts = panel * np.arange(panels)
    times = (starts[:, None] + panel * (nodes + 1) / 2).ravel()
    return times, np.tile(widths * panel / 2, panels)


def _weights(times: FloatArray, rate: FloatArray, duration: float) -> tuple[FloatArray, FloatArray]:
    """Return the weights of the thrust in both integrals of `ThrustMoments`, each of shape (n, 3).

    For every axis, they are 1 and k(t) [s] from docs/theory/bound.md, eq. (3), at n times.
    `ThrustMoments` then centres and scales k(t). `rate` is drag coefficient over mass [1/s].
    """
    left = (duration - times)[:, None] * np.ones_like(rate)
    # An increase of the velocity by dv at the time t shifts the final position by k(t) dv.
    has_drag = rate > 0.0
    divisor = np.where(has_drag, rate, 1.0)
    return np.ones_like(left), np.where(has_drag, -np.expm1(-left * rate) / divisor, left)


def _standing_moments(
    demand: MomentumDemand, rate: FloatArray, duration: float
) -> tuple[FloatArray, FloatArray]:
    """Return two weighted integrals of the thrust that holds the vehicle at rest over a flight.

    `_weights` gives the weights in the integrals. The results, shape (3,), are the terms with S in
    docs/theory/bound.md, eqs. (2) [N s] and (4) [N s^2]. `rate` is drag coefficient over mass
    [1/s].
    """
    previous = np.full((2, 3), np.nan)
    for panels in _PANEL_COUNTS:
        times, widths = _gauss(duration, panels)
        standing = np.array([demand.thrust(float(t)) for t in times])
        found = np.stack(
            [widths @ (weight * standing) for weight in _weights(times, rate, duration)]
        )
        scale = np.max(np.abs(found), axis=1, keepdims=True)
        if np.all(np.abs(found - previous) <= _QUADRATURE_ERROR * scale):
            break
        previous = found
    return found[0], found[1]


_ROUNDING = 1e-10  # relative
# Times at which the standing force and the wind are sampled to see whether they are constant.
_STANDING_SAMPLES = 101
# Degree of the polynomials fitted to thrust and power over the rotor speed, and number of Chebyshev
# nodes: declared powers are polynomials of degree four at most in steady flight; any other power
# exceeds the tolerance of the fit.
_DEGREE = 8
_FIT_NODES = 24
_FIT_ERROR = 1e-10  # relative to the largest value at the nodes
# Number of samples of the fit up to twice the speed of hover, the range of usual flights, and
# number of samples beyond this speed.
_SAMPLES = 3001
_USUAL_SPEED = 2.0
_ITERATIONS = 200  # of L-BFGS

_IMPOSSIBLE = "no flight meets the mission within the rotor speed limits, so there is no bound."
_WITH_DRAG = "with drag"
# A bound [J], None if there is none, and the reason in words.
_Found = tuple[float | None, str]


#: Relative difference below which two durations are equal.
SAME_TIME = 1e-9


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """Lower bound on the energy of every flight of a mission, or the reason why none is known.

    Attributes
    ----------
    lower_bound_J : float or None
        None if no bound is known.
    hover_energy_J : float
        Energy of hovering in still air for the given duration, or for the estimated one if the
        duration is free.
    applies : bool
        Whether a bound is known.
    reason : str
        Sentence on the basis of the bound, or on why none is known.
    durations_s : tuple of float
        Least and greatest duration that the bound covers.
    """

    lower_bound_J: float | None
    hover_energy_J: float
    applies: bool
    reason: str
    durations_s: tuple[float, float] = (0.0, inf)

    def is_of(self, duration_s: float) -> bool:
        """Return whether the lower bound is valid for flights of the duration `duration_s`."""
        least, greatest = self.durations_s
        return least * (1 - SAME_TIME) <= duration_s <= greatest * (1 + SAME_TIME)

    def gap_percent(self, energy_J: float) -> float | None:
        """Return the optimality gap of a flight, 100 (energy - lower bound) / energy [percent].

        Any other flight of the mission can save at most this part of the energy. The result is None
        if no bound is known.
        """
        if self.lower_bound_J is None:
            return None
        return 100.0 * (energy_J - self.lower_bound_J) / energy_J


def certify(scenario: Scenario, *, planner: Planner | None = None) -> Certificate:
    """Return a lower bound on the energy of every flight of a mission in the actual wind.

    If no bound is known, the result holds the reason. `planner` supplies the compiled equations of
    the scenario; by default, a new planner compiles them.
    """
    planner = planner or Planner()
    hover_energy = planner.steady_flight(scenario).hover_power * scenario.nominal_duration
    bound, reason = _bound(scenario, planner)
    return Certificate(
        lower_bound_J=bound,
        hover_energy_J=hover_energy,
        applies=bound is not None,
        reason=reason,
        durations_s=scenario.mission.duration_limits,
    )


def _bound(scenario: Scenario, planner: Planner) -> _Found:
    """Return the largest known lower bound on the energy of a mission [J], and its basis.

    If no bound is known, the first result is None and the text is the reason.
    """
    reason = next(_obstacles(scenario), "")
    if reason:
        return None, reason
    demand = MomentumDemand(planner.dynamics(scenario))
    is_field = scenario.wind.grid is not None
    if scenario.power.model is PowerModel.MOMENTUM or not demand.is_linear or is_field:
        return _bound_by_pairs(scenario, planner, demand)
    power = _SteadyPower(scenario, planner.steady_flight(scenario))
    if not power.is_polynomial:
        return None, "the power of steady flight is not a polynomial of the rotor speed."
    why_not_by_legs = _why_not_by_legs(scenario, demand)
    bounds = [_bound_as_a_whole(scenario, demand, power, why_not_by_legs)]
    if scenario.mission.is_free or scenario.mission.waypoints:
        if not why_not_by_legs:
            bounds.append(_bound_by_legs(scenario, planner, demand, power))
        elif why_not_by_legs == _WITH_DRAG:
            bounds.append(_bound_by_pairs(scenario, planner, demand))
    return max(bounds, key=lambda found: -inf if found[0] is None else found[0])


def _why_not_by_legs(scenario: Scenario, demand: MomentumDemand) -> str:
    """Return why `_bound_by_legs` gives no bound, such as "in a wind that changes with time".

    The result is empty if that function gives a bound.
    """
    times = np.linspace(0.0, scenario.nominal_duration, _STANDING_SAMPLES)
    standing = np.array([demand.thrust(float(t)) for t in times])
    if np.ptp(standing, axis=0).max() > _ROUNDING * np.abs(standing).max():
        return "in a wind that changes with time"
    if np.max(np.abs(demand.drag)) > 0.0:
        return _WITH_DRAG
    if scenario.mission.order is Order.BEST and len(scenario.mission.waypoints) > 1:
        return "where their order is open"
    return ""


def _bound_as_a_whole(
    scenario: Scenario, demand: MomentumDemand, power: _SteadyPower, why_not_by_legs: str
) -> _Found:
    """Return a lower bound on the energy that ignores the waypoints, and its basis.

    For a free duration, a changing mass or an impossible mission, return None and the reason. The
    returned sentence may end with `why_not_by_legs`, the result of `_why_not_by_legs`.
    """
    mission = scenario.mission
    if mission.released > 0.0:
        return None, f"no bound is known for a mass that changes in flight {why_not_by_legs}."
    if mission.is_free:
        return None, f"no bound is known for a free duration {why_not_by_legs}."
    displacement = np.subtract(mission.goal.position, mission.start.position)
    duration = mission.fixed_duration
    # A bound above the energy of full power for the whole flight proves that no flight exists.
    ceiling = float(np.max(power.power)) * duration * (1 + _ROUNDING)
    found = _best_bound(ThrustMoments(demand, displacement, duration), power, ceiling)
    if found > ceiling:
        return None, _IMPOSSIBLE
    left_out = f"; no bound is known that counts waypoints {why_not_by_legs}, so these are left out"
    return found, (
        "momentum balance and displacement fix two means of the thrust vector, and steady power "
        f"under power.model {scenario.power.model.value} bounds what they cost"
        f"{left_out if mission.waypoints else ''}; holds for every "
        "flight that meets the boundary conditions within the rotor speed limits"
        f"{_airspace_clause(scenario)}."
    )


def _bound_by_legs(
    scenario: Scenario, planner: Planner, demand: MomentumDemand, power: _SteadyPower
) -> _Found:
    """Return a lower bound on the energy of flights through the waypoints, and its basis.

    The bound [J] holds for all allowed durations and passing times. If no flight is possible,
    return None and the reason. Call it only if `_why_not_by_legs` returns an empty text.
    """
    mission = scenario.mission
    standing = demand.thrust(0.0)
    thrust = float(np.linalg.norm(standing))
    legs, shared = legs_of(scenario)
    itinerary = Itinerary(legs, shared, standing, float(demand.mass[0]), power.conjugate)
    found = itinerary.bound(power.slope(thrust) * standing / thrust)
    least, greatest = mission.duration_limits
    if found > float(np.max(power.power)) * greatest * (1 + _ROUNDING):
        return None, _IMPOSSIBLE
    found -= _energy_returned(scenario, planner)
    passing = (
        f"on each of {len(legs)} legs, their velocities at the passages free, momentum balance"
        if mission.waypoints
        else "momentum balance"
    )
    times = f"every duration from {least:g} to {greatest:g} s" if mission.is_free else ""
    times += " and " * bool(times and mission.waypoints)
    times += "all passing times" if mission.waypoints else ""
    return max(found, 0.0), (
        f"{passing} and displacement fix two means of the thrust vector, and steady power "
        f"under power.model {scenario.power.model.value} bounds what they cost; one price of "
        f"momentum bounds {times}, for every flight that meets the boundary conditions within "
        f"the rotor speed limits{_airspace_clause(scenario)}."
    )


def _energy_returned(scenario: Scenario, planner: Planner) -> float:
    """Return the energy that the rotors give back as they slow down after a payload release [J].

    The lower bound is reduced by this energy: docs/theory/bound.md, eq. (7).
    """
    if not scenario.mission.released:
        return 0.0
    steady = planner.steady_flight(scenario)
    slower = steady.hover_speed * sqrt(scenario.mass_at_goal / scenario.vehicle.total_mass)
    nodes, widths = np.polynomial.legendre.leggauss(_GAUSS_NODES)
    speeds = slower + (steady.hover_speed - slower) * (nodes + 1) / 2
    stored = steady.power_of_accelerating(speeds)
    return float((steady.hover_speed - slower) * (widths / 2) @ stored)


def _bound_by_pairs(scenario: Scenario, planner: Planner, demand: MomentumDemand) -> _Found:
    """Return a lower bound on the energy from all pairs of thrust and airspeed, and its basis.

    If no bound [J] is found, return None and the reason. `_bound` calls this function if power or
    drag depends on the airspeed. `demand` gives the thrust of a motion.
    """
    mission, dynamics = scenario.mission, planner.dynamics(scenario)
    if scenario.power.model is PowerModel.MOTOR_WITH_FRICTION:
        return (
            None,
            "power.model motor_with_friction has no bound here: it is not convex in thrust.",
        )
    steady, winds = planner.steady_flight(scenario), None
    if scenario.wind.grid is not None:
        # Still air has no field: the equations of the vehicle depend on the airspeed alone.
        dynamics, winds = steady.dynamics, wind_corners(scenario)
        demand = MomentumDemand(dynamics)
    wind = wind_of(dynamics, np.linspace(0.0, scenario.nominal_duration, _STANDING_SAMPLES))
    if np.ptp(wind, axis=0).max() > _ROUNDING:
        return None, (
            "no bound is known in a wind that changes with time if power or drag depends on the "
            "airspeed nonlinearly, or times are free."
        )
    if mission.order is Order.BEST and mission.released > 0.0:
        return None, "no bound is known for a mass that changes where the order is open."
    standing = demand.thrust(dynamics.start, wind[0])
    fastest = float(steady.thrust(scenario.limits.rotor_speed_max))
    pairs = Pairs(scenario, dynamics, standing, fastest, winds)
    if pairs.fastest == inf:
        return None, "no bound is known where no drag limits the airspeed; give limits.speed_max."
    counted = scenario
    if mission.order is Order.BEST:
        counted = scenario.with_mission(waypoints=())
    legs, shared = legs_of(counted)
    found = bound_of_pairs(pairs, legs, shared, steady.hover_power)
    of_field = "" if winds is None else ", and over all winds that occur anywhere in the field,"
    if winds is not None and _has_places(scenario, legs, standing, winds):
        by_places = _bound_of_places(
            counted,
            lambda near: Pairs(scenario, dynamics, standing, fastest, near),
            winds,
            steady.hover_power,
        )
        # In some wind fields, the bound that counts the wind of each place is larger.
        if by_places > found:
            found = by_places
            of_field = ", and over all winds that occur in each cell of the field,"
    found -= _energy_returned(scenario, planner)
    if found <= 0.0:
        return None, "no prices were found that bound the energy above zero."
    return found, _basis_of_pairs(scenario, counted, len(legs), of_field)


def _basis_of_pairs(scenario: Scenario, counted: Scenario, legs: int, of_field: str) -> str:
    """Return the basis of the bound from `_bound_by_pairs`.

    `counted` has the mission of the bound: a copy of `scenario` without waypoints if their order is
    free. `legs` is the number of its legs. `of_field` is a clause on the winds of a wind field, or
    empty.
    """
    of_legs = f" on each of {legs} legs" if counted.mission.waypoints else ""
    left_out = (
        "; waypoints are left out where their order is open" if counted is not scenario else ""
    )
    return (
        "the means of force, of its power and of velocity are fixed by rest at both ends and by "
        f"the displacement{of_legs}{left_out}, and the least power over all pairs of thrust and "
        f"airspeed{of_field} under power.model {scenario.power.model.value} is proven by branch "
        "and bound to "
        f"{100 * POWER_TOLERANCE:g} % of that of hover; holds at all passing times and durations "
        "allowed, for every flight that meets the boundary conditions within the rotor speed limits"
        f"{_airspace_clause(scenario)}."
    )


def _bound_of_places(
    scenario: Scenario,
    pairs_in: Callable[[FloatArray], Pairs],
    winds: FloatArray,
    power: float,
) -> float:
    """Return a lower bound on the energy of flights through a wind field [J].

    If none is found, the result is minus infinity. Call it only if `_has_places` returns True. The
    corners `winds` enclose all winds; `pairs_in` makes the `Pairs` for corners. `power` is that of
    hover.
    """
    mission, ((leg,), (durations,)) = scenario.mission, legs_of(scenario)
    ends = np.array([mission.start.position, mission.goal.position])
    places = Places(winds_of_columns(scenario), ends)
    return bound_by_places(pairs_in, winds, places, leg, durations, power)


def _has_places(
    scenario: Scenario, legs: Sequence[Leg], standing: FloatArray, winds: FloatArray
) -> bool:
    """Return whether the function `_bound_of_places` can bound the energy of a mission.

    The result is True if all these conditions hold:

    - `wind.beyond` is not "hold";
    - the mission has one leg, without position tolerance at its ends;
    - the thrust `standing` for zero airspeed is vertical;
    - the rows of `winds` are horizontal and not all equal. They are the corners of a polyhedron
      that contains every wind of the mission.
    """
    return (
        scenario.wind.beyond is not Beyond.HOLD
        and len(legs) == 1
        and legs[0].slack == 0.0
        and not np.any(standing[:2])
        and not np.any(winds[:, 2])
        and bool(np.any(np.ptp(winds, axis=0) > _ROUNDING))
    )


def _airspace_clause(scenario: Scenario) -> str:
    """Return a clause which says that a bound also holds for flights within the airspace.

    Without keep-out zones, floor and ceiling, the clause is empty.
    """
    airspace = scenario.airspace
    if not airspace.keep_out and airspace.floor is None and airspace.ceiling is None:
        return ""
    return ", and so for those of them that stay within the airspace too"


def _obstacles(scenario: Scenario) -> Iterator[str]:
    """Yield a sentence for each feature of a scenario for which no lower bound is known.

    An example of such a feature is a user's own model.
    """
    if scenario.model is not None:
        yield f"no bound is known for a user's own model ({scenario.model})."
    if scenario.power.model is PowerModel.EFFICIENCY:
        yield (
            "power.model efficiency has no bound: its power is not convex in the rotor "
            "acceleration, so flights that accelerate and coast in turn can undercut it."
        )
    if scenario.wind.varies_with_place and scenario.wind.grid is None:
        yield "no bound is known in a wind that varies with height: its mean depends on the path."
    if scenario.wind.grid is not None and scenario.wind.coupling is not WindCoupling.DRAG:
        yield (
            "no bound is known in a wind field that acts as an acceleration; set wind.coupling = "
            '"drag".'
        )
    if acts_in_body_axes(scenario):
        yield (
            "no bound is known for aerodynamic forces in body axes, which depend on attitude and "
            "rotor speeds."
        )
    if scenario.limits.rotor_speed_min >= scenario.limits.rotor_speed_max:
        yield _IMPOSSIBLE


def _best_bound(moments: ThrustMoments, power: _SteadyPower, ceiling: float) -> float:
    """Maximise the dual function over its multipliers; return the best lower bound found [J].

    It is never below the bound of Jensen's inequality: docs/theory/bound.md, eqs. (8) and (9). The
    search stops if it exceeds `ceiling`, the energy of a flight at full power [J].
    """

    def negative(multipliers: FloatArray) -> tuple[float, FloatArray]:
        given = multipliers.reshape(2, 3)
        size, direction = moments.price(given)
        conjugate, thrust = power.conjugate(size)
        slope = moments.supplied(thrust[:, None] * direction) - moments.demanded
        bound = np.sum(given * moments.demanded) - moments.widths @ conjugate
        return -float(bound), slope.ravel()

    def stop_above(intermediate_result: OptimizeResult) -> None:
        # A bound above the energy of full power proves that no flight exists.
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
    """Total thrust [N] and total power [W] of the vehicle with all rotors at one constant speed.

    Polynomials of the rotor speed are fitted to the model. The methods use their values at several
    thousand speeds between the limits. If the model itself is polynomial (`is_polynomial`), the
    values are exact to rounding.
    """

    def __init__(self, scenario: Scenario, steady: SteadyFlight) -> None:
        slowest, fastest = scenario.limits.rotor_speed_min, scenario.limits.rotor_speed_max
        between = 0.5 * (1 - np.cos(np.pi * np.arange(_FIT_NODES) / (_FIT_NODES - 1)))
        speeds = slowest + (fastest - slowest) * between
        # Dense in the range of usual flights, however high the limit is.
        usual = np.clip(_USUAL_SPEED * steady.hover_speed, slowest, fastest)
        samples = np.union1d(
            np.linspace(slowest, usual, _SAMPLES), np.linspace(usual, fastest, _SAMPLES)
        )
        thrust, self.thrust, has_thrust = _fit(steady.thrust(speeds), speeds, samples)
        # Models in which braking earns nothing replace a negative power by zero. The power before
        # this replacement is at most the power of the model, so the bound stays valid.
        power, self.power, has_power = _fit(steady.uncredited_power(speeds), speeds, samples)
        self._slope = power.deriv()(samples[1:]) / thrust.deriv()(samples[1:])
        self.is_polynomial = has_thrust and has_power
        corners = _corners(self.thrust, _below(self.thrust, self.power))
        self._thrust, self._floor = corners
        self._chords = np.diff(self._floor) / np.diff(self._thrust)

    def slope(self, thrust: float) -> float:
        """Return the derivative of the power with respect to the thrust [W/N].

        `thrust` is the total thrust [N] at which the derivative is taken.
        """
        return float(np.interp(thrust, self.thrust[1:], self._slope))

    def conjugate(self, price: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the maximum of price * thrust - power [W], and its thrust [N], for each price.

        The maximum is the convex conjugate of the power. The result is never below it, because a
        lower bound replaces the power: docs/theory/bound.md, eq. (10). `price` [W/N] is not
        negative.
        """
        best = np.searchsorted(self._chords, price)
        return price * self._thrust[best] - self._floor[best], self._thrust[best]


def _fit(
    computed: FloatArray, speeds: FloatArray, samples: FloatArray
) -> tuple[Chebyshev, FloatArray, bool]:
    """Fit a polynomial of the rotor speed to computed values of the model's thrust or power.

    Return the fit, its values at `samples`, and whether it equals `computed` to rounding.
    """
    domain = [speeds[0], speeds[-1]]
    polynomial = Chebyshev.fit(speeds, computed, _DEGREE, domain=domain)
    error = float(np.max(np.abs(polynomial(speeds) - computed)))
    return polynomial, polynomial(samples), error <= _FIT_ERROR * float(np.max(np.abs(computed)))


def _below(thrust: FloatArray, power: FloatArray) -> FloatArray:
    """Lower samples of the power so that lines between them stay below the true curve [W].

    A sample above the line through the previous two is lowered to it (docs/theory/bound.md, eq.
    (10)). Near each sample, the curve is assumed convex or concave. `thrust` [N] is increasing.
    """
    chords = np.diff(power) / np.diff(thrust)
    # The power rises with thrust, so the first step extends a level line.
    extended = power[:-1] + np.concatenate([[0.0], chords[:-1]]) * np.diff(thrust)
    return np.concatenate([power[:1], np.minimum(power[1:], extended)])


def _corners(thrust: FloatArray, power: FloatArray) -> FloatArray:
    """Return the vertices of the lower convex hull of power over thrust, shape (2, n).

    `thrust` [N] is increasing. The rows of the result hold thrusts [N] and powers [W].
    """
    kept: list[tuple[float, float]] = []
    for x, y in zip(thrust.tolist(), power.tolist(), strict=True):
        while len(kept) > 1:
            (x0, y0), (x1, y1) = kept[-2:]
            if (x1 - x0) * (y - y1) > (y1 - y0) * (x - x1):
                break
            kept.pop()
        kept.append((x, y))
    return np.array(kept).T
