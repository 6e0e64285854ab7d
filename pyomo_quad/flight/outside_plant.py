"""Flights in the simulator RotorPy [1]_, with this package's controller or RotorPy's own.

RotorPy is independent of this package. Its flights therefore test plans and controllers. The
declared vehicle is that of the scenario's Pyomo model. The table shows which parameters of RotorPy
(right) follow from the declared vehicle (left):

declared vehicle | RotorPy
mass, inertias, thrust and drag torque over rotor speed squared | mass, Ixx.., k_eta, k_m
places and spins of the rotors, derived from the declared mixer | rotor_pos, rotor_directions
drag of rotors, translational lift, parasitic drag by axis | k_d, k_z, k_h, c_Dx..
quadratic drag | added to c_Dx, c_Dy and c_Dz; acts along the body axes
linear drag / (number of rotors x rotor speed in hover) | added to k_d and k_z; acts at the rotors

RotorPy neglects the inertia of the rotors. Two moments on the body are therefore added to RotorPy's
equations: the gyroscopic moment of spinning rotors, and the yaw moment of accelerating rotors.
Energy is the integral of the declared power at RotorPy's rotor speeds. `Habits` switches on
features of RotorPy's own simulation that differ from the declared equations.

.. [1] Folk, Paulos and Kumar, "RotorPy: A Python-based Multirotor Simulator with Aerodynamics for
   Education and Research", arXiv 2306.04485.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from importlib import import_module
from itertools import pairwise
from math import pi, sqrt, tau
from time import perf_counter
from types import ModuleType
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import Dynamics, SolveError, control_polynomial
from pyomo_quad.flight.baselines import (
    LONGEST_STEP,
    RATE_HZ,
    Integrator,
    TumblingGuard,
    assembled_flight,
    even_times,
    reference_path,
    refuse_other_vehicles,
    start_state,
)
from pyomo_quad.flight.controller import (
    MEASURED_STATES,
    AdaptiveController,
    feedback_law,
    mixer_matrix,
    rotor_columns,
)
from pyomo_quad.flight.flight import HELD_BREACH, Flight, Flown
from pyomo_quad.flight.plan import Plan
from pyomo_quad.flight.references import ReferencePath
from pyomo_quad.scenario import Reference, Scenario, ScenarioError
from pyomo_quad.scenario.wind import WindAxis, WindCoupling

Answer = tuple[Sequence[float], Sequence[float]]
"""Output of a control law: rotor accelerations [rad/s^2], and the rates of the law's own states."""
OutsideLaw = Callable[[float, FloatArray, Sequence[float]], Answer]
"""Control law: function of time, declared states of the vehicle, and the law's own states."""

# Name of the simulator and of its module, and the message if it is not installed.
PLANT = "rotorpy"
MULTIROTOR = "vehicles.multirotor"
_MISSING = "RotorPy is not installed; install it with pip install 'pyomo_quad[rotorpy]'."
# Tolerance of controlled flights, and of the plan's controls without feedback, whose errors grow.
_TOLERANCE, _TIGHT = 1e-7, 1e-11
# Default absolute tolerance of SciPy's integrators, which RotorPy does not change.
_ABSOLUTE = 1e-6
# Integrators of feedback flights. With SE3, the yaw reaction couples body rates and commands at
# thousands of 1/s: explicit integrators would take steps of a third of a millisecond.
_STIFF: tuple[str, str] = ("Radau", Integrator.MULTISTEP)
# Integrators of flights whose commands are constant over milliseconds: each such part takes one or
# two steps.
_EXPLICIT: tuple[str, str] = ("RK45", Integrator.RUNGE_KUTTA)
# Relative distance after the start of a part of a flight at which its law is evaluated.
_INSIDE = 1e-9
# Samples of the wind per second, between which a cubic spline interpolates.
_WIND_RATE_HZ = 1000.0
# Indices in RotorPy's state vector.
_POSITION, _VELOCITY, _QUATERNION = slice(0, 3), slice(3, 6), slice(6, 10)
_BODY_RATES, _WIND, _SPEEDS = slice(10, 13), slice(13, 16), slice(16, 20)
_SIZE = 20


class Pilot(StrEnum):
    """Controller of a flight in RotorPy.

    `ADAPTIVE` is the adaptive controller of this package, `SE3` is RotorPy's geometric controller,
    and `OPEN_LOOP` applies the plan's controls without feedback.
    """

    ADAPTIVE = "adaptive"
    SE3 = "se3"
    OPEN_LOOP = "open_loop"


@dataclass(frozen=True, kw_only=True)
class BodyFrame:
    """Body axes and rotor numbers of RotorPy's vehicle, relative to the scenario's model.

    RotorPy's body axes are those of the model, turned by `turn` about the z axis, from x to y.
    RotorPy's rotor k is rotor `order[k]` of the model; both count from 0.
    """

    turn: float = 0.0
    """Angle from the declared body x axis to RotorPy's [rad]."""
    order: tuple[int, ...] = (0, 1, 2, 3)
    """Number of the declared rotor for each of RotorPy's rotors."""


@dataclass(frozen=True, kw_only=True)
class Habits:
    """Switches for features of RotorPy's own simulation that differ from the scenario's model.

    With the default values, RotorPy's vehicle obeys the equations of the scenario's Pyomo model.
    """

    gravity: float | None = None
    """Gravity [m/s^2] in place of the scenario's."""
    has_gyroscopic_moment: bool = True
    """Whether spinning rotors add a gyroscopic moment."""
    has_yaw_reaction: bool = True
    """Whether accelerating rotors turn the body in yaw."""
    command_rate_hz: float | None = None
    """Rate of rotor commands, which are constant in between and followed by the motors with their
    lag; None for continuous commands."""
    tolerance: float | None = None
    """Relative tolerance of RotorPy's integrator."""


MASSLESS_ROTORS = Habits(has_gyroscopic_moment=False, has_yaw_reaction=False)
AS_IT_COMES = replace(MASSLESS_ROTORS, command_rate_hz=100.0, tolerance=1e-3)
"""Defaults of RotorPy's own simulation."""

ACROSS = BodyFrame(turn=-pi / 4, order=(0, 3, 2, 1))
"""Body axes with two rotors ahead, numbered clockwise from the left rotor."""


def rotorpy_module(name: str) -> ModuleType:
    """Import a module of RotorPy; `name` is its name within the package.

    Raises
    ------
    ScenarioError
        If RotorPy is not installed.
    """
    try:
        return import_module(f"rotorpy.{name}")
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != PLANT:
            raise
        raise ScenarioError(_MISSING) from None


def quad_parameters(scenario: Scenario, dynamics: Dynamics) -> dict[str, Any]:
    """Return the vehicle of a scenario as RotorPy's parameter dictionary (`quad_params`).

    `dynamics` has the equations of the vehicle, from which thrust and moments of the rotors
    follow.
    """
    vehicle, limits = scenario.vehicle, scenario.limits
    thrust, roll, pitch, yaw = mixer_matrix(dynamics)
    places = np.column_stack([-pitch / thrust, roll / thrust, np.zeros(len(thrust))])
    is_drag = scenario.wind.coupling is WindCoupling.DRAG
    along = vehicle.drag_linear / (len(thrust) * vehicle.hover_speed(scenario.gravity))
    linear, quadratic = (along, vehicle.drag_quadratic) if is_drag else (0.0, 0.0)
    by_axis = zip(("c_Dx", "c_Dy", "c_Dz"), vehicle.parasitic_drag, strict=True)
    return {
        "mass": vehicle.total_mass,
        "Ixx": vehicle.Ix,
        "Iyy": vehicle.Iy,
        "Izz": vehicle.Iz,
        **dict.fromkeys(("Ixy", "Iyz", "Ixz"), 0.0),
        "num_rotors": len(thrust),
        "rotor_pos": {f"r{k}": place for k, place in enumerate(places, start=1)},
        "rotor_directions": np.sign(yaw),
        "k_eta": float(thrust[0]),
        "k_m": float(abs(yaw[0])),
        **{name: quadratic + along_axis for name, along_axis in by_axis},
        "k_d": linear + vehicle.rotor_drag_plane,
        "k_z": linear + vehicle.rotor_drag_axis,
        "k_h": vehicle.translational_lift,
        "k_flap": 0.0,
        "tau_m": 1 / scenario.baseline.gains.rotor,
        "rotor_speed_min": limits.rotor_speed_min,
        "rotor_speed_max": limits.rotor_speed_max,
    }


class OutsidePlant:
    """RotorPy's multirotor, simulated with the states, controls and power of the declared model.

    The declared model is the scenario's Pyomo model. A joint state has four parts: RotorPy's state
    vector, the declared states that RotorPy lacks (such as the charge drawn), the own states of a
    control law, and the energy spent.

    Parameters
    ----------
    parameters : mapping, optional
        RotorPy's parameters; by default those of the declared vehicle.
    frame : BodyFrame, optional
        Body axes of these parameters.
    habits : Habits, optional
        Differences from the declared equations; none by default.

    Raises
    ------
    ScenarioError
        If RotorPy is not installed or cannot simulate the mission.
    """

    def __init__(
        self,
        scenario: Scenario,
        dynamics: Dynamics,
        *,
        parameters: Mapping[str, Any] | None = None,
        frame: BodyFrame | None = None,
        habits: Habits | None = None,
    ) -> None:
        refuse_other_vehicles(scenario, dynamics)
        refuse_pushing_wind(scenario)
        self._rotors = rotor_columns(dynamics)
        if len(self._rotors) != _SIZE - _SPEEDS.start:
            raise ScenarioError(
                f"{scenario.name}: RotorPy's multirotor is flown with four rotors, the vehicle has "
                f"{len(self._rotors)}; leave out --plant rotorpy."
            )
        self.scenario, self.dynamics = scenario, dynamics
        self.parameters = dict(parameters or quad_parameters(scenario, dynamics))
        frame, self.habits = frame or BodyFrame(), habits or Habits()
        self._vehicle = rotorpy_module(MULTIROTOR).Multirotor(
            self.parameters, control_abstraction="cmd_motor_speeds"
        )
        gravity = self.habits.gravity or scenario.gravity
        self._vehicle.g = gravity
        self._vehicle.weight = np.array([0.0, 0.0, -self.parameters["mass"] * gravity])
        self.turn = frame.turn
        self._turn = Rotation.from_euler("z", frame.turn)
        self._order = list(frame.order)
        inertia = scenario.vehicle.rotor_inertia
        self._gyroscopic = inertia if self.habits.has_gyroscopic_moment else 0.0
        self._reacting = inertia if self.habits.has_yaw_reaction else 0.0
        names = dynamics.state_names
        body = [names.index(name) for name in MEASURED_STATES]
        self._place, self._angles, self._rates = body[:6], body[6:9], body[9:12]
        self._others = [k for k in range(len(names)) if k not in {*body, *self._rotors}]
        mission = scenario.mission
        self._yaw = 0.5 * (mission.start.yaw + mission.goal.yaw)
        self._wind = _wind_of(scenario, dynamics)

    def started(self, x: FloatArray, own: Sequence[float]) -> FloatArray:
        """Return the initial joint state of a simulation (see `OutsidePlant`).

        `x` holds the initial declared states, shape (n_states,). `own` holds the initial own states
        of the control law.
        """
        s = np.zeros(_SIZE)
        s[:6] = x[self._place]
        attitude = Rotation.from_euler("ZYX", x[self._angles][::-1]) * self._turn
        s[_QUATERNION] = attitude.as_quat()
        s[_BODY_RATES] = self._turn.inv().apply(x[self._rates])
        s[_SPEEDS] = x[self._rotors][self._order]
        return np.array([*s, *x[self._others], *own, 0.0])

    def read(self, joint: FloatArray) -> FloatArray:
        """Return the declared states, shape (n_states,), from a joint state (see `OutsidePlant`).

        Of the yaw angles that differ by 2 pi, the result has the one nearest to the mean of the
        mission's initial and final yaw.
        """
        x = np.empty(len(self.dynamics.state_names))
        x[self._place] = joint[:6]
        attitude = Rotation.from_quat(joint[_QUATERNION]) * self._turn.inv()
        yaw, pitch, roll = attitude.as_euler("ZYX")
        x[self._angles] = roll, pitch, yaw + tau * round((self._yaw - yaw) / tau)
        x[self._rates] = self.turned_back(joint[_BODY_RATES])
        x[np.array(self._rotors)[self._order]] = joint[_SPEEDS]
        x[self._others] = joint[_SIZE : _SIZE + len(self._others)]
        return x

    def turned_back(self, vector: FloatArray) -> FloatArray:
        """Return the components of a vector along the body axes of the scenario's model.

        `vector` has the components of the same vector along the body axes of RotorPy's vehicle. The
        argument and the result have shape (3,).
        """
        return np.asarray(self._turn.apply(vector))

    def seen(self, x: FloatArray) -> dict[str, FloatArray]:
        """Convert declared states to the state dictionary that RotorPy's controllers take as input.

        `x` holds the states of the scenario's Pyomo model. The keys of the result are "x", "v", "q"
        (quaternion), "w" (body rates) and "rotor_speeds".
        """
        s = self.started(x, ())
        return {
            "x": s[_POSITION],
            "v": s[_VELOCITY],
            "q": s[_QUATERNION],
            "w": s[_BODY_RATES],
            "rotor_speeds": s[_SPEEDS],
        }

    def ours(self, theirs: FloatArray) -> FloatArray:
        """Reorder one value per rotor from RotorPy's order of the rotors to the declared order.

        `theirs` has the values in RotorPy's order. The declared order is that of the scenario's
        Pyomo model.
        """
        ordered = np.empty_like(theirs)
        ordered[self._order] = theirs
        return ordered

    def own(self, joint: FloatArray) -> list[float]:
        """Return the own states of the control law from a joint state (see `OutsidePlant`)."""
        return joint[_SIZE + len(self._others) : -1].tolist()

    def rates(self, t: float, joint: FloatArray, law: OutsideLaw) -> FloatArray:
        """Return the time derivative of a joint state under a control law, shape (n_joint,).

        `t` is in s. For the joint state, see `OutsidePlant`; for the law, see `OutsideLaw`.
        """
        x = self.read(joint)
        alpha, own_rates = law(t, x, self.own(joint))
        declared, power = self.dynamics.rates_and_integrand(t, x, np.asarray(alpha, dtype=float))
        s = joint[:_SIZE].copy()
        s[_WIND] = self._wind(t, x)
        # With this command the rotors have the desired acceleration, whatever their lag.
        theirs = np.asarray(alpha, dtype=float)[self._order]
        command = s[_SPEEDS] + self.parameters["tau_m"] * theirs
        # RotorPy's public step integrates with a tolerance of 1e-3 and holds the command.
        slope = self._vehicle._s_dot_fn(t, s, command)  # noqa: SLF001
        slope[_BODY_RATES] += self._vehicle.inv_inertia @ self._of_rotors(s, theirs)
        return np.array([*slope, *declared[self._others], *own_rates, power])

    def _of_rotors(self, s: FloatArray, alpha: FloatArray) -> FloatArray:
        """Return the moments on the body that RotorPy neglects, shape (3,) [N m].

        `s` is RotorPy's state vector. `alpha` has the rotor accelerations in RotorPy's order of the
        rotors [rad/s^2].
        """
        directions = self._vehicle.rotor_dir
        spin, gathering = directions @ s[_SPEEDS], directions @ alpha
        p, q, _ = s[_BODY_RATES]
        # Spinning rotors cause a gyroscopic moment, and accelerating rotors turn the body in yaw.
        turning = self._gyroscopic * spin
        return np.array([q * turning, -p * turning, self._reacting * gathering])

    def fly(
        self,
        law: OutsideLaw,
        start: FloatArray,
        own: Sequence[float],
        borders: Sequence[float],
        *,
        integrator: str,
        tolerance: float,
    ) -> Flown:
        """Simulate RotorPy's vehicle under a control law; return samples with the declared states.

        The law is smooth between the times `borders` [s], from start to end. `start` has the
        initial declared states, `own` the initial own states of the law. `integrator` is a method
        of `solve_ivp`, `tolerance` relative. Raises a SolveError if the simulation fails.
        """
        rate = self.habits.command_rate_hz
        # If commands come at a constant rate, the law is smooth between two commands.
        if rate is not None:
            borders = even_times(borders[0], borders[-1], rate).tolist()
        joint = self.started(start, own)
        times: list[float] = []
        rows, applied = [], []
        for first, last in pairwise(borders):
            inside = first + _INSIDE * (last - first)
            now = law if rate is None else self._with_constant_command(law, inside, joint)
            flown = solve_ivp(
                self._slope(now, inside, last),
                (first, last),
                joint,
                method=integrator,
                t_eval=even_times(first, last, RATE_HZ),
                rtol=tolerance,
                atol=min(tolerance, _ABSOLUTE),
                max_step=LONGEST_STEP,
            )
            if not flown.success:
                raise SolveError(f"RotorPy: {flown.message} Check the gains of the scenario.")
            joint = flown.y[:, -1]
            # Each part except the first starts at the end of the previous part.
            for t, row in list(zip(flown.t.tolist(), flown.y.T, strict=True))[bool(times) :]:
                times.append(t)
                rows.append(row)
                applied.append(now(t, self.read(row), self.own(row))[0])
        return Flown(
            t=np.array(times),
            states=np.array([self.read(row) for row in rows]),
            controls=np.array(applied),
            energy=np.array(rows)[:, -1],
        )

    def _slope(
        self, law: OutsideLaw, inside: float, last: float
    ) -> Callable[[float, FloatArray], FloatArray]:
        """Return the closed loop's right-hand side for one period in which the law is smooth.

        `inside` is just after the start of the period, `last` is its end [s]. Before `inside`, the
        value at `inside` is used. The result raises a SolveError if the vehicle tumbles.
        """
        guard = TumblingGuard("RotorPy", last - inside)

        def slope(t: float, joint: FloatArray) -> FloatArray:
            guard.evaluated(t)
            # The law may jump at the start of the period, just before `inside`. The integrator must
            # not see the jump.
            return self.rates(max(t, inside), joint, law)

        return slope

    def _with_constant_command(self, law: OutsideLaw, t: float, joint: FloatArray) -> OutsideLaw:
        """Return a law that keeps the rotor-speed commands of ``law`` constant from time t [s] on.

        The commands follow from the joint state `joint` at this time.
        """
        # Rotors of speed w follow the command c with the lag tau: they accelerate by (c - w) / tau.
        # With c = w + tau alpha, this is alpha at time t. RotorPy's own simulation also keeps
        # commands constant between two evaluations of its controller.
        x, lag = self.read(joint), self.parameters["tau_m"]
        command = x[self._rotors] + lag * np.asarray(law(t, x, self.own(joint))[0], dtype=float)

        def constant(t: float, x: FloatArray, own: Sequence[float]) -> Answer:
            own_rates = law(t, x, own)[1] if own else ()
            return ((command - x[self._rotors]) / lag).tolist(), own_rates

        return constant


_WIND_VELOCITY = ("wind.velocity_x", "wind.velocity_y", "wind.velocity_z")


def _wind_of(scenario: Scenario, dynamics: Dynamics) -> Callable[[float, FloatArray], FloatArray]:
    """Return the wind of the scenario's model, as a function of time [s] and of the states.

    The function returns the wind along world x, y and z, shape (3,) [m/s].
    """
    keys = tuple((name, None) for name in _WIND_VELOCITY if dynamics.has(name))

    def read(times: FloatArray, states: FloatArray) -> FloatArray:
        values = np.zeros((len(times), 3))
        controls = np.zeros((len(times), len(dynamics.control_names)))
        values[:, : len(keys)] = dynamics.table(keys, times, states, controls)
        return values

    if scenario.wind.varies_with_place:
        return lambda t, x: read(np.array([t]), x[None, :])[0]
    times = even_times(0.0, scenario.mission.fixed_duration, _WIND_RATE_HZ)
    still = np.zeros((len(times), len(dynamics.state_names)))
    spline = CubicSpline(times, read(times, still))
    return lambda t, _x: np.asarray(spline(t))


def refuse_pushing_wind(scenario: Scenario) -> None:
    """Raise a ScenarioError if the wind acts as an acceleration that does not depend on airspeed.

    This is so if `wind.coupling` is "acceleration". With this coupling, a wind that is read from a
    file is always refused. Zero wind that the scenario states by numbers is accepted.
    """
    wind = scenario.wind
    is_steady = bool(wind.speed or wind.vertical)
    blows = is_steady or not wind.is_formula or _blows(wind.x) or _blows(wind.y)
    # In RotorPy the wind acts only through the airspeed. As an acceleration, it acts as in eq. (9)
    # of Yacef et al., the source of this package's quadrotor model.
    if wind.coupling is WindCoupling.ACCELERATION and blows:
        raise ScenarioError(
            f"{scenario.name}: wind.coupling = acceleration has no counterpart in RotorPy, whose "
            'wind acts through drag; set wind.coupling = "drag", or calm air.'
        )


def _blows(axis: WindAxis) -> bool:
    return bool(axis.mean or any(axis.amplitudes) or axis.gust_amplitude)


def outside_name(pilot: Pilot, followed: Reference) -> str:
    """Return the name of a flight in RotorPy, such as "rotorpy/adaptive/plan".

    `followed` is the reference that the controller `pilot` follows.
    """
    return f"{PLANT}/{pilot.value}/{followed.value}"


def fly_outside(
    plant: OutsidePlant, pilot: Pilot, reference: Reference, plan: Plan | None = None
) -> Flight:
    """Simulate a mission with RotorPy's vehicle, and verify the flight by a second integrator.

    The flight begins in the initial state of `plan`, if one is given. If the integrators disagree,
    `Flight.is_verified` is False. Raises a ScenarioError if there is no plan, but `pilot` is open
    loop or `reference` is the plan. Raises a SolveError if the simulation fails.
    """
    scenario = plant.scenario
    own: Sequence[float] = ()
    borders = None
    if pilot is Pilot.OPEN_LOOP:
        if plan is None:
            raise ScenarioError(f"{scenario.name}: open loop needs a plan; solve it first.")
        law, borders = _open_loop(plan, plant)
    elif pilot is Pilot.ADAPTIVE:
        law, own = _adaptive(plant, reference, plan)
    else:
        law = se3_law(plant, reference_path(scenario, reference, plan))
    return fly_under(plant, outside_name(pilot, reference), law, plan, own=own, borders=borders)


def fly_under(
    plant: OutsidePlant,
    name: str,
    law: OutsideLaw,
    plan: Plan | None = None,
    *,
    own: Sequence[float] = (),
    borders: Sequence[float] | None = None,
) -> Flight:
    """Simulate RotorPy's vehicle under a control law, by two integrators for comparison.

    The result has the name `name`. The flight begins in the initial state of `plan`, by default in
    hover at the start. `own` has the initial own states of the law. A law without feedback is
    smooth between the times `borders` [s]; with feedback, `borders` is None. If the integrators
    disagree, `Flight.is_verified` is False. Raises a SolveError if the simulation fails.
    """
    began = perf_counter()
    scenario, dynamics, habits = plant.scenario, plant.dynamics, plant.habits
    methods: tuple[str, ...] = _STIFF if borders is None else tuple(Integrator)
    tight = _TOLERANCE if borders is None else _TIGHT
    if habits.tolerance is not None:
        methods = _EXPLICIT
    if habits.command_rate_hz is not None:
        methods, tight = _EXPLICIT, _TOLERANCE
    start = start_state(scenario, dynamics, plan)
    borders = borders or (0.0, scenario.mission.fixed_duration)
    first, second = (
        plant.fly(law, start, own, borders, integrator=method, tolerance=tolerance)
        for method, tolerance in zip(methods, (habits.tolerance or tight, tight), strict=True)
    )
    return assembled_flight(name, scenario, dynamics, ((first, second),), plan, began)


def _adaptive(
    plant: OutsidePlant, reference: Reference, plan: Plan | None
) -> tuple[OutsideLaw, list[float]]:
    path = reference_path(plant.scenario, reference, plan)
    controller = AdaptiveController(plant.scenario, mixer_matrix(plant.dynamics))
    feedback = feedback_law(controller, plant.dynamics)

    def law(t: float, x: FloatArray, own: Sequence[float]) -> Answer:
        return feedback(controller.command(path, t), x.tolist(), own)

    body = [plant.dynamics.state_names.index(name) for name in MEASURED_STATES]
    start = start_state(plant.scenario, plant.dynamics, plan)[body]
    return law, controller.started(path(0.0), start.tolist())


def se3_law(plant: OutsidePlant, path: ReferencePath, *, stiffness: float = 1.0) -> OutsideLaw:
    """Return RotorPy's geometric controller (SE3) as a control law that follows a path.

    `stiffness` multiplies the proportional position gain, and its square root the derivative gain.
    Rotor commands are clipped to the limits of the rotors.
    """
    control = rotorpy_module("controllers.quadrotor_control").SE3Control(plant.parameters)
    control.kp_pos *= stiffness
    control.kd_pos *= sqrt(stiffness)
    limits, lag = plant.scenario.limits, plant.parameters["tau_m"]
    rotors = rotor_columns(plant.dynamics)

    def law(t: float, x: FloatArray, _own: Sequence[float]) -> Answer:
        place, rate, acceleration, _ = path(t)
        flat = {
            "x": np.array(place[:3]),
            "x_dot": np.array(rate[:3]),
            "x_ddot": np.array(acceleration[:3]),
            # The controller turns RotorPy's body axes, not the declared ones.
            "yaw": place[3] + plant.turn,
            "yaw_dot": rate[3],
        }
        wanted = control.update(t, plant.seen(x), flat)["cmd_motor_speeds"]
        targets = np.clip(plant.ours(wanted), limits.rotor_speed_min, limits.rotor_speed_max)
        most = limits.rotor_acceleration_max
        return np.clip((targets - x[rotors]) / lag, -most, most).tolist(), ()

    return law


def _open_loop(plan: Plan, plant: OutsidePlant) -> tuple[OutsideLaw, list[float]]:
    """Return a plan's controls as a control law, and the times between which the law is smooth [s].

    The law returns the planned rotor accelerations [rad/s^2]. The times are the boundaries of the
    mesh elements.
    """
    held, rotors = plan.trajectories, rotor_columns(plant.dynamics)
    start, end = held.horizon
    borders = start + (end - start) * np.asarray(held.mesh.breakpoints)
    limits = plant.dynamics.control_limits(HELD_BREACH)
    pieces = [
        control_polynomial(held.mesh, held.controls, k, borders[k], borders[k + 1], limits)
        for k in range(held.mesh.elements)
    ]

    def law(t: float, x: FloatArray, _own: Sequence[float]) -> Answer:
        k = int(np.clip(np.searchsorted(borders, t, side="left") - 1, 0, len(pieces) - 1))
        alpha = pieces[k](t)
        if plant.habits.command_rate_hz is not None:
            # The simulation computes each command from the result r of the law: w + tau r, where w
            # is the rotor speed. With r = alpha + (w_plan - w) / tau, the command is w_plan + tau
            # alpha, as planned.
            planned = held.states_at(np.array([t]))[0, rotors]
            alpha = alpha + (planned - x[rotors]) / plant.parameters["tau_m"]
        return alpha.tolist(), ()

    return law, borders.tolist()
