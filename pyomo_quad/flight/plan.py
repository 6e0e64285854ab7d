"""A plan: the optimal flight as the rest of the product, and its users, see it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self
from zipfile import BadZipFile

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pyomo_quad.collocation import Dynamics, Iteration, Mesh, MeshRecord, Solution, interpolate
from pyomo_quad.flight.columns import TIME, flight_frame
from pyomo_quad.flight.flight import Flight, Flown
from pyomo_quad.flight.verification import Verification
from pyomo_quad.scenario import Scenario, ScenarioError

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["Plan", "PlanStatus", "Trajectories"]

FloatArray = NDArray[np.float64]

_FORMAT = 1
_LARGEST_FILE = 256 * 1024 * 1024


class PlanStatus(StrEnum):
    """What became of a plan; only `VERIFIED` is proven by a flight."""

    VERIFIED = "verified"
    SOLVED = "solved"
    NOT_CONVERGED = "not_converged"
    INFEASIBLE = "infeasible"
    INTERRUPTED = "interrupted"


@dataclass(frozen=True, kw_only=True)
class Trajectories:
    """Named values on a mesh.

    Shapes: states (n_points + 1, n_states), controls (n_points, n_controls), energy
    (n_points + 1,), costates (n_points, n_costates), hamiltonian (n_points,).
    """

    mesh: Mesh
    horizon: tuple[float, float]
    state_names: tuple[str, ...]
    control_names: tuple[str, ...]
    costate_names: tuple[str, ...]
    states: FloatArray
    controls: FloatArray
    energy: FloatArray
    costates: FloatArray
    hamiltonian: FloatArray

    def fractions(self, t: FloatArray) -> FloatArray:
        """Return times as fractions of the horizon, clipped to it."""
        start, end = self.horizon
        return np.clip((np.asarray(t, dtype=float) - start) / (end - start), 0.0, 1.0)

    def states_at(self, t: FloatArray) -> FloatArray:
        """Return the state polynomials at times, shape (n, n_states)."""
        return interpolate(self.mesh, self.states, self.fractions(t), with_start=True)

    def controls_at(self, t: FloatArray) -> FloatArray:
        """Return the control polynomials at times, shape (n, n_controls)."""
        return interpolate(self.mesh, self.controls, self.fractions(t), with_start=False)

    def energy_at(self, t: FloatArray) -> FloatArray:
        """Return the energy spent until times, shape (n,)."""
        held = interpolate(self.mesh, self.energy[:, None], self.fractions(t), with_start=True)
        return held[:, 0]

    @property
    def node_times(self) -> FloatArray:
        """Times of the nodes [s]."""
        start, end = self.horizon
        return start + (end - start) * self.mesh.node_fractions


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The minimum-energy flight of a scenario, or the best iterate of a solve that failed.

    Attributes
    ----------
    scenario : Scenario
    status : PlanStatus
    message : str
        How the solve ended, in one sentence.
    energy : float
        Objective by the scheme's own quadrature [J].
    hover_energy_J : float
        Energy of hovering for the same time.
    trajectories : Trajectories
    verification : Verification or None
        None where nothing was flown, because the solve failed.
    error_estimate : float
        Relative, largest over elements and states.
    history : tuple of MeshRecord
        The meshes of the refinement.
    iterations : tuple of Iteration
        Ipopt's progress on the last mesh.
    attempts : tuple of str
        What was tried, in order, when the first solve was not enough.
    timings : mapping
        Seconds for build, compile, solve and verify.
    """

    scenario: Scenario
    status: PlanStatus
    message: str
    energy: float
    hover_energy_J: float
    trajectories: Trajectories
    verification: Verification | None
    error_estimate: float
    history: tuple[MeshRecord, ...]
    iterations: tuple[Iteration, ...] = ()
    attempts: tuple[str, ...] = ()
    timings: Mapping[str, float] = field(default_factory=dict)
    solution: Solution | None = field(default=None, compare=False, repr=False)
    flown: Flown | None = field(default=None, compare=False, repr=False)
    make_dynamics: Callable[[], Dynamics] | None = field(default=None, compare=False, repr=False)

    @property
    def mesh(self) -> Mesh:
        """The last mesh."""
        return self.trajectories.mesh

    @property
    def is_verified(self) -> bool:
        """Whether a flight of the controls confirmed the plan."""
        return self.status is PlanStatus.VERIFIED

    @property
    def iteration_count(self) -> int:
        """Ipopt iterations over all meshes."""
        return sum(record.iterations for record in self.history)

    @cached_property
    def dynamics(self) -> Dynamics:
        """The declared equations that the plan was made with, ready to fly."""
        if self.make_dynamics is None:
            raise ScenarioError(
                f"{self.scenario.name}: this plan was loaded from a file and holds no equations; "
                "solve the scenario again to fly it."
            )
        return self.make_dynamics()

    def to_frame(self, rate_hz: float | None = None) -> pd.DataFrame:
        """Return the plan as a table: at the mesh's nodes, or at an even rate.

        Parameters
        ----------
        rate_hz : float, optional
            Rows per second of dense output.

        Returns
        -------
        DataFrame
            Columns of `flight.columns`.

        Raises
        ------
        ScenarioError
            If the rate is not positive, or the plan was loaded without its equations.
        """
        start, end = self.trajectories.horizon
        times = self.trajectories.node_times
        if rate_hz is not None:
            if not 0.0 < rate_hz <= 1e5:
                raise ScenarioError(f"--rate = {rate_hz:g} Hz; must be above 0 and at most 1e5.")
            times = np.linspace(start, end, max(2, round((end - start) * rate_hz) + 1))
        return self._frame(times)

    def _frame(self, times: FloatArray) -> pd.DataFrame:
        held = self.trajectories
        return flight_frame(
            self.dynamics,
            times,
            held.states_at(times),
            held.controls_at(times),
            held.energy_at(times),
        )

    def at(self, t: float) -> pd.Series:
        """Return the row of `to_frame` at one time [s].

        Raises
        ------
        ScenarioError
            If the time is outside the flight.
        """
        start, end = self.trajectories.horizon
        if not start <= t <= end:
            raise ScenarioError(f"t = {t:g} s is outside the flight, [{start:g}, {end:g}] s.")
        return self._frame(np.array([float(t)])).iloc[0]

    def flight(self, name: str = "optimal", samples: int = 1001) -> Flight:
        """Return the plan as a flight, with the verdict of its verification."""
        start, end = self.trajectories.horizon
        verification = self.verification
        return Flight(
            name=name,
            frame=self._frame(np.linspace(start, end, samples)),
            energy_J=self.energy,
            duration_s=end - start,
            terminal_miss={} if verification is None else verification.terminal_miss,
            terminal_miss_m=np.inf if verification is None else verification.terminal_miss_m,
            max_violation=np.inf if verification is None else verification.max_violation,
            worst_constraint="" if verification is None else verification.worst_constraint,
            is_verified=self.is_verified,
            wall_s=sum(self.timings.values()),
        )

    def costate_frame(self) -> pd.DataFrame:
        """Return costates and Hamiltonian at the collocation points, "time_s" first."""
        held = self.trajectories
        frame = pd.DataFrame(held.costates, columns=list(held.costate_names))
        frame.insert(0, TIME, held.node_times[1:])
        frame["hamiltonian"] = held.hamiltonian
        return frame

    def guess(self) -> pd.DataFrame:
        """Return states and controls at the nodes as a first guess for another solve."""
        held, times = self.trajectories, self.trajectories.node_times
        frame = pd.DataFrame(held.states, columns=list(held.state_names))
        for name, column in zip(held.control_names, held.controls_at(times).T, strict=True):
            frame[name] = column
        frame.insert(0, "time", times)
        return frame

    def save(self, path: str | Path) -> None:
        """Write the plan to a file that `load` reads: arrays and JSON, nothing pickled."""
        held = self.trajectories
        about = {
            "format": _FORMAT,
            "scenario": self.scenario.model_dump(mode="json"),
            "status": self.status.value,
            "message": self.message,
            "energy": self.energy,
            "hover_energy_J": self.hover_energy_J,
            "error_estimate": self.error_estimate,
            "verification": None if self.verification is None else asdict(self.verification),
            "history": [asdict(record) for record in self.history],
            "attempts": list(self.attempts),
            "timings": dict(self.timings),
            "horizon": list(held.horizon),
            "names": [list(held.state_names), list(held.control_names), list(held.costate_names)],
        }
        with Path(path).open("wb") as file:
            np.savez_compressed(
                file,
                about=np.frombuffer(json.dumps(about).encode(), dtype=np.uint8),
                breakpoints=np.asarray(held.mesh.breakpoints),
                degrees=np.asarray(held.mesh.degrees),
                states=held.states,
                controls=held.controls,
                energy=held.energy,
                costates=held.costates,
                hamiltonian=held.hamiltonian,
            )

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a plan that `save` wrote.

        Raises
        ------
        ScenarioError
            If the file is missing, too large, or not a plan of this version.
        """
        file = Path(path)
        try:
            if file.stat().st_size > _LARGEST_FILE:
                raise ScenarioError(f"{path}: is larger than {_LARGEST_FILE} bytes; not a plan.")
            with np.load(file, allow_pickle=False) as held:
                return cls._from_arrays({name: held[name] for name in held.files})
        except OSError as error:
            raise ScenarioError(f"{path}: cannot be read ({error.strerror or error}).") from None
        except (BadZipFile, KeyError, ValueError, TypeError, IndexError) as error:
            if isinstance(error, ScenarioError):
                raise
            raise ScenarioError(
                f"{path}: is not a plan written by Plan.save of this version."
            ) from None

    @classmethod
    def _from_arrays(cls, held: dict[str, NDArray[Any]]) -> Self:
        about = json.loads(held["about"].tobytes().decode())
        if about["format"] != _FORMAT:
            raise ValueError(about["format"])
        mesh = Mesh(
            breakpoints=tuple(float(b) for b in held["breakpoints"]),
            degrees=tuple(int(d) for d in held["degrees"]),
        )
        states, controls, costates = (tuple(names) for names in about["names"])
        verification = about["verification"]
        return cls(
            scenario=Scenario.model_validate(about["scenario"]),
            status=PlanStatus(about["status"]),
            message=about["message"],
            energy=about["energy"],
            hover_energy_J=about["hover_energy_J"],
            trajectories=Trajectories(
                mesh=mesh,
                horizon=tuple(about["horizon"]),
                state_names=states,
                control_names=controls,
                costate_names=costates,
                **{k: held[k] for k in ("states", "controls", "energy", "costates", "hamiltonian")},
            ),
            verification=None if verification is None else Verification(**verification),
            error_estimate=about["error_estimate"],
            history=tuple(MeshRecord(**record) for record in about["history"]),
            attempts=tuple(about["attempts"]),
            timings=about["timings"],
        )

    def with_attempts(self, attempts: tuple[str, ...]) -> Self:
        """Return the plan with the log of what was tried before it."""
        return replace(self, attempts=attempts)
