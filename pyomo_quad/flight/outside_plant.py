"""The vehicle handed to RotorPy [1]_: dynamics that others wrote, under our controller and theirs.

here | RotorPy
mass, inertias, thrust and drag torque over rotor speed squared | mass, Ixx.., k_eta, k_m
places and spins of the rotors, read off the declared mixer | rotor_pos, rotor_directions
drag of rotors, translational lift, parasitic drag by axis | k_d, k_z, k_h, c_Dx..
quadratic drag | added to c_Dx = c_Dy = c_Dz, on body axes
linear drag | added to k_d = k_z, times four rotors at the speed of hover, at the rotors

RotorPy's rotors have no inertia: the gyroscopic moment and the reaction of the body to their
acceleration are added beside its own moments, unless they are to be left out.  Its motors follow a
command with a lag; the command is the one under which they accelerate as wanted.  Energy is the
declared power at RotorPy's rotor speeds.

.. [1] Folk, Paulos and Kumar, "RotorPy: A Python-based Multirotor Simulator with Aerodynamics for
   Education and Research", arXiv 2306.04485.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from importlib import import_module
from itertools import pairwise
from math import pi, tau
from time import perf_counter
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

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
from pyomo_quad.flight.flight import Flight, Flown
from pyomo_quad.flight.plan import Plan
from pyomo_quad.scenario import Reference, Scenario, ScenarioError
from pyomo_quad.scenario.wind import WindAxis, WindCoupling

FloatArray = NDArray[np.float64]
Law = Callable[[float, FloatArray, Sequence[float]], tuple[Sequence[float], Sequence[float]]]
"""Time, the states that the declared model names, own states -> rotor accelerations, own rates."""

PLANT = "rotorpy"
MULTIROTOR = "vehicles.multirotor"
_MISSING = "RotorPy is not installed; install it with pip install 'pyomo_quad[rotorpy]'."
# Of controlled flights, and of the plan's own controls, whose errors nothing corrects.
_TOLERANCE, _TIGHT = 1e-7, 1e-11
# The yaw reaction answers a command at once, SE3's at thousands per second: explicit steps would
# be a third of a millisecond.
_STIFF = ("Radau", Integrator.MULTISTEP.value)
# Share of a part of a flight after which the law is that of the part.
_INSIDE = 1e-9
_WIND_RATE_HZ = 1000.0
# Where RotorPy keeps them in its vector.
_POSITION, _VELOCITY, _QUATERNION = slice(0, 3), slice(3, 6), slice(6, 10)
_BODY_RATES, _WIND, _SPEEDS = slice(10, 13), slice(13, 16), slice(16, 20)
_SIZE = 20


class Pilot(StrEnum):
    """What moves the rotors of the outside plant."""

    ADAPTIVE = "adaptive"
    SE3 = "se3"
    OPEN_LOOP = "open_loop"


@dataclass(frozen=True, kw_only=True)
class BodyFrame:
    """How RotorPy's body lies in ours: turned about the vertical, with rotors numbered anew."""

    turn: float = 0.0
    """From our body x to theirs [rad]."""
    order: tuple[int, ...] = (0, 1, 2, 3)
    """Which of our rotors each of theirs is."""


ACROSS = BodyFrame(turn=-pi / 4, order=(0, 3, 2, 1))
"""That of a vehicle with two rotors ahead, numbered clockwise from the left one."""


def rotorpy_module(name: str) -> ModuleType:
    """Import a part of RotorPy.

    Raises
    ------
    ScenarioError
        If it is not installed.
    """
    try:
        return import_module(f"rotorpy.{name}")
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != PLANT:
            raise
        raise ScenarioError(_MISSING) from None


def quad_parameters(scenario: Scenario, dynamics: Dynamics) -> dict[str, Any]:
    """Return the vehicle of a scenario as RotorPy's parameters."""
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
    """RotorPy's multirotor, told in the states of the declared model.

    Its joint state is RotorPy's vector, the declared states that RotorPy has not (the charge drawn
    from the pack), those of a law, and the energy.

    Parameters
    ----------
    scenario : Scenario
    dynamics : Dynamics
        The declared vehicle: its power, its pack and the wind.
    parameters : mapping, optional
        RotorPy's own; those of the scenario's vehicle by default.
    frame : BodyFrame, optional
        Of these parameters.
    has_rotor_inertia : bool, optional
        Whether the rotors' inertia acts on the body.
    """

    def __init__(
        self,
        scenario: Scenario,
        dynamics: Dynamics,
        *,
        parameters: Mapping[str, Any] | None = None,
        frame: BodyFrame | None = None,
        has_rotor_inertia: bool = True,
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
        frame = frame or BodyFrame()
        self._vehicle = rotorpy_module(MULTIROTOR).Multirotor(
            self.parameters, control_abstraction="cmd_motor_speeds"
        )
        self._vehicle.g = scenario.gravity
        self._vehicle.weight = np.array([0.0, 0.0, -self.parameters["mass"] * scenario.gravity])
        self._turn = Rotation.from_euler("z", frame.turn)
        self._order = list(frame.order)
        self._rotor_inertia = scenario.vehicle.rotor_inertia if has_rotor_inertia else 0.0
        names = dynamics.state_names
        body = [names.index(name) for name in MEASURED_STATES]
        self._place, self._angles, self._rates = body[:6], body[6:9], body[9:12]
        self._others = [k for k in range(len(names)) if k not in {*body, *self._rotors}]
        mission = scenario.mission
        self._yaw = 0.5 * (mission.start.yaw + mission.goal.yaw)
        self._wind = _wind_of(scenario, dynamics)

    def started(self, x: FloatArray, own: Sequence[float]) -> FloatArray:
        """Return the joint state of declared states and of a law's own."""
        s = np.zeros(_SIZE)
        s[:6] = x[self._place]
        attitude = Rotation.from_euler("ZYX", x[self._angles][::-1]) * self._turn
        s[_QUATERNION] = attitude.as_quat()
        s[_BODY_RATES] = self._turn.inv().apply(x[self._rates])
        s[_SPEEDS] = x[self._rotors][self._order]
        return np.array([*s, *x[self._others], *own, 0.0])

    def read(self, joint: FloatArray) -> FloatArray:
        """Return the declared states of a joint state."""
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
        """Return a vector of RotorPy's body in ours, shape (3,)."""
        return np.asarray(self._turn.apply(vector))

    def seen(self, x: FloatArray) -> dict[str, FloatArray]:
        """Return declared states as RotorPy's controllers see them."""
        s = self.started(x, ())
        return {
            "x": s[_POSITION],
            "v": s[_VELOCITY],
            "q": s[_QUATERNION],
            "w": s[_BODY_RATES],
            "rotor_speeds": s[_SPEEDS],
        }

    def ours(self, theirs: FloatArray) -> FloatArray:
        """Return numbers of RotorPy's rotors in our order."""
        ordered = np.empty_like(theirs)
        ordered[self._order] = theirs
        return ordered

    def own(self, joint: FloatArray) -> list[float]:
        """Return the law's own states of a joint state."""
        return joint[_SIZE + len(self._others) : -1].tolist()

    def rates(self, t: float, joint: FloatArray, law: Law) -> FloatArray:
        """Return the derivative of the joint state under a law."""
        x = self.read(joint)
        alpha, own_rates = law(t, x, self.own(joint))
        declared, power = self.dynamics.rates_and_integrand(t, x, np.asarray(alpha, dtype=float))
        s = joint[:_SIZE].copy()
        s[_WIND] = self._wind(t, x)
        # Whatever the lag, under this command the rotors accelerate as wanted.
        theirs = np.asarray(alpha, dtype=float)[self._order]
        command = s[_SPEEDS] + self.parameters["tau_m"] * theirs
        # RotorPy's public step integrates with a tolerance of 1e-3 and holds the command.
        slope = self._vehicle._s_dot_fn(t, s, command)  # noqa: SLF001
        slope[_BODY_RATES] += self._vehicle.inv_inertia @ self._of_rotors(s, theirs)
        return np.array([*slope, *declared[self._others], *own_rates, power])

    def _of_rotors(self, s: FloatArray, alpha: FloatArray) -> FloatArray:
        """Return what spinning rotors do to the body: minus the rate of their momentum [N m]."""
        directions = self._vehicle.rotor_dir
        spin, gathering = directions @ s[_SPEEDS], directions @ alpha
        p, q, _ = s[_BODY_RATES]
        return self._rotor_inertia * np.array([q * spin, -p * spin, gathering])

    def fly(
        self,
        law: Law,
        start: FloatArray,
        own: Sequence[float],
        borders: Sequence[float],
        *,
        integrator: str,
        tolerance: float,
    ) -> Flown:
        """Fly under a law, which is smooth between borders [s].

        Raises
        ------
        SolveError
            If the vehicle tumbles or the integration breaks down.
        """
        guard = TumblingGuard("RotorPy", borders[-1] - borders[0])
        inside = borders[0]

        def rates(t: float, joint: FloatArray) -> FloatArray:
            guard.evaluated(t)
            return self.rates(max(t, inside), joint, law)

        joint = self.started(start, own)
        times, rows = [np.array(borders[:1])], [joint[None, :]]
        for first, last in pairwise(borders):
            part = even_times(first, last, RATE_HZ)
            inside = first + _INSIDE * (last - first)
            flown = solve_ivp(
                rates,
                (first, last),
                joint,
                method=integrator,
                t_eval=part[1:],
                rtol=tolerance,
                atol=tolerance,
                max_step=LONGEST_STEP,
            )
            if not flown.success:
                raise SolveError(f"RotorPy: {flown.message} Check the gains of the scenario.")
            joint = flown.y[:, -1]
            times.append(part[1:])
            rows.append(flown.y.T)
        t, joints = np.concatenate(times), np.vstack(rows)
        states = np.array([self.read(row) for row in joints])
        applied = [
            law(time, x, self.own(row))[0]
            for time, x, row in zip(t.tolist(), states, joints, strict=True)
        ]
        return Flown(t=t, states=states, controls=np.array(applied), energy=joints[:, -1])


_WIND_VELOCITY = ("wind.velocity_x", "wind.velocity_y", "wind.velocity_z")


def _wind_of(scenario: Scenario, dynamics: Dynamics) -> Callable[[float, FloatArray], FloatArray]:
    """Return the declared wind, shape (3,), over time and the declared states."""
    keys = tuple((name, None) for name in _WIND_VELOCITY if dynamics.has(name))

    def read(times: FloatArray, states: FloatArray) -> FloatArray:
        values = np.zeros((len(times), 3))
        controls = np.zeros((len(times), len(dynamics.control_names)))
        values[:, : len(keys)] = dynamics.table(keys, times, states, controls)
        return values

    if scenario.wind.varies_with_height:
        return lambda t, x: read(np.array([t]), x[None, :])[0]
    times = even_times(0.0, scenario.mission.fixed_duration, _WIND_RATE_HZ)
    still = np.zeros((len(times), len(dynamics.state_names)))
    spline = CubicSpline(times, read(times, still))
    return lambda t, _x: np.asarray(spline(t))


def refuse_pushing_wind(scenario: Scenario) -> None:
    """Refuse a wind that pushes without drag; RotorPy's acts on the airspeed."""
    wind = scenario.wind
    measured = wind.series is not None
    blows = wind.speed or wind.vertical or measured or _blows(wind.x) or _blows(wind.y)
    if wind.coupling is WindCoupling.ACCELERATION and blows:
        raise ScenarioError(
            f"{scenario.name}: wind.coupling = acceleration has no counterpart in RotorPy, whose "
            'wind acts through drag; set wind.coupling = "drag", or calm air.'
        )


def _blows(axis: WindAxis) -> bool:
    return bool(axis.mean or any(axis.amplitudes) or axis.gust_amplitude)


def outside_name(pilot: Pilot, followed: Reference) -> str:
    """Return the name of a flight of the outside plant."""
    return f"{PLANT}/{pilot.value}/{followed.value}"


def fly_outside(
    plant: OutsidePlant, pilot: Pilot, reference: Reference, plan: Plan | None = None
) -> Flight:
    """Fly RotorPy's vehicle along a reference, or under the plan's own controls.

    It is verified as every controlled flight is, by a second integrator.

    Raises
    ------
    ScenarioError
        If the plan is needed and there is none.
    SolveError
        If the flight is out of control.
    """
    began = perf_counter()
    scenario, dynamics = plant.scenario, plant.dynamics
    start = start_state(scenario, dynamics, plan)
    borders: Sequence[float] = (0.0, scenario.mission.fixed_duration)
    own: Sequence[float] = ()
    match pilot:
        case Pilot.ADAPTIVE:
            law, own = _adaptive(plant, reference, plan, start)
        case Pilot.SE3:
            law = _se3(plant, reference, plan)
        case Pilot.OPEN_LOOP:
            if plan is None:
                raise ScenarioError(f"{scenario.name}: open loop needs a plan; solve it first.")
            law, borders = _open_loop(plan)
    is_alone = pilot is Pilot.OPEN_LOOP
    tolerance = _TIGHT if is_alone else _TOLERANCE
    first, second = (
        plant.fly(law, start, own, borders, integrator=method, tolerance=tolerance)
        for method in (Integrator if is_alone else _STIFF)
    )
    name = outside_name(pilot, reference)
    return assembled_flight(name, scenario, dynamics, (first, second), plan, began)


def _adaptive(
    plant: OutsidePlant, reference: Reference, plan: Plan | None, start: FloatArray
) -> tuple[Law, list[float]]:
    path = reference_path(plant.scenario, reference, plan)
    controller = AdaptiveController(plant.scenario, mixer_matrix(plant.dynamics))
    feedback = feedback_law(controller, plant.dynamics)

    def law(
        t: float, x: FloatArray, own: Sequence[float]
    ) -> tuple[Sequence[float], Sequence[float]]:
        return feedback(controller.command(path, t), x.tolist(), own)

    body = [plant.dynamics.state_names.index(name) for name in MEASURED_STATES]
    return law, controller.started(path(0.0), start[body].tolist())


def _se3(plant: OutsidePlant, reference: Reference, plan: Plan | None) -> Law:
    """Return RotorPy's own controller; its commands reach the rotors within their limits."""
    path = reference_path(plant.scenario, reference, plan)
    control = rotorpy_module("controllers.quadrotor_control").SE3Control(plant.parameters)
    limits, lag = plant.scenario.limits, plant.parameters["tau_m"]
    rotors = rotor_columns(plant.dynamics)

    def law(
        t: float, x: FloatArray, _own: Sequence[float]
    ) -> tuple[Sequence[float], Sequence[float]]:
        place, rate, acceleration = path(t)
        flat = {
            "x": np.array(place[:3]),
            "x_dot": np.array(rate[:3]),
            "x_ddot": np.array(acceleration[:3]),
            "yaw": place[3],
            "yaw_dot": rate[3],
        }
        wanted = control.update(t, plant.seen(x), flat)["cmd_motor_speeds"]
        targets = np.clip(plant.ours(wanted), limits.rotor_speed_min, limits.rotor_speed_max)
        most = limits.rotor_acceleration_max
        return np.clip((targets - x[rotors]) / lag, -most, most).tolist(), ()

    return law


def _open_loop(plan: Plan) -> tuple[Law, list[float]]:
    """Return the plan's own controls and the borders of its elements."""
    held = plan.trajectories
    start, end = held.horizon
    borders = start + (end - start) * np.asarray(held.mesh.breakpoints)
    pieces = [
        control_polynomial(held.mesh, held.controls, k, borders[k], borders[k + 1])
        for k in range(held.mesh.elements)
    ]

    def law(
        t: float, _x: FloatArray, _own: Sequence[float]
    ) -> tuple[Sequence[float], Sequence[float]]:
        k = int(np.clip(np.searchsorted(borders, t, side="left") - 1, 0, len(pieces) - 1))
        return pieces[k](t).tolist(), ()

    return law, borders.tolist()
