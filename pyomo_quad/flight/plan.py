"""A plan: the optimal flight as the rest of the product, and its users, see it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pyomo_quad.flight.columns import TIME, flight_frame
from pyomo_quad.flight.flight import Flight, Flown
from pyomo_quad.flight.plan_file import PlanRecord, PlanStatus, read_plan_file, write_plan_file
from pyomo_quad.scenario import Scenario, ScenarioError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pyomo_quad.collocation import Dynamics, Iteration, Mesh, MeshRecord, Solution, WarmStart
    from pyomo_quad.flight.failure import Failure
    from pyomo_quad.flight.trajectories import Trajectories
    from pyomo_quad.flight.verification import Verification

__all__ = ["Plan", "PlanStatus"]

FloatArray = NDArray[np.float64]


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
    failure : Failure or None
        Why the solve failed, where it did.
    timings : mapping
        Seconds for build, compile, solve and verify.
    warm_start : WarmStart or None
        Where another solve can begin; kept by `save`.
    solution : Solution or None
        The engine's own result; None when the plan was loaded from a file.
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
    failure: Failure | None = None
    timings: Mapping[str, float] = field(default_factory=dict)
    warm_start: WarmStart | None = field(default=None, compare=False, repr=False)
    solution: Solution | None = field(default=None, compare=False, repr=False)
    flown: Flown | None = field(default=None, compare=False, repr=False)

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
        if self.solution is None:
            raise ScenarioError(
                f"{self.scenario.name}: this plan was loaded from a file and holds no equations; "
                "solve the scenario again to fly it."
            )
        return self.solution.dynamics

    def owed_energy(self, final: Mapping[str, float]) -> float:
        """Return what a flight of the mission still owes that ended in another state [J].

        The costate is what the least energy would fall by if the end lay further on, so its
        product with the distance from the planned end prices the rest to first order.  Where the
        least energy is convex in the end state the true price is not larger: with it added no
        flight lies below the optimum, and hence none below its bound.

        Parameters
        ----------
        final : mapping
            State name -> final value; a state that the plan does not have owes nothing.
        """
        held = self.trajectories
        planned = dict(zip(held.state_names, held.states[-1].tolist(), strict=True))
        prices = zip(held.costate_names, held.costates[-1].tolist(), strict=True)
        return sum(price * (final[name] - planned[name]) for name, price in prices if name in final)

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
            owed_energy_J=0.0,  # its energy is that of the planned end, which is the one wanted
            broken_limits=() if verification is None else verification.broken_limits,
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
        write_plan_file(
            Path(path),
            self.scenario,
            PlanRecord(
                status=self.status,
                message=self.message,
                energy=self.energy,
                hover_energy_J=self.hover_energy_J,
                error_estimate=self.error_estimate,
                verification=self.verification,
                history=self.history,
                attempts=self.attempts,
                timings=dict(self.timings),
            ),
            self.trajectories,
            self.warm_start,
        )

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a plan that `save` wrote; it holds no equations, and so cannot be flown again.

        Another solve can start from it as from the plan that was saved.

        Raises
        ------
        ScenarioError
            If the file is missing, too large, or not a plan of this version; the line names what
            is wrong with it.
        """
        scenario, record, trajectories, warm_start = read_plan_file(Path(path))
        values = {name: getattr(record, name) for name in PlanRecord.model_fields}
        return cls(scenario=scenario, **values, trajectories=trajectories, warm_start=warm_start)
