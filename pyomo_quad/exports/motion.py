"""What a plan says of the vehicle's motion, at any time: read from a plan or from its report."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pyomo_quad.collocation import Mesh, TranscriptionError, interpolate, interpolate_rates
from pyomo_quad.flight import COLUMNS, Plan, PlanStatus
from pyomo_quad.flight.flight import POSITION_STATES, TIME, VELOCITY_STATES
from pyomo_quad.report.tables import PLAN_NAME, SUMMARY_NAME, read_report, refuse_report
from pyomo_quad.scenario import ScenarioError
from pyomo_quad.scenario.messages import printable, shown

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
        Of the scenario.
    times : ndarray, shape (n_nodes,)
        Times of the mesh's nodes [s], strictly increasing.
    states : ndarray, shape (n_nodes, n_states)
    names : tuple of str
        States, as the model names them.
    degrees : tuple of int
        Of the elements, in order; their sum is n_nodes - 1.
    """

    name: str
    times: FloatArray
    states: FloatArray
    names: tuple[str, ...]
    degrees: tuple[int, ...]

    @classmethod
    def of(cls, plan: Plan) -> Self:
        """Return the motion of a verified plan.

        Raises
        ------
        ScenarioError
            If the plan is not verified.
        """
        held = plan.trajectories
        _refuse_unverified(plan.scenario.name, plan.status.value)
        return cls(
            name=plan.scenario.name,
            times=held.node_times,
            states=held.states,
            names=held.state_names,
            degrees=held.mesh.degrees,
        )

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read the motion of a file of `Plan.save`, or of the report folder of a run.

        Raises
        ------
        ScenarioError
            If there is no plan, it is damaged, or it is not verified.
        """
        place = Path(path)
        return cls._of_report(place) if place.is_dir() else cls.of(Plan.load(place))

    @classmethod
    def _of_report(cls, folder: Path) -> Self:
        summary, frame = read_report(folder)
        name, status, degrees = (summary.get(key) for key in ("scenario", "status", "mesh"))
        degrees = degrees.get("degrees") if isinstance(degrees, dict) else None
        is_whole = isinstance(degrees, list) and all(type(degree) is int for degree in degrees)
        if not isinstance(name, str) or not isinstance(status, str) or not is_whole:
            refuse_report(folder / SUMMARY_NAME, "is not the summary of a solve")
        _refuse_unverified(printable(name), printable(status))
        shown_states = [c for c in COLUMNS if c.index is None and c.name in frame]
        states = frame[[column.name for column in shown_states]].to_numpy(dtype=float)
        times = frame[TIME].to_numpy(dtype=float)
        if len(times) != sum(degrees or ()) + 1:
            refuse_report(
                folder / PLAN_NAME,
                f"has {len(times)} rows, not one for each of the mesh's {sum(degrees or ()) + 1} "
                "nodes, as --rate makes it",
            )
        motion = cls(
            name=printable(name),
            times=times,
            states=states,
            names=tuple(column.component for column in shown_states),
            degrees=tuple(degrees or ()),
        )
        try:
            _ = motion.mesh
        except TranscriptionError as error:
            refuse_report(folder, f"holds no mesh ({str(error).rstrip('.')})")
        return motion

    @cached_property
    def mesh(self) -> Mesh:
        """Elements as fractions of the flight."""
        ends = self.times[np.concatenate(([0], np.cumsum(self.degrees)))]
        fractions = (ends - ends[0]) / self.duration
        return Mesh(breakpoints=tuple(fractions.tolist()), degrees=self.degrees)

    @property
    def duration(self) -> float:
        """Of the flight [s]."""
        return float(self.times[-1] - self.times[0])

    def require(self, needed: Sequence[str], reader: str) -> None:
        """Refuse a plan that lacks states which a format cannot do without.

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
        """Return places [m], shape (n, 3)."""
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


def _refuse_unverified(name: str, status: str) -> None:
    if status != PlanStatus.VERIFIED:
        raise ScenarioError(
            f"{name}: status = {shown(status)}; must be verified, for nothing else is to be flown; "
            f"{_AGAIN}."
        )
