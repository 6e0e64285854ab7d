"""Motion of a verified plan as a function of time, read from a plan or from its report.

For Crazyflie swarms and for RotorPy the motion is approximated by polynomials of degree 7.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import factorial
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PPoly, make_interp_spline
from scipy.spatial.transform import Rotation

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import Mesh, TranscriptionError, interpolate, interpolate_rates
from pyomo_quad.flight import Plan
from pyomo_quad.flight.columns import ALL_COLUMNS, TIME
from pyomo_quad.flight.flight import POSITION_STATES, VELOCITY_STATES
from pyomo_quad.flight.plan import FLYABLE, Trajectories
from pyomo_quad.flight.proof import TABLE, refuse_unproven
from pyomo_quad.report.tables import PLAN_NAME, SUMMARY_NAME, read_report, refuse_report
from pyomo_quad.scenario import Scenario, ScenarioError
from pyomo_quad.scenario.messages import PyomoQuadError, printable, shown

if TYPE_CHECKING:
    import pandas as pd


ATTITUDE_STATES = ("rigid_body.phi", "rigid_body.theta", "rigid_body.psi")
RATE_STATES = ("rigid_body.p", "rigid_body.q", "rigid_body.r")

# Next step that error messages propose.
_AGAIN = "solve the scenario again"


@dataclass(frozen=True, kw_only=True)
class ProvenPlan:
    """Plan that a new simulation of its controls has confirmed, with its mission.

    Attributes
    ----------
    mission : Scenario
        The mission, with the plan's duration and passing times of waypoints.
    trajectories : Trajectories
        States and controls. A report does not tell them apart. For a plan from a report, each
        column is therefore listed as a state and again as a control.
    is_paper_plan : bool
        Whether the plan has no margins from its limits, because the scenario does not state
        `mission.risk`. A controller that corrects disturbances may then break a limit.
    """

    mission: Scenario
    trajectories: Trajectories
    is_paper_plan: bool = True


def read_proven(path: str | Path, *, is_code_allowed: bool = False) -> ProvenPlan:
    """Read a saved plan or a report folder, and verify the plan again by simulation.

    `is_code_allowed` permits running the Python model builder of the scenario. A ScenarioError is
    raised if the plan is missing or damaged, or if the new simulation does not confirm it. It is
    also raised if the saved status is neither `PlanStatus.VERIFIED` nor `PlanStatus.USABLE`.
    """
    place = Path(path)
    if place.is_dir():
        return _proven_report(place, is_code_allowed=is_code_allowed)
    return _proven(Plan.load(place), is_code_allowed=is_code_allowed)


def _proven(plan: Plan, *, is_code_allowed: bool) -> ProvenPlan:
    held = plan.trajectories
    _refuse_unverified(plan.scenario.name, plan.status.value)
    refuse_unproven(
        plan.scenario,
        held,
        plan.energy,
        plan.passing_times_s,
        plan.figures_checked,
        None if plan.solution is None else plan.dynamics,
        is_code_allowed=is_code_allowed,
    )
    return ProvenPlan(
        mission=plan.mission_flown, trajectories=held, is_paper_plan=plan.risk is None
    )


def _proven_report(folder: Path, *, is_code_allowed: bool) -> ProvenPlan:
    summary, frame = read_report(folder)
    name, status, degrees = (summary.get(key) for key in ("scenario", "status", "mesh"))
    degrees = degrees.get("degrees") if isinstance(degrees, dict) else None
    is_whole = isinstance(degrees, list) and all(type(degree) is int for degree in degrees)
    if not isinstance(name, str) or not isinstance(status, str) or not is_whole:
        refuse_report(folder / SUMMARY_NAME, "is not the summary of a solve")
    _refuse_unverified(printable(name), printable(status))
    if len(frame) != sum(degrees or ()) + 1:
        refuse_report(
            folder / PLAN_NAME,
            f"has {len(frame)} rows instead of one for each of the mesh's {sum(degrees or ()) + 1} "
            "nodes, as after a solve with --rate",
        )
    try:
        held = _trajectories(frame, tuple(degrees or ()))
    except TranscriptionError as error:
        refuse_report(folder, f"holds no mesh ({str(error).rstrip('.')})")
    try:
        scenario = Scenario.model_validate(summary["scenario_resolved"])
        energy, passed = float(summary["energy_J"]), summary["passing_times_s"]
        passing_times = tuple(float(time) for time in passed)
    except (PyomoQuadError, KeyError, TypeError, ValueError):
        refuse_report(folder / SUMMARY_NAME, "has no mission with which to fly the plan again")
    refuse_unproven(scenario, held, energy, passing_times, TABLE, is_code_allowed=is_code_allowed)
    return ProvenPlan(
        mission=scenario.lasting(held.horizon[1], passing_times),
        trajectories=held,
        is_paper_plan=summary.get("risk") is None,
    )


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Motion of a verified plan: polynomials of the states over time, in world axes with z up.

    Attributes
    ----------
    name : str
        Name of the scenario.
    mission : Scenario
        The mission, with the plan's duration and passing times of waypoints.
    times : ndarray, shape (n_nodes,)
        Times of the mesh's nodes [s], strictly increasing.
    states : ndarray, shape (n_nodes, n_states)
        States at the nodes, SI units.
    names : tuple of str
        Names of the states in the model.
    degrees : tuple of int
        Polynomial degree of each element, in order; their sum is n_nodes - 1.
    is_paper_plan : bool
        Whether the plan has no margins from its limits; see `ProvenPlan`.
    """

    name: str
    mission: Scenario
    times: FloatArray
    states: FloatArray
    names: tuple[str, ...]
    degrees: tuple[int, ...]
    is_paper_plan: bool = False

    @classmethod
    def of(cls, plan: Plan, *, is_code_allowed: bool = False) -> Self:
        """Verify a plan again by simulation, and return its motion.

        Parameters
        ----------
        plan : Plan
            The plan.
        is_code_allowed : bool, optional
            Whether to run the Python model builder that the scenario names, if it names one.

        Raises
        ------
        ScenarioError
            If the status of `plan` is neither `PlanStatus.VERIFIED` nor `PlanStatus.USABLE`, or if
            the new simulation does not confirm `plan`.
        """
        return cls._along(_proven(plan, is_code_allowed=is_code_allowed))

    @classmethod
    def read(cls, path: str | Path, *, is_code_allowed: bool = False) -> Self:
        """Read a saved plan or a report folder, verify the plan again, and return its motion.

        Parameters
        ----------
        path : str or Path
            File of a saved plan, or report folder of a run.
        is_code_allowed : bool, optional
            Whether to run the Python model builder that the scenario names, if it names one.

        Raises
        ------
        ScenarioError
            If there is no plan, if it is damaged, or if the new simulation does not confirm it.
            Also if the stored status is neither `PlanStatus.VERIFIED` nor `PlanStatus.USABLE`.
        """
        return cls._along(read_proven(path, is_code_allowed=is_code_allowed))

    @classmethod
    def _along(cls, plan: ProvenPlan) -> Self:
        held = plan.trajectories
        return cls(
            name=plan.mission.name,
            mission=plan.mission,
            times=held.node_times,
            states=held.states,
            names=held.state_names,
            degrees=held.mesh.degrees,
            is_paper_plan=plan.is_paper_plan,
        )

    @cached_property
    def mesh(self) -> Mesh:
        """Mesh of the plan, with element boundaries as fractions of the flight's duration."""
        return _mesh(self.times, self.degrees)

    @property
    def duration(self) -> float:
        """Duration of the flight [s]."""
        return float(self.times[-1] - self.times[0])

    def require(self, needed: Sequence[str], reader: str) -> None:
        """Check that the plan has all states that an export format needs.

        Parameters
        ----------
        needed : sequence of str
            Names of the states.
        reader : str
            Name of the format, for the error message.

        Raises
        ------
        ScenarioError
            If a state is missing; the message names the first missing state.
        """
        missing = next((name for name in needed if name not in self.names), None)
        if missing is not None:
            raise ScenarioError(
                f"{self.name}: the plan has no {missing}, which {reader} needs; export a plan of a "
                "model that declares it."
            )

    def values(self, t: FloatArray, names: Sequence[str]) -> FloatArray:
        """Evaluate states at given times.

        Parameters
        ----------
        t : ndarray, shape (n,)
            Times since the start [s]. Outside the flight, the values at its start or end are
            returned.
        names : sequence of str
            Names of the states.

        Returns
        -------
        ndarray, shape (n, len(names))
            States, SI units.
        """
        return interpolate(self.mesh, self._states(names), self._fractions(t), with_start=True)

    def slopes(self, t: FloatArray, names: Sequence[str]) -> FloatArray:
        """Evaluate the time derivatives of states at given times.

        Parameters
        ----------
        t : ndarray, shape (n,)
            Times since the start [s]. Outside the flight, the derivatives at its start or end are
            returned.
        names : sequence of str
            Names of the states.

        Returns
        -------
        ndarray, shape (n, len(names))
            Derivatives, SI units per second.
        """
        slopes = interpolate_rates(self.mesh, self._states(names), self._fractions(t))
        return slopes / self.duration

    def position(self, t: FloatArray) -> FloatArray:
        """Return the positions x, y, z [m] at times t [s] after the start, shape (n, 3)."""
        return self.values(t, POSITION_STATES)

    def velocity(self, t: FloatArray) -> FloatArray:
        """Return the velocities along x, y, z [m/s] at times t [s], shape (n, 3)."""
        return self.values(t, VELOCITY_STATES)

    def acceleration(self, t: FloatArray) -> FloatArray:
        """Return the accelerations along x, y, z [m/s²] at times t [s], shape (n, 3)."""
        return self.slopes(t, VELOCITY_STATES)

    def yaw(self, t: FloatArray) -> FloatArray:
        """Return the yaw angles [rad] at times t [s] after the start, shape (n,).

        The angles count counter-clockwise from x and are not wrapped to one turn.
        """
        return self.values(t, ATTITUDE_STATES[2:])[:, 0]

    def yaw_rate(self, t: FloatArray) -> FloatArray:
        """Return the time derivative of the yaw angle [rad/s] at times t [s], shape (n,)."""
        return self.slopes(t, ATTITUDE_STATES[2:])[:, 0]

    def quaternions(self, t: FloatArray) -> FloatArray:
        """Return the body's attitudes at times t [s] after the start, as unit quaternions (n, 4).

        The components are x, y, z, w. A quaternion rotates vectors from body axes to world axes.
        """
        roll_pitch_yaw = self.values(t, ATTITUDE_STATES)
        return np.asarray(Rotation.from_euler("ZYX", roll_pitch_yaw[:, ::-1]).as_quat())

    def samples(self, rate_hz: float) -> FloatArray:
        """Return n equally spaced times from start to end of the flight [s], shape (n,).

        Parameters
        ----------
        rate_hz : float
            Least number of times per second. The flight is divided into a whole number of
            intervals.
        """
        count = int(np.ceil(self.duration * rate_hz * (1.0 - 1e-12)))
        return np.linspace(0.0, self.duration, max(count, 1) + 1)

    def _states(self, names: Sequence[str]) -> FloatArray:
        return self.states[:, [self.names.index(name) for name in names]]

    def _fractions(self, t: FloatArray) -> FloatArray:
        return np.clip(np.asarray(t, dtype=float) / self.duration, 0.0, 1.0)


def _mesh(times: FloatArray, degrees: tuple[int, ...]) -> Mesh:
    """Return the mesh with elements of the given degrees and nodes at the given times [s].

    `times` has shape (n_nodes,); the sum of the degrees is n_nodes - 1.
    """
    ends = times[np.concatenate(([0], np.cumsum(degrees)))]
    fractions = (ends - ends[0]) / (ends[-1] - ends[0])
    return Mesh(breakpoints=tuple(fractions.tolist()), degrees=degrees)


def _trajectories(frame: "pd.DataFrame", degrees: tuple[int, ...]) -> Trajectories:
    """Convert the trajectory table of a report to trajectories at the nodes of a mesh.

    The table has one row per node. `degrees` are those of the mesh elements. The result lists every
    quantity as a state and a control; energy and Hamiltonian are zero.
    """
    times = frame[TIME].to_numpy(dtype=float)
    # The table does not say which quantities are states and which are controls. The equations of
    # motion select the quantities that they need.
    columns = [c for c in ALL_COLUMNS if c.name in frame]
    names = tuple(c.variable for c in columns)
    values = frame[[c.name for c in columns]].to_numpy(dtype=float)
    points = len(times) - 1
    return Trajectories(
        mesh=_mesh(times, degrees),
        horizon=(float(times[0]), float(times[-1])),
        state_names=names,
        control_names=names,
        costate_names=(),
        states=values,
        controls=values[1:],
        energy=np.zeros(points + 1),
        costates=np.zeros((points, 0)),
        hamiltonian=np.zeros(points),
    )


def _refuse_unverified(name: str, status: str) -> None:
    if status not in FLYABLE:
        raise ScenarioError(
            f"{name}: status = {shown(status)}; must be verified or usable, as other plans are not "
            f"safe to fly; {_AGAIN}."
        )


#: Degree of the polynomial pieces. Seven is the degree of a Crazyflie's trajectory memory.
DEGREE = 7
_FIRST_PIECES = 4  # number of pieces that the fit tries first
# Step of the finite difference for the jerk at start and end, as a fraction of the duration.
_END_STEP = 1e-3
_CHECKED_PER_PIECE = 16
_MOST_CHECKED = 20_001


class PolynomialTrajectory:
    """Piecewise polynomial trajectory of position and yaw, for use in the simulator RotorPy.

    RotorPy calls the method `update` of a trajectory to get the motion at a time.

    Parameters
    ----------
    durations : array, shape (n_pieces,)
        Durations of the pieces [s].
    coefficients : array, shape (n_pieces, 4, n_coefficients)
        Coefficients of x, y, z [m] and yaw [rad], the constant first. Polynomials of the time since
        the start of the piece [s].
    """

    def __init__(self, durations: ArrayLike, coefficients: ArrayLike) -> None:
        self.ends = np.cumsum(np.asarray(durations, dtype=float))
        self.starts = self.ends - np.asarray(durations, dtype=float)
        self.coefficients = np.asarray(coefficients, dtype=float)

    def derivative(self, t: float, order: int) -> np.ndarray:
        """Return a time derivative of x, y, z and yaw, shape (4,).

        Before the start and after the end of the trajectory, position and yaw are constant.

        Parameters
        ----------
        t : float
            Time since the start [s].
        order : int
            Order of the derivative; 0 for the values themselves.
        """
        inside = min(max(float(t), 0.0), float(self.ends[-1]))
        if order > 0 and inside != t:
            return np.zeros(4)
        piece = min(int(np.searchsorted(self.ends, inside)), len(self.ends) - 1)
        slopes = np.polynomial.polynomial.polyder(self.coefficients[piece], order, axis=1)
        held = np.polynomial.polynomial.polyval(inside - self.starts[piece], slopes.T)
        return np.asarray(held)

    def update(self, t: float) -> dict[str, np.ndarray | float]:
        """Return position and yaw with their time derivatives at the time t [s] after the start.

        RotorPy calls this method of a trajectory. The result has RotorPy's keys: "x" to "x_ddddot"
        for position to snap, shape (3,), and "yaw" to "yaw_ddot".
        """
        place, speed, acceleration, jerk, snap = (self.derivative(t, k) for k in range(5))
        return {
            "x": place[:3],
            "x_dot": speed[:3],
            "x_ddot": acceleration[:3],
            "x_dddot": jerk[:3],
            "x_ddddot": snap[:3],
            "yaw": float(place[3]),
            "yaw_dot": float(speed[3]),
            "yaw_ddot": float(acceleration[3]),
        }


def fit_pieces(
    motion: Motion, path_error_m: float, most_pieces: int
) -> tuple[FloatArray, FloatArray]:
    """Approximate a plan by polynomial pieces of equal duration: durations [s] and coefficients.

    For the two arrays, see `PolynomialTrajectory`. The number `path_error_m` limits both deviations
    from the plan: that of the position in m, and that of the yaw in rad. A ScenarioError is raised
    if the plan has no position, velocity or yaw, or if `most_pieces` pieces do not suffice.
    """
    motion.require((*POSITION_STATES, *VELOCITY_STATES, ATTITUDE_STATES[2]), "a polynomial")
    found = 0.0
    for pieces in _counts(most_pieces):
        # The spline has degree 7 and continuous derivatives up to the sixth. At both ends, it has
        # the plan's velocity, acceleration, jerk, yaw rate and yaw acceleration. The third
        # derivative of the yaw is zero there instead of the plan's.
        durations, coefficients = _pieces(motion, pieces)
        found, yaw = piece_deviation(motion, durations, coefficients)
        if max(found, yaw) <= path_error_m:
            return durations, coefficients
    raise ScenarioError(
        f"{motion.name}: {most_pieces} pieces of degree {DEGREE}, the most that the format holds, "
        f"come within {found:.2g} m of the plan and not within {path_error_m:g} m; give a larger "
        "--path-error."
    )


def piece_deviation(
    motion: Motion, durations: FloatArray, coefficients: FloatArray
) -> tuple[float, float]:
    """Return the largest deviation of polynomial pieces from a plan: position [m] and yaw [rad].

    Polynomials and plan are compared at the same times. For `durations` and `coefficients`, see
    `PolynomialTrajectory`.
    """
    t = np.linspace(
        0.0, motion.duration, min(_MOST_CHECKED, _CHECKED_PER_PIECE * len(motion.times))
    )
    ends = np.cumsum(durations)
    breaks = np.concatenate(([0.0], ends))
    held = PPoly(np.moveaxis(coefficients[:, :, ::-1], 2, 0), breaks)(np.minimum(t, ends[-1]))
    place = np.linalg.norm(held[:, :3] - motion.position(t), axis=1)
    return float(place.max()), float(np.abs(held[:, 3] - motion.yaw(t)).max())


def _counts(most: int) -> Iterator[int]:
    """Yield the numbers of polynomial pieces that a fit tries, ascending up to `most`."""
    pieces = _FIRST_PIECES
    while pieces < most:
        yield pieces
        pieces += max(1, pieces // 8)
    yield most


def _pieces(motion: Motion, pieces: int) -> tuple[FloatArray, FloatArray]:
    t = np.linspace(0.0, motion.duration, pieces + 1)
    outputs = np.column_stack([motion.position(t), motion.yaw(t)])
    spline = make_interp_spline(t, outputs, k=DEGREE, bc_type=_end_slopes(motion))
    # The coefficients of each piece are those of its Taylor polynomial about its start.
    held = [spline(t[:-1], order) / factorial(order) for order in range(DEGREE + 1)]
    return np.diff(t), np.stack(held, axis=2)


def _end_slopes(motion: Motion) -> tuple[list[tuple[int, FloatArray]], ...]:
    step = _END_STEP * motion.duration

    def slopes(t: float, inside: float) -> list[tuple[int, FloatArray]]:
        at = np.array([t, t + inside])
        speed = np.column_stack([motion.velocity(at), motion.yaw_rate(at)])
        acceleration = np.column_stack([motion.acceleration(at), np.gradient(speed[:, 3], at)])
        jerk = np.append((acceleration[1, :3] - acceleration[0, :3]) / inside, 0.0)
        return [(1, speed[0]), (2, acceleration[0]), (3, jerk)]

    return slopes(0.0, step), slopes(motion.duration, -step)
