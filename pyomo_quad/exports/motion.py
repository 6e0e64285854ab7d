"""Motion of a verified plan at any time, from a plan or from its report.

Polynomials of degree 7 approximate the motion for Crazyflie swarms and for RotorPy.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import factorial
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PPoly, make_interp_spline
from scipy.spatial.transform import Rotation

from pyomo_quad.collocation import Mesh, TranscriptionError, interpolate, interpolate_rates
from pyomo_quad.flight import Plan, PlanStatus
from pyomo_quad.flight.columns import ALL_COLUMNS, TIME
from pyomo_quad.flight.flight import POSITION_STATES, VELOCITY_STATES
from pyomo_quad.flight.plan import Trajectories
from pyomo_quad.flight.proof import EXACT, TABLE, refuse_unproven
from pyomo_quad.report.tables import PLAN_NAME, SUMMARY_NAME, read_report, refuse_report
from pyomo_quad.scenario import Scenario, ScenarioError
from pyomo_quad.scenario.messages import PyomoQuadError, printable, shown

if TYPE_CHECKING:
    import pandas as pd

FloatArray = NDArray[np.float64]

ATTITUDE_STATES = ("rigid_body.phi", "rigid_body.theta", "rigid_body.psi")
RATE_STATES = ("rigid_body.p", "rigid_body.q", "rigid_body.r")

_AGAIN = "solve the scenario again"


@dataclass(frozen=True, kw_only=True)
class Motion:
    """The state polynomials of a verified plan; world axes x, y and z up, SI units.

    Attributes
    ----------
    name : str
        Name of the scenario.
    times : ndarray, shape (n_nodes,)
        Times of the mesh's nodes [s], strictly increasing.
    states : ndarray, shape (n_nodes, n_states)
    names : tuple of str
        States, as the model names them.
    degrees : tuple of int
        Degrees of the elements, in order; their sum is n_nodes - 1.
    is_paper_plan : bool
        Whether the plan was made without a risk, and so leaves nothing to the controller.
    """

    name: str
    times: FloatArray
    states: FloatArray
    names: tuple[str, ...]
    degrees: tuple[int, ...]
    is_paper_plan: bool = False

    @classmethod
    def of(cls, plan: Plan, *, is_code_allowed: bool = False) -> Self:
        """Return the motion of a verified plan after flying it again.

        Raises
        ------
        ScenarioError
            If the plan is not verified, or the flight does not confirm it.
        """
        held = plan.trajectories
        _refuse_unverified(plan.scenario.name, plan.status.value)
        refuse_unproven(
            plan.scenario,
            held,
            plan.energy,
            plan.passing_times_s,
            EXACT,
            None if plan.solution is None else plan.dynamics,
            is_code_allowed=is_code_allowed,
        )
        return cls._along(plan.scenario.name, held, is_paper_plan=plan.risk is None)

    @classmethod
    def read(cls, path: str | Path, *, is_code_allowed: bool = False) -> Self:
        """Read a plan's motion from a file of `Plan.save` or from the report folder of a run.

        What is read is flown once more; a builder that its scenario names is run where allowed.

        Raises
        ------
        ScenarioError
            If there is no plan, it is damaged or not verified, or the flight does not confirm it.
        """
        place = Path(path)
        if place.is_dir():
            return cls._of_report(place, is_code_allowed=is_code_allowed)
        return cls.of(Plan.load(place), is_code_allowed=is_code_allowed)

    @classmethod
    def _along(cls, name: str, held: Trajectories, *, is_paper_plan: bool) -> Self:
        return cls(
            name=name,
            times=held.node_times,
            states=held.states,
            names=held.state_names,
            degrees=held.mesh.degrees,
            is_paper_plan=is_paper_plan,
        )

    @classmethod
    def _of_report(cls, folder: Path, *, is_code_allowed: bool) -> Self:
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
                f"has {len(frame)} rows, not one for each of the mesh's {sum(degrees or ()) + 1} "
                "nodes, as --rate makes it",
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
            refuse_report(folder / SUMMARY_NAME, "has no mission by which to fly the plan again")
        refuse_unproven(
            scenario, held, energy, passing_times, TABLE, is_code_allowed=is_code_allowed
        )
        return cls._along(scenario.name, held, is_paper_plan=summary.get("risk") is None)

    @cached_property
    def mesh(self) -> Mesh:
        """Elements as fractions of the flight."""
        return _mesh(self.times, self.degrees)

    @property
    def duration(self) -> float:
        """Duration of the flight [s]."""
        return float(self.times[-1] - self.times[0])

    def require(self, needed: Sequence[str], reader: str) -> None:
        """Refuse a plan that lacks states which a format needs.

        Raises
        ------
        ScenarioError
            Naming the first state that is missing.
        """
        missing = next((name for name in needed if name not in self.names), None)
        if missing is not None:
            raise ScenarioError(
                f"{self.name}: the plan has no {missing}, which {reader} needs; export a plan of a "
                "model that declares it."
            )

    def values(self, t: FloatArray, names: Sequence[str]) -> FloatArray:
        """Return states at times after the start, shape (n, len(names)); clipped to the flight."""
        return interpolate(self.mesh, self._states(names), self._fractions(t), with_start=True)

    def slopes(self, t: FloatArray, names: Sequence[str]) -> FloatArray:
        """Return the states' derivatives at times after the start, shape (n, len(names))."""
        slopes = interpolate_rates(self.mesh, self._states(names), self._fractions(t))
        return slopes / self.duration

    def position(self, t: FloatArray) -> FloatArray:
        """Return positions [m], shape (n, 3)."""
        return self.values(t, POSITION_STATES)

    def velocity(self, t: FloatArray) -> FloatArray:
        """Return velocities [m/s], shape (n, 3)."""
        return self.values(t, VELOCITY_STATES)

    def acceleration(self, t: FloatArray) -> FloatArray:
        """Return accelerations [m/s^2], shape (n, 3)."""
        return self.slopes(t, VELOCITY_STATES)

    def yaw(self, t: FloatArray) -> FloatArray:
        """Return yaw angles [rad], counter-clockwise from x, never wrapped, shape (n,)."""
        return self.values(t, ATTITUDE_STATES[2:])[:, 0]

    def yaw_rate(self, t: FloatArray) -> FloatArray:
        """Return slopes of the yaw angle [rad/s], shape (n,)."""
        return self.slopes(t, ATTITUDE_STATES[2:])[:, 0]

    def quaternions(self, t: FloatArray) -> FloatArray:
        """Return unit quaternions x, y, z, w of the body in the world, shape (n, 4)."""
        roll_pitch_yaw = self.values(t, ATTITUDE_STATES)
        return np.asarray(Rotation.from_euler("ZYX", roll_pitch_yaw[:, ::-1]).as_quat())

    def samples(self, rate_hz: float) -> FloatArray:
        """Return times after the start, both ends among them, at a rate or a little above [s]."""
        count = int(np.ceil(self.duration * rate_hz * (1.0 - 1e-12)))
        return np.linspace(0.0, self.duration, max(count, 1) + 1)

    def _states(self, names: Sequence[str]) -> FloatArray:
        return self.states[:, [self.names.index(name) for name in names]]

    def _fractions(self, t: FloatArray) -> FloatArray:
        return np.clip(np.asarray(t, dtype=float) / self.duration, 0.0, 1.0)


def _mesh(times: FloatArray, degrees: tuple[int, ...]) -> Mesh:
    """Return the elements of these degrees that have their nodes at these times."""
    ends = times[np.concatenate(([0], np.cumsum(degrees)))]
    fractions = (ends - ends[0]) / (ends[-1] - ends[0])
    return Mesh(breakpoints=tuple(fractions.tolist()), degrees=degrees)


def _trajectories(frame: "pd.DataFrame", degrees: tuple[int, ...]) -> Trajectories:
    """Return the trajectories of a report's table at the nodes of a mesh.

    All of its columns stand as states and as controls: which they are, the equations know.
    """
    times = frame[TIME].to_numpy(dtype=float)
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
    if status != PlanStatus.VERIFIED:
        raise ScenarioError(
            f"{name}: status = {shown(status)}; must be verified, for nothing else is to be flown; "
            f"{_AGAIN}."
        )


DEGREE = 7
_FIRST_PIECES = 4
# Share of the flight over which the jerk at an end is a finite difference.
_END_STEP = 1e-3
_CHECKED_PER_PIECE = 16
_MOST_CHECKED = 20_001


class PolynomialTrajectory:
    """Piecewise polynomial trajectory of the flat outputs, as RotorPy reads trajectories.

    Parameters
    ----------
    durations : array, shape (n_pieces,)
        Durations of the pieces [s].
    coefficients : array, shape (n_pieces, 4, n_coefficients)
        Coefficients of x, y, z [m] and yaw [rad] as polynomials of the time since the piece
        began [s], the constant first.
    """

    def __init__(self, durations: ArrayLike, coefficients: ArrayLike) -> None:
        self.ends = np.cumsum(np.asarray(durations, dtype=float))
        self.starts = self.ends - np.asarray(durations, dtype=float)
        self.coefficients = np.asarray(coefficients, dtype=float)

    def derivative(self, t: float, order: int) -> np.ndarray:
        """Return a derivative of x, y, z and yaw; before the start and after the end it hovers."""
        inside = min(max(float(t), 0.0), float(self.ends[-1]))
        if order > 0 and inside != t:
            return np.zeros(4)
        piece = min(int(np.searchsorted(self.ends, inside)), len(self.ends) - 1)
        slopes = np.polynomial.polynomial.polyder(self.coefficients[piece], order, axis=1)
        held = np.polynomial.polynomial.polyval(inside - self.starts[piece], slopes.T)
        return np.asarray(held)

    def update(self, t: float) -> dict[str, np.ndarray | float]:
        """Return the flat outputs of one time as RotorPy's controllers read them."""
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
    """Fit equal pieces to a plan within the path error, as few as possible.

    The pieces are those of a spline of degree 7 through the plan, which has the plan's velocity,
    acceleration and jerk at both ends; all but its last derivative are continuous.

    Raises
    ------
    ScenarioError
        If so many pieces do not suffice.
    """
    motion.require((*POSITION_STATES, *VELOCITY_STATES, ATTITUDE_STATES[2]), "a polynomial")
    found = 0.0
    for pieces in _counts(most_pieces):
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
    """Return the largest deviation of pieces from a plan: position [m] and yaw [rad]."""
    t = np.linspace(
        0.0, motion.duration, min(_MOST_CHECKED, _CHECKED_PER_PIECE * len(motion.times))
    )
    ends = np.cumsum(durations)
    breaks = np.concatenate(([0.0], ends))
    held = PPoly(np.moveaxis(coefficients[:, :, ::-1], 2, 0), breaks)(np.minimum(t, ends[-1]))
    place = np.linalg.norm(held[:, :3] - motion.position(t), axis=1)
    return float(place.max()), float(np.abs(held[:, 3] - motion.yaw(t)).max())


def _counts(most: int) -> Iterator[int]:
    """Yield numbers of pieces to try, each a little above the one before."""
    pieces = _FIRST_PIECES
    while pieces < most:
        yield pieces
        pieces += max(1, pieces // 8)
    yield most


def _pieces(motion: Motion, pieces: int) -> tuple[FloatArray, FloatArray]:
    t = np.linspace(0.0, motion.duration, pieces + 1)
    outputs = np.column_stack([motion.position(t), motion.yaw(t)])
    spline = make_interp_spline(t, outputs, k=DEGREE, bc_type=_end_slopes(motion))
    # A piece is the Taylor polynomial of its start.
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
