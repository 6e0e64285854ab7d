"""Verification of plans: SciPy simulates the planned controls, independently of the solver."""

from __future__ import annotations

from collections.abc import Mapping  # noqa: TC003  read by pydantic
from dataclasses import dataclass
from itertools import pairwise
from math import ceil, inf
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.collocation import ClosedLoop, Dynamics, Mesh, Violation, control_polynomial
from pyomo_quad.flight.deadline import keep_time
from pyomo_quad.flight.flight import (
    HELD_BREACH,
    POSITION_STATES,
    Flown,
    position_miss,
    terminal_miss_of,
)
from pyomo_quad.flight.integration import Rates, integrate
from pyomo_quad.flight.limit_words import breach_words
from pyomo_quad.model.wind_field import unknown_wind
from pyomo_quad.scenario.accuracy import FIGURES, USABLE, Accuracy, Figures

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from pyomo_quad.arrays import FloatArray
    from pyomo_quad.scenario import Scenario
    from pyomo_quad.scenario.airspace import Airspace


# Tolerances of the highest accuracy, the default.
_PROOF = FIGURES[Accuracy.PROOF]
#: Samples of a simulated flight in each mesh element, at which limits are checked.
SAMPLES_PER_ELEMENT = 8
# Distance from a zone within which samples are dense, relative to the distance between two nodes of
# the path: one half is enough for a straight path between the nodes.
_REACH = 2.0
# Decimals of a sample's place in its element beyond which two samples count as one.
_DIGITS = 9
# Without feedback, an error of a rotor's speed grows into an error of position with the fourth
# power of time. Flights longer than `_LONG_S` [s] are integrated with a correspondingly smaller
# tolerance, which rounding bounds from below by `_SHARPEST`.
_LONG_S, _POWER, _SHARPEST = 30.0, 4, 3e-14
# Least number of steps per element of these flights at the highest accuracy, because DOP853
# underestimates small errors: it steps across ripples of 1e-6 in a control, which change a rotor
# speed by 1e-7 rad/s.
_STEPS = 4


def fly_controls(
    dynamics: Dynamics,
    mesh: Mesh,
    controls: FloatArray,
    start: FloatArray,
    horizon: tuple[float, float],
    *,
    samples_per_element: int | Sequence[FloatArray] = SAMPLES_PER_ELEMENT,
    method: str = "DOP853",
    integration: float = _PROOF.integration,
) -> Flown:
    """Simulate the controls of a plan in open loop, between the two times of `horizon` [s].

    A failed integration raises a SolveError, as does the time limit of an enclosing `Deadline`.

    Parameters
    ----------
    dynamics : Dynamics
        Equations of the vehicle.
    mesh : Mesh
        Mesh of the plan.
    controls : ndarray, shape (n_points, n_controls)
        Controls at the collocation points.
    start : ndarray, shape (n_states,)
        Initial states.
    horizon : (float, float)
        Start and end of the flight [s].
    samples_per_element : int or sequence of ndarray
        Number of equally spaced samples in each mesh element; or one array per element, of
        fractions of the element that increase to 1.
    method : str
        Integration method of `scipy.integrate.solve_ivp`.
    integration : float
        Relative and absolute tolerance of the integration. In flights longer than 30 s, the
        relative tolerance is smaller.
    """
    borders = horizon[0] + (horizon[1] - horizon[0]) * np.asarray(mesh.breakpoints)
    flow = ClosedLoop.without_feedback(dynamics)
    # Controls are clipped at limits that are widened by HELD_BREACH * max(1, abs(limit)).
    limits = dynamics.control_limits(HELD_BREACH)
    shares = samples_per_element
    if isinstance(shares, int):
        shares = [_equal_shares(shares)] * mesh.elements
    share = min(1.0, _LONG_S / (horizon[1] - horizon[0]))
    tolerance = max(_SHARPEST, integration * share**_POWER)
    is_rough = share == 1.0 or integration > _PROOF.integration
    step = inf if is_rough else share / _STEPS
    state = np.append(start, 0.0)
    parts_t: list[FloatArray] = [borders[:1]]
    parts_y = [state[:, None]]
    parts_u: list[FloatArray] = []
    for element, (first, last) in enumerate(pairwise(borders.tolist())):
        polynomial = control_polynomial(mesh, controls, element, first, last, limits)
        samples = first + (last - first) * shares[element]
        samples[-1] = last
        flown = integrate(
            rates_in_element(flow, polynomial, dynamics.just_after(first)),
            (first, last),
            state,
            samples,
            dynamics.steps_between(first, last),
            flight="flight",
            remedy="Look at the plan's controls there.",
            method=method,
            rtol=tolerance,
            atol=integration,
            max_step=step * (last - first),
        )
        state = flown[:, -1]
        if not parts_u:
            parts_u.append(polynomial(first)[None, :])
        parts_t.append(samples)
        parts_y.append(flown)
        parts_u.append(np.array([polynomial(t) for t in samples]))
    values = np.hstack(parts_y)
    return Flown(
        t=np.concatenate(parts_t),
        states=values[:-1].T,
        controls=np.vstack(parts_u),
        energy=values[-1],
    )


def rates_in_element(
    flow: ClosedLoop, control: Callable[[float], FloatArray], inside: float
) -> Rates:
    """Return the right-hand side of the equations of motion for a simulation of one mesh element.

    It is a function of time [s] and state. `control` gives the controls at a time. `inside` is a
    time just after the start of the element [s]. At earlier times, all parameters have their values
    at `inside`. A jump of a parameter at the start of the element is thus already past.
    """

    def rates(t: float, y: FloatArray) -> FloatArray:
        keep_time()
        # Before `inside`, the parameters have their values at `inside`: the mass after a release,
        # for example.
        return flow.rates(max(t, inside), y, control(t))

    return rates


#: Largest tolerated difference between the power drawn and voltage times current of the pack,
#: relative to the power. Beyond the pack's greatest power, where a guard keeps the current finite,
#: the difference is larger. The same tolerance applies to the voltage that the motors need.
BALANCE_TOLERANCE = 1e-3

# Components that the battery's balance is computed from, and the voltage that a motor needs.
_VOLTAGE = "battery.voltage"
_BALANCE = ("power.total", _VOLTAGE, "battery.current", "battery.state_of_charge")
#: Quantities of the battery, sampled along a flight, from which `balance_lacking` computes the
#: missing power and charge.
BALANCE_KEYS = tuple((name, None) for name in _BALANCE)
#: Index of the state of charge [percent] in `BALANCE_KEYS`.
CHARGE_KEY = len(_BALANCE) - 1
_MOTOR_VOLTAGE = "power.terminal_voltage"
# Smallest motor voltage that a missing voltage is divided by: a stopped motor needs none.
_STANDSTILL_V = 1e-3


@dataclass(frozen=True, kw_only=True)
class Verification:
    """Comparison of a plan with the simulation of its controls without feedback.

    Attributes
    ----------
    terminal_miss : mapping
        Simulated minus planned final value of each state, by the state's name, in the state's unit.
    terminal_miss_m : float
        Distance between the simulated and the planned final position [m].
    worst_miss : str
        Name of the state with the largest final deviation relative to max(1, abs(planned value)).
    max_violation, worst_constraint : float, str
        Largest violation of a limit relative to max(1, abs(limit)), and the name of the limit.
    breaches : tuple of Violation
        Largest violation of each limit along the flight, in order of decreasing relative violation;
        0 for a limit that is kept.
    broken_limits : tuple of str
        Every limit violated by more than the tolerance, with the amount.
    energy_difference_J, flown_energy_J : float
        Simulated minus planned energy, and simulated energy.
    passing_misses_m : tuple of float
        For each waypoint, the distance by which the flight passes outside its radius [m].
    battery_imbalance : float
        The greater of two fractions: the largest missing power relative to the power drawn, and the
        charge drawn beyond the capacity relative to the capacity.
    voltage_lacking : float
        Largest fraction of a motor's voltage that the battery cannot supply; negative if the
        battery always supplies more than needed.
    is_verified : bool
        Whether all deviations and shortfalls are within the tolerances of the required accuracy.
    is_usable : bool
        Like `is_verified`, with the wider tolerances `scenario.accuracy.USABLE`.
    reached : Accuracy or None
        Highest accuracy level, up to the required one, whose tolerances the flight keeps; None if
        there is no such level.
    """

    terminal_miss: Mapping[str, float]
    terminal_miss_m: float
    worst_miss: str
    max_violation: float
    worst_constraint: str
    energy_difference_J: float
    flown_energy_J: float
    is_verified: bool
    breaches: tuple[Violation, ...] = ()
    broken_limits: tuple[str, ...] = ()
    passing_misses_m: tuple[float, ...] = ()
    battery_imbalance: float = 0.0
    voltage_lacking: float = 0.0
    reached: Accuracy | None = None
    is_usable: bool = False

    @property
    def is_fed(self) -> bool:
        """Whether the battery can supply the power, charge and voltage that the flight needs."""
        return max(self.battery_imbalance, self.voltage_lacking) <= BALANCE_TOLERANCE

    @property
    def shortfall(self) -> str:
        """One line on the shortfall of the battery and its remedy; empty without a shortfall."""
        if self.battery_imbalance > BALANCE_TOLERANCE:
            return (
                f"battery: the pack lacks {100.0 * self.battery_imbalance:.3g} % of the power or "
                "charge that the flight takes; give it more cells, carry less or allow more time."
            )
        if not self.is_fed:
            return (
                f"battery: the pack lacks {100.0 * self.voltage_lacking:.3g} % of the voltage that "
                "the motors need to keep their speed; give it more cells in series, or motors of a "
                "higher vehicle.voltage_constant."
            )
        return ""


def voltage_lacking(dynamics: Dynamics, flown: Flown) -> float:
    """Return the largest fraction of a motor's voltage that the battery cannot supply in a flight.

    The fraction is (needed - supplied) / needed for the motor that needs most. It is negative if
    the battery always supplies more, and 0 for a model without motor voltage or battery voltage.
    """
    if not dynamics.has(_MOTOR_VOLTAGE) or not dynamics.has(_VOLTAGE):
        return 0.0
    count = sum(name.startswith("rotors.omega[") for name in dynamics.state_names)
    keys = (*((_MOTOR_VOLTAGE, j + 1) for j in range(count)), (_VOLTAGE, None))
    # Voltage at constant rotor speed: the model's limit on the rotor acceleration accounts for the
    # further voltage of an accelerating rotor.
    steady = np.zeros_like(flown.controls)
    *needed, given = dynamics.table(keys, flown.t, flown.states, steady).T
    highest = np.max(needed, axis=0)
    return float(np.max((highest - given) / np.maximum(_STANDSTILL_V, highest)))


def wind_lacking(scenario: Scenario, dynamics: Dynamics, flown: Flown) -> str:
    """Return a message if a flight leaves the wind field of its plan, otherwise an empty text.

    The message is empty, too, if the states of `dynamics` do not include the position.
    """
    if not set(POSITION_STATES) <= set(dynamics.state_names):
        return ""
    columns = [dynamics.state_names.index(name) for name in POSITION_STATES]
    return unknown_wind(scenario.as_forecast(), flown.t, flown.states[:, columns])


def shares_lacking(dynamics: Dynamics, flown: Flown) -> tuple[float, float]:
    """Return the largest fractions of power and charge that the battery cannot supply in a flight.

    Returns
    -------
    (float, float)
        Largest values over the samples of the flight: missing power relative to the power drawn,
        and missing charge relative to the capacity. See `balance_lacking`. Both are zero for a
        model without a battery.
    """
    if not has_balance(dynamics):
        return 0.0, 0.0
    return balance_lacking(dynamics.table(BALANCE_KEYS, flown.t, flown.states, flown.controls))


def has_balance(dynamics: Dynamics) -> bool:
    """Return whether the model has a battery whose power balance can be checked.

    The power balance states that the power drawn equals voltage times current of the battery.
    """
    return all(dynamics.has(name) for name in _BALANCE)


def balance_lacking(balance: FloatArray) -> tuple[float, float]:
    """Return the largest fractions of power and charge that a battery lacks at given times.

    `balance` has one row per time and the columns of `BALANCE_KEYS`. The lacking power is relative
    to the power drawn. The lacking charge is the charge drawn beyond the capacity, relative to the
    capacity; it is negative if charge remains.
    """
    power, voltage, current, charge = balance.T
    # The battery's equations keep voltage and current finite beyond the greatest power of the pack.
    # Their product is then less than the power.
    lacking = np.abs(power - voltage * current) / np.maximum(1.0, np.abs(power))
    return float(np.max(lacking)), float(-np.min(charge) / 100.0)


def _equal_shares(count: int) -> FloatArray:
    """Return the ends of ``count`` equal parts of a mesh element, as fractions, shape (count,)."""
    return np.linspace(0.0, 1.0, count + 1)[1:]


# Distance between samples over terrain, relative to a cell of the grid: between two samples, the
# height above the ground differs by at most a thousandth of the ground's curvature in a cell.
_PART_OF_CELL = 1 / 20


def samples_of_path(
    dynamics: Dynamics,
    mesh: Mesh,
    states: FloatArray,
    airspace: Airspace | None,
    spacing: float,
) -> list[FloatArray]:
    """Return where to sample each mesh element of a simulated flight, to check limits on position.

    The samples are fractions of the element, increasing to 1. They are at most `spacing` [m] apart
    near zones, and 1/20 of a grid step near height limits over terrain. `states` are at the nodes.
    """
    if airspace is None or not set(POSITION_STATES) <= set(dynamics.state_names):
        return [_equal_shares(SAMPLES_PER_ELEMENT)] * mesh.elements
    places = states[:, [dynamics.state_names.index(name) for name in POSITION_STATES]]
    gaps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    depths = [np.full(len(places), -np.inf), *(zone.depth(places) for zone in airspace.keep_out)]
    depth = np.max(depths, axis=0) + airspace.clearance
    is_near = np.maximum(depth[:-1], depth[1:]) > -_REACH * gaps
    apart = np.where(is_near, spacing, np.inf)
    if airspace.ground is not None:
        room = airspace.distance_to_height_limits(places)
        is_low = np.minimum(room[:-1], room[1:]) < _REACH * gaps
        step = _PART_OF_CELL * airspace.ground.least_step
        apart = np.minimum(apart, np.where(is_low, step, np.inf))
    nodes = mesh.node_fractions
    samples = []
    for e, (first, end) in enumerate(pairwise(mesh.first_node)):
        shares = (nodes[first : end + 1] - mesh.breakpoints[e]) / mesh.widths[e]
        close = [
            np.linspace(shares[k], shares[k + 1], ceil(gaps[first + k] / apart[first + k]) + 1)
            for k in np.flatnonzero(np.isfinite(apart[first:end]))
        ]
        inner = (row[1:-1] for row in close)
        every = np.concatenate([_equal_shares(SAMPLES_PER_ELEMENT), *inner])
        samples.append(np.unique(np.round(every, _DIGITS)))
    return samples


@dataclass(frozen=True, kw_only=True)
class Passage:
    """Waypoint that a flight must pass at a given time, within a given distance.

    Attributes
    ----------
    time_s : float
        Passing time [s].
    position : (float, float, float)
        Coordinates of the waypoint [m].
    radius : float
        Largest distance from the waypoint [m].
    """

    time_s: float
    position: tuple[float, float, float]
    radius: float


def _passing_miss(dynamics: Dynamics, flown: Flown, passage: Passage) -> float:
    """Return the distance by which a flight passes outside the radius of a waypoint [m], or 0."""
    nearest = int(np.argmin(np.abs(flown.t - passage.time_s)))  # an element ends there
    columns = [dynamics.state_names.index(name) for name in POSITION_STATES]
    off = np.linalg.norm(flown.states[nearest, columns] - passage.position)
    return max(0.0, float(off) - passage.radius)


def verify_controls(
    dynamics: Dynamics,
    mesh: Mesh,
    states: FloatArray,
    controls: FloatArray,
    horizon: tuple[float, float],
    energy: float,
    airspace: Airspace | None = None,
    passages: Sequence[Passage] = (),
    accuracy: Accuracy = Accuracy.PROOF,
    goal: FloatArray | None = None,
) -> tuple[Verification, Flown]:
    """Simulate a plan's controls and compare the flight with the plan.

    `states` are at the nodes, shape (n_points + 1, n_states). `energy` is the planned energy [J].
    `goal` has the final states to reach, by default those planned. `passages` are the waypoints
    with the times at which they must be passed. `accuracy` sets the tolerances. See `fly_controls`
    for `controls`, `horizon` and errors. Limits are checked at the samples of `samples_of_path`.
    """
    figures = FIGURES[accuracy]
    flown = fly_controls(
        dynamics,
        mesh,
        controls,
        states[0],
        horizon,
        samples_per_element=samples_of_path(dynamics, mesh, states, airspace, figures.spacing),
        integration=figures.integration,
    )
    wanted = states[-1] if goal is None else goal
    return compared(dynamics, flown, energy, wanted, passages, accuracy), flown


def compared(
    dynamics: Dynamics,
    flown: Flown,
    energy: float,
    wanted: FloatArray,
    passages: Sequence[Passage],
    accuracy: Accuracy,
) -> Verification:
    """Compare a flight with the plan: final states, energy, limits and battery.

    `flown` is the flight, and `energy` the planned energy [J]. `wanted` has the final states that
    the flight should reach, and `passages` the waypoints that it should pass. `accuracy` is the
    required accuracy level, which sets the tolerances.
    """
    figures = FIGURES[accuracy]
    planned = dict(zip(dynamics.state_names, wanted, strict=True))
    miss = terminal_miss_of(dynamics, flown.states[-1], planned)
    relative = {name: abs(m) / max(1.0, abs(planned[name])) for name, m in miss.items()}
    worst_miss = max(relative, key=lambda name: relative[name])
    instants = dynamics.solved(flown.t, flown.states, flown.controls)
    (breaches,) = dynamics.violations_of(instants, flown.t)
    breach, imbalance = breaches[0], 0.0
    if has_balance(dynamics):
        imbalance = max(balance_lacking(instants.table(BALANCE_KEYS)))
    lacking = voltage_lacking(dynamics, flown)
    flown_energy = float(flown.energy[-1])
    passing = tuple(_passing_miss(dynamics, flown, passage) for passage in passages)
    found = _Found(
        miss=max(relative[worst_miss], *passing, 0.0),
        breaches=breaches,
        energy=abs(flown_energy - energy) / max(1.0, abs(energy)),
        lacking=max(imbalance, lacking),
    )
    reached = found.reached(accuracy)
    return Verification(
        terminal_miss=miss,
        terminal_miss_m=position_miss(miss),
        worst_miss=worst_miss,
        max_violation=breach.relative,
        worst_constraint=breach.name,
        energy_difference_J=flown_energy - energy,
        flown_energy_J=flown_energy,
        is_verified=reached is accuracy,
        breaches=breaches,
        broken_limits=tuple(
            breach_words(b, dynamics.unit(b.name)) for b in beyond(breaches, figures)
        ),
        passing_misses_m=passing,
        battery_imbalance=imbalance,
        voltage_lacking=lacking,
        reached=reached,
        is_usable=found.meets(USABLE),
    )


# Limit of a mission that keeps the heading.
_HEADING = "mission.yaw_keeping"


def is_of_airspace(breach: Violation) -> bool:
    """Return whether a violated limit belongs to the airspace: a zone, the fence, floor or ceiling.

    The amount of the violation is then in m.
    """
    return breach.name.startswith("airspace.")


def tolerated(breach: Violation, figures: Figures) -> float:
    """Return the tolerance for violations of a limit, in the limit's unit.

    `breach` is a violation of the limit, and `figures` has the tolerances of an accuracy level.
    """
    if breach.name == _HEADING:
        return figures.turning
    by_size = figures.breach * max(1.0, abs(breach.bound))
    return min(by_size, figures.intrusion) if is_of_airspace(breach) else by_size


def beyond(breaches: Iterable[Violation], figures: Figures) -> tuple[Violation, ...]:
    """Return those violations of limits that exceed the tolerances `figures`, in the same order."""
    return tuple(breach for breach in breaches if breach.size > tolerated(breach, figures))


@dataclass(frozen=True, kw_only=True)
class _Found:
    """Largest errors of a simulated flight compared with its plan."""

    # Largest of the deviations of the final states from the plan, each divided by max(1,
    # abs(planned value)), and the distances by which the flight passes outside the radius of a
    # waypoint [m].
    miss: float
    breaches: tuple[Violation, ...]
    # Deviation from the planned energy, divided by max(1 J, planned energy).
    energy: float
    # Largest fraction of power, charge or motor voltage that the battery cannot supply.
    lacking: float

    def reached(self, asked: Accuracy) -> Accuracy | None:
        """Return the highest accuracy level, up to `asked`, that the flight reaches, or None."""
        met = [a for a in Accuracy if asked.meets(a) and self.meets(FIGURES[a])]
        return met[-1] if met else None

    def meets(self, figures: Figures) -> bool:
        """Return whether all errors are within the tolerances of an accuracy level."""
        return bool(
            self.miss <= figures.miss
            and not beyond(self.breaches, figures)
            and self.energy <= figures.energy
            and self.lacking <= BALANCE_TOLERANCE
        )
