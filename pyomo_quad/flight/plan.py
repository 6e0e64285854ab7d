"""Plan of a scenario (its flight of least energy), and the file that stores the plan."""

from __future__ import annotations

from collections.abc import Mapping  # noqa: TC003  read by pydantic
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, BinaryIO, Final, Literal, NoReturn, Self, overload
from zipfile import ZipFile

import numpy as np
from pydantic import AllowInfNan, ConfigDict, ValidationError

from pyomo_quad.collocation import (
    Mesh,
    MeshRecord,
    Summarised,
    TranscriptionError,
    WarmStart,
    interpolate,
    real_array,
    split_algebraics,
)
from pyomo_quad.flight.columns import TIME, dataset_of, flight_columns, flight_frame
from pyomo_quad.flight.flight import HELD_BREACH, Flight, Flown
from pyomo_quad.flight.margins import PAPER_PLAN, RiskTaken
from pyomo_quad.flight.orders import OrderSearch  # noqa: TC001  read by pydantic
from pyomo_quad.flight.routes import TriedRoute  # noqa: TC001  read by pydantic
from pyomo_quad.flight.verification import Passage, Verification
from pyomo_quad.presentation import presenter
from pyomo_quad.scenario import Scenario, ScenarioError
from pyomo_quad.scenario.accuracy import FIGURES, USABLE, Accuracy, Figures
from pyomo_quad.scenario.fields import Part
from pyomo_quad.scenario.messages import PyomoQuadError, complaints, printable

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd
    import xarray as xr
    from numpy.typing import NDArray

    from pyomo_quad.arrays import FloatArray
    from pyomo_quad.collocation import Dynamics, Iteration, Solution
    from pyomo_quad.flight.failure import Failure
    from pyomo_quad.presentation import Picture


#: Number of samples of a plan's table in comparisons with other flights.
FLIGHT_SAMPLES = 1001


@dataclass(frozen=True, kw_only=True)
class Trajectories:
    """States, controls, energy and costates of a plan on its mesh, with the names of the columns.

    Attributes
    ----------
    mesh : Mesh
        Mesh with n_points collocation points.
    horizon : (float, float)
        Start and end time [s].
    state_names, control_names, costate_names : tuple of str
        Names of the columns.
    states : ndarray, shape (n_points + 1, n_states)
        States at the nodes: the start and the collocation points.
    controls : ndarray, shape (n_points, n_controls)
        Controls at the collocation points.
    energy : ndarray, shape (n_points + 1,)
        Energy spent until each node [J].
    costates : ndarray, shape (n_points, n_costates)
        Costates at the points, J per unit of the state.
    hamiltonian : ndarray, shape (n_points,)
        Hamiltonian at the points [W].
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
        """Convert times to fractions of the flight's duration.

        `t` holds n times [s]. The result has shape (n,). It is 0 until the start of the flight,
        rises linearly in time, and is 1 from the end of the flight on.
        """
        start, end = self.horizon
        return np.clip((np.asarray(t, dtype=float) - start) / (end - start), 0.0, 1.0)

    def states_at(self, t: FloatArray) -> FloatArray:
        """Return the values of the state polynomials at n given times [s], shape (n, n_states)."""
        return interpolate(self.mesh, self.states, self.fractions(t), with_start=True)

    def controls_at(
        self, t: FloatArray, limits: tuple[FloatArray, FloatArray] | None = None
    ) -> FloatArray:
        """Return the values of the control polynomials at n given times [s].

        The result has shape (n, n_controls). It is clipped to `limits`, the lower and the upper
        limits of the controls, each of shape (n_controls,). If `limits` is None, the result is not
        clipped.
        """
        controls = interpolate(self.mesh, self.controls, self.fractions(t), with_start=False)
        return controls if limits is None else np.clip(controls, *limits)

    def energy_at(self, t: FloatArray) -> FloatArray:
        """Return the energy spent from the start until each of n given times [J], shape (n,)."""
        held = interpolate(self.mesh, self.energy[:, None], self.fractions(t), with_start=True)
        return held[:, 0]

    @property
    def node_times(self) -> FloatArray:
        """Times of the nodes [s], shape (n_points + 1,): the start and the collocation points."""
        start, end = self.horizon
        return start + (end - start) * self.mesh.node_fractions


def trajectories_of(solution: Solution) -> Trajectories:
    """Return states, controls, energy and costates of a solution, with the names of the columns.

    The controls are the algebraic variables that no equation determines. The other algebraic
    variables are left out.
    """
    declared = solution.problem.compiled.declared
    costates = solution.costates
    # Variables that equations determine are not commands: a flight solves for them.
    controls, _ = split_algebraics(solution.problem)
    names = {slot.name for slot in controls}
    is_control = [slot.name in names for slot in declared.algebraics]
    return Trajectories(
        mesh=solution.mesh_in_time,
        horizon=solution.horizon,
        state_names=tuple(s.name for s in (*declared.states, *declared.outputs)),
        control_names=tuple(s.name for s in controls),
        costate_names=tuple(s.name for s in declared.states),
        states=np.hstack([solution.trajectory.states, solution.output_states]),
        controls=solution.trajectory.algebraics[:, is_control],
        energy=solution.running_objective,
        costates=costates.at_points,
        hamiltonian=costates.hamiltonian,
    )


#: Smallest energy that a relative error of an energy is divided by [J].
LEAST_ENERGY_J = 1e-3

# Plan file: number of the format, member with the description, and largest size read [bytes], a
# protection against files that would fill the memory.
_FORMAT: Final = 2
_ABOUT = "about"
_LARGEST_FILE = 256 * 1024 * 1024
# Members of a plan file: arrays of the plan, its mesh, named data, and the prefix of a warm start.
_ARRAYS = ("states", "controls", "energy", "costates", "hamiltonian")
_MESH = ("breakpoints", "degrees")
_NAMED = ("horizon", "state_names", "control_names", "costate_names")
_WARM_START = "warm_start."


class PlanStatus(StrEnum):
    """Outcome of planning a scenario, from verified to failed.

    The simulated flight is a simulation of the planned controls without feedback.

    Attributes
    ----------
    VERIFIED
        The simulated flight and the error estimate confirm the plan to the requested accuracy.
    USABLE
        The simulated flight confirms the plan to the wide tolerances `scenario.accuracy.USABLE`.
        For example, the flight may end half a metre from the goal. Another flight may need less
        energy, see `Plan.energy_uncertainty`.
    SOLVED
        Ipopt converged, but the simulated flight does not confirm the plan.
    NOT_CONVERGED
        The solve did not converge.
    INFEASIBLE
        The solve found that no flight keeps all limits, or keep-out zones block every route. If
        there are several routes, the solve along each route tried found this, at least on a coarse
        mesh.
    INTERRUPTED
        The solve was stopped.
    """

    VERIFIED = "verified"
    USABLE = "usable"
    SOLVED = "solved"
    NOT_CONVERGED = "not_converged"
    INFEASIBLE = "infeasible"
    INTERRUPTED = "interrupted"


#: Statuses of plans that may be flown and exported.
FLYABLE = (PlanStatus.VERIFIED, PlanStatus.USABLE)


# Error estimate, which a failed solve leaves infinite.
_Error = Annotated[float, AllowInfNan()]


class PlanRecord(Part):
    """Attributes of a plan that a plan file stores as text, such as status, energy and history.

    They have the same names and meanings as those of `Plan`. The arrays of the plan are stored
    separately.
    """

    status: PlanStatus
    message: str
    energy: float
    hover_energy_J: float
    error_estimate: _Error
    verification: Verification | None
    history: tuple[MeshRecord, ...]
    attempts: tuple[str, ...]
    timings: Mapping[str, float]
    passing_times_s: tuple[float, ...] = ()
    routes: tuple[TriedRoute, ...] = ()
    order_search: OrderSearch | None = None
    risk: RiskTaken | None = None


class _About(Part):
    """Schema of the text part of a plan file, which is JSON.

    The text part has the scenario, the attributes of the plan, the start and end time of the plan,
    and the names of the columns of its arrays.
    """

    model_config = ConfigDict(ser_json_inf_nan="constants")

    format: Literal[2]
    scenario: dict[str, Any]
    plan: PlanRecord
    horizon: tuple[float, float]
    state_names: tuple[str, ...]
    control_names: tuple[str, ...]
    costate_names: tuple[str, ...]


def write_plan_file(
    path: Path,
    scenario: Scenario,
    record: PlanRecord,
    trajectories: Trajectories,
    warm_start: WarmStart | None,
) -> None:
    """Write a plan to a file: a compressed archive of arrays, with a description as JSON.

    A warm start that contains infinite numbers is not written.
    """
    about = _About(
        format=_FORMAT,
        scenario=scenario.model_dump(mode="json"),
        plan=record,
        **{name: getattr(trajectories, name) for name in _NAMED},
    )
    arrays = {
        "breakpoints": np.asarray(trajectories.mesh.breakpoints),
        "degrees": np.asarray(trajectories.mesh.degrees),
        **{name: getattr(trajectories, name) for name in _ARRAYS},
    }
    if warm_start is not None and warm_start.is_finite:
        arrays |= {f"{_WARM_START}{name}": held for name, held in warm_start.arrays().items()}
    text = about.model_dump_json()
    with path.open("wb") as file:
        np.savez_compressed(
            file, allow_pickle=False, **arrays, about=np.frombuffer(text.encode(), dtype=np.uint8)
        )


def read_plan_file(path: Path) -> tuple[Scenario, PlanRecord, Trajectories, WarmStart | None]:
    """Read a plan file and return the scenario, attributes, arrays and warm start of the plan.

    The warm start is None if the file has none. Raises a ScenarioError if the file is missing, too
    large, or not a plan of this version.
    """
    try:
        with path.open("rb") as file:
            arrays = _read_arrays(path, file)
        text = arrays.pop(_ABOUT)
    except (ScenarioError, MemoryError):
        raise
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read ({error.strerror or error}).") from None
    except Exception as error:
        # The zip and npy readers raise exceptions of many types for a damaged archive.
        raise ScenarioError(_not_a_plan(path)) from error
    try:
        about = _read_about(path, text)
        scenario = _read_scenario(path, about)
        return scenario, about.plan, _trajectories(about, arrays), _warm_start(arrays)
    except TranscriptionError as error:
        _refuse(path, str(error))


def _read_arrays(path: Path, file: BinaryIO) -> dict[str, NDArray[Any]]:
    with ZipFile(file) as archive:
        # Unpacked size according to the archive, because a small file may unpack to a very large
        # one.
        size = sum(part.file_size for part in archive.infolist())
    if size > _LARGEST_FILE:
        raise ScenarioError(f"{path}: holds more than {_LARGEST_FILE} bytes; not a plan.")
    file.seek(0)
    with np.load(file, allow_pickle=False) as held:
        return {name: held[name] for name in held.files}


def _read_about(path: Path, text: NDArray[Any]) -> _About:
    if text.dtype != np.uint8 or text.ndim != 1:
        raise ScenarioError(_not_a_plan(path))
    try:
        about = _About.model_validate_json(text.tobytes(), strict=True)
    except ValidationError as error:
        found, line = complaints(error, _About)[0]
        if found in {(), ("format",)}:
            raise ScenarioError(_not_a_plan(path)) from None
        _refuse(path, line)
    plan, (start, end) = about.plan, about.horizon
    numbers = [plan.error_estimate, *(record.objective for record in plan.history)]
    numbers += [record.error for record in plan.history]
    if np.any(np.isnan(numbers)):
        _refuse(path, "error_estimate and history hold a NaN.")
    if not start < end:
        _refuse(path, f"horizon = [{start:g}, {end:g}] s; must end after it starts.")
    flown = plan.verification
    proven = {
        PlanStatus.VERIFIED: flown is not None and flown.is_verified,
        PlanStatus.USABLE: flown is not None and flown.is_usable,
    }
    if not proven.get(plan.status, True):
        _refuse(path, f"status = {plan.status.value}, but its verification has failed.")
    for kind in ("state_names", "control_names"):
        names = getattr(about, kind)
        if len(set(names)) != len(names) or not names:
            _refuse(path, f"{kind}: must be names, each given once.")
    if set(about.costate_names) - set(about.state_names):
        _refuse(path, "costate_names: must be names of states.")
    return about


def _read_scenario(path: Path, about: _About) -> Scenario:
    try:
        return Scenario.model_validate(about.scenario)
    except ValidationError as error:
        _refuse(path, f"scenario: {complaints(error, Scenario)[0][1]}")
    except PyomoQuadError as error:
        _refuse(path, f"scenario: {error}")


def _trajectories(about: _About, arrays: dict[str, NDArray[Any]]) -> Trajectories:
    unknown = [
        name
        for name in arrays
        if name not in {*_ARRAYS, *_MESH} and not name.startswith(_WARM_START)
    ]
    if unknown:
        raise TranscriptionError(f"{printable(unknown[0])}: is no array of a plan.")
    mesh = Mesh.from_arrays(arrays)
    points = mesh.points
    shapes = {
        "states": (points + 1, len(about.state_names)),
        "controls": (points, len(about.control_names)),
        "energy": (points + 1,),
        "costates": (points, len(about.costate_names)),
        "hamiltonian": (points,),
    }
    return Trajectories(
        mesh=mesh,
        horizon=about.horizon,
        state_names=about.state_names,
        control_names=about.control_names,
        costate_names=about.costate_names,
        **{name: real_array(arrays, name, shape) for name, shape in shapes.items()},
    )


def _warm_start(arrays: dict[str, NDArray[Any]]) -> WarmStart | None:
    held = {
        name.removeprefix(_WARM_START): array
        for name, array in arrays.items()
        if name.startswith(_WARM_START)
    }
    try:
        return WarmStart.from_arrays(held) if held else None
    except TranscriptionError as error:
        raise TranscriptionError(f"{_WARM_START}{error}") from None


def _refuse(path: Path, line: str) -> NoReturn:
    raise ScenarioError(f"{path}: {line} Solve the scenario again to have its plan.") from None


def _not_a_plan(path: Path) -> str:
    return f"{path}: is not a plan written by Plan.save of this version."


@dataclass(frozen=True, kw_only=True, repr=False)
class Plan(Summarised):
    """Flight of least energy for a scenario, or the best iterate of a failed solve.

    Attributes
    ----------
    scenario : Scenario
        Scenario that was planned.
    status : PlanStatus
        Outcome, from verified to failed.
    message : str
        Reason why the solve ended. For a plan of status `USABLE`, the message also states how
        closely the simulated flight agrees with the plan.
    energy : float
        Energy of the flight [J], computed by the quadrature of the collocation scheme.
    hover_energy_J : float
        Energy of hovering in still air for the same time [J]; NaN if the vehicle cannot hover.
    trajectories : Trajectories
        States, controls, energy and costates on the mesh.
    verification : Verification or None
        Comparison of the plan with the simulation of its controls; None if the controls were not
        simulated.
    error_estimate : float
        Estimate of the largest relative error of any state in any element of the mesh. Before the
        verification, the controls of a coarse solution are corrected: a simulated vehicle follows
        the planned path under feedback. `error_estimate` of a corrected plan is the larger of this
        estimate and abs(E - E_least) / E_least. Here E is the energy of the plan, and E_least the
        estimated least energy of the mission.
    history : tuple of MeshRecord
        Record of each mesh of the refinement.
    iterations : tuple of Iteration
        Ipopt's progress on the last mesh.
    attempts : tuple of str
        Planning strategies that were tried (such as retries from other initial guesses), in order,
        with their outcomes.
    failure : Failure or None
        Diagnosis of a failed solve.
    passing_times_s : tuple of float
        Time at which each waypoint is reached [s].
    timings : mapping
        Computing time [s] of each phase: build, compile, solve and verify.
    routes : tuple of TriedRoute
        Result for each route tried, round keep-out zones or through a wind field. The first is the
        shortest route or, in a wind field, the route of least estimated energy.
    order_search : OrderSearch or None
        Result of the search for the order of the waypoints; None if the mission gives the order.
    warm_start : WarmStart or None
        Variables and multipliers from which another solve can start; stored by `save`.
    solution : Solution or None
        Result of the collocation engine; None if the plan was loaded from a file.
    flown : Flown or None
        Samples of the simulated flight of the verification.
    risk : RiskTaken or None
        Record of the risk, with margins and test flights. None for a plan without margins. A plan
        without margins may use the whole thrust and leave the controller none for corrections.
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
    routes: tuple[TriedRoute, ...] = ()
    order_search: OrderSearch | None = None
    warm_start: WarmStart | None = field(default=None, compare=False, repr=False)
    solution: Solution | None = field(default=None, compare=False, repr=False)
    flown: Flown | None = field(default=None, compare=False, repr=False)
    passing_times_s: tuple[float, ...] = ()
    risk: RiskTaken | None = None

    @property
    def duration_s(self) -> float:
        """Duration of the flight [s]: prescribed by the mission, or chosen by the plan."""
        start, end = self.trajectories.horizon
        return end - start

    @property
    def cost(self) -> float:
        """Objective of the plan: energy plus the price of time times the duration [J].

        The price of time [W] is the weight of a free duration in the objective.
        """
        return self.energy + self.scenario.mission.price_of_time * self.duration_s

    @property
    def margins(self) -> Mapping[str, float]:
        """Amounts by which limits were tightened for the plan, in the units of the limits.

        The key is the full name of a field of the scenario, such as "limits.thrust_max". The
        mapping is empty for a plan without a record `risk`, made without an allowed risk.
        """
        return {} if self.risk is None else self.risk.margins

    @property
    def mission_flown(self) -> Scenario:
        """Scenario of the plan, with the plan's values for all times that the mission leaves free.

        The times that may be free are the duration of the flight and the passing times of the
        waypoints.
        """
        told = self.scenario
        if not told.mission.is_free and not told.mission.waypoints:
            return told
        return told.lasting(self.duration_s, self.passing_times_s)

    @property
    def risk_words(self) -> str:
        """Sentence on the risk of the plan and the energy that its margins cost.

        The risk is the probability that a flight in turbulence breaks a limit. If the plan has no
        margins, the sentence warns that gusts or a wrong wind forecast would break the limits.
        """
        return PAPER_PLAN if self.risk is None else self.risk.words(self.energy)

    @property
    def summary(self) -> dict[str, str]:
        """Main results of the plan, as a mapping from the name of a result to its value as text.

        The results are the scenario's name, the status, the energy, the estimated error, the size
        of the mesh and the message.
        """
        return {
            "scenario": self.scenario.name,
            "status": self.status.value,
            "energy": f"{self.energy:.1f} J (hover: {self.hover_energy_J:.1f} J)",
            "estimated error": f"{self.error_estimate:.2g}",
            "mesh": f"{self.mesh.points} points in {self.mesh.elements} elements",
            "message": self.message,
        }

    @property
    def mesh(self) -> Mesh:
        """Mesh of the plan, the last mesh of the refinement."""
        return self.trajectories.mesh

    @property
    def is_verified(self) -> bool:
        """Whether simulation confirmed the plan to the requested accuracy."""
        return self.status is PlanStatus.VERIFIED

    @property
    def is_optimised(self) -> bool:
        """Whether the plan was made from a solution of the optimal control problem.

        The value is False for a flight along the shortest route that was made without an
        optimisation. A long search starts with such a plan; see docs/theory/geometric_plan.md.
        """
        return bool(self.history)

    @property
    def is_flyable(self) -> bool:
        """Whether simulation confirmed the plan to some accuracy.

        The value is True for the status `VERIFIED`, confirmed to the requested accuracy. It is also
        True for the status `USABLE`, confirmed to wider tolerances: the flight may end half a metre
        from the goal.
        """
        return self.status in FLYABLE

    @property
    def figures_checked(self) -> Figures:
        """Tolerances on the differences between the plan and the simulation of its controls.

        They follow from the accuracy that the scenario requests. For a plan of status `USABLE`,
        they are `scenario.accuracy.USABLE`: the flight may end half a metre from the goal.
        """
        usable = self.status is PlanStatus.USABLE
        return USABLE if usable else FIGURES[self.scenario.solver.accuracy]

    @property
    def accuracy_reached(self) -> Accuracy | None:
        """Highest accuracy level to which simulation and error estimate confirm the plan.

        It is at most the requested level. None if no level is confirmed.
        """
        if self.is_verified:
            return self.scenario.solver.accuracy
        flown = None if self.verification is None else self.verification.reached
        known = self.energy_uncertainty
        met = [a for a in Accuracy if flown and flown.meets(a) and known <= FIGURES[a].energy]
        return met[-1] if met and self.is_flyable else None

    @property
    def energy_uncertainty(self) -> float:
        """Estimated fraction of the energy that a better flight near the plan may save.

        - Verified plan: its error estimate, or the requested tolerance if that is smaller.
        - Other plan, several meshes: the relative change of the objective between the last two.
        - Other plan, one mesh: its error estimate, which may be infinite.

        For a plan that is not verified, the value is at least the energy tolerance of the accuracy
        `quick`.
        """
        if self.is_verified:
            return min(self.error_estimate, self.scenario.solver.tolerance)
        if len(self.history) < 2:
            return max(self.error_estimate, FIGURES[Accuracy.QUICK].energy)
        last, now = self.history[-2:]
        change = abs(now.objective - last.objective) / max(abs(now.objective), LEAST_ENERGY_J)
        # Two meshes may agree by chance.
        return max(change, FIGURES[Accuracy.QUICK].energy)

    @property
    def iteration_count(self) -> int:
        """Number of Ipopt iterations on all meshes together."""
        return sum(record.iterations for record in self.history)

    @property
    def reached(self) -> str:
        """Sentence on how far an unfinished search for the plan came.

        It describes the last mesh (number and size), the energy, Ipopt's last iteration (number and
        infeasibility), and the estimated error.
        """
        asked = self.scenario.solver.tolerance
        parts = [
            f"mesh {max(len(self.history), 1)} with {self.mesh.points} points",
            f"{self.energy:.6g} J",
        ]
        if self.iterations:
            last = self.iterations[-1]
            parts += [f"iteration {last.iteration}", f"infeasibility {last.infeasibility:.1e}"]
        if isfinite(self.error_estimate):
            parts.append(f"estimated error {self.error_estimate:.1e} where {asked:g} is required")
        return f"Reached: {', '.join(parts)}."

    @cached_property
    def dynamics(self) -> Dynamics:
        """Equations of the vehicle, compiled with the plan's parameters, for simulations.

        Raises
        ------
        ScenarioError
            If the plan was loaded from a file, which does not contain equations.
        """
        if self.solution is None:
            raise ScenarioError(
                f"{self.scenario.name}: this plan was loaded from a file and holds no equations; "
                "solve the scenario again to fly it."
            )
        return self.solution.dynamics.without_iterations()

    def owed_energy(self, final: Mapping[str, float]) -> float:
        """Estimate the energy still needed by a flight that ends off the goal [J].

        The estimate is the sum of lambda_i (x_i - x_i,planned) over the states i. Here lambda_i is
        the costate at the end of the plan, and x_i the final value of the state in the flight. See
        docs/theory/transcription.md, eq. (14).

        Parameters
        ----------
        final : mapping
            State name -> final value in the flight; states that the plan lacks are ignored.

        Returns
        -------
        float
            Estimated energy [J]: positive for a flight that ends short of the planned final state,
            negative for a flight that ends beyond.
        """
        held = self.trajectories
        planned = dict(zip(held.state_names, held.states[-1].tolist(), strict=True))
        return sum(
            price * (final[name] - planned[name])
            for name, price in self.end_prices.items()
            if name in final
        )

    @property
    def end_prices(self) -> dict[str, float]:
        """Costates at the end of the plan, by state name [J per unit of the state].

        The costate of a state is the derivative of the energy of the rest of an optimal flight with
        respect to this state. See `owed_energy`.
        """
        held = self.trajectories
        return dict(zip(held.costate_names, held.costates[-1].tolist(), strict=True))

    def to_frame(self, rate_hz: float | None = None) -> pd.DataFrame:
        """Return the plan as a table at the nodes of the mesh, or at a constant rate.

        Parameters
        ----------
        rate_hz : float, optional
            Rows per second; by default there is one row for each node of the mesh.

        Returns
        -------
        DataFrame
            One column for each quantity; the tuple `flight.COLUMNS` lists those of a quadrotor with
            their units. The index is the time, "time_s".

        Raises
        ------
        ScenarioError
            If the rate is not above 0 and at most 1e5 Hz. Also for any plan loaded from a file,
            because some columns follow from equations, which the file does not contain.

        Examples
        --------
        >>> frame = plan.to_frame(rate_hz=1.0)
        >>> frame.index.name, len(frame)
        ('time_s', 5)
        """
        return flight_frame(*self._sampled(self.times(rate_hz))).set_index(TIME)

    def to_xarray(self, rate_hz: float | None = None) -> xr.Dataset:
        """Return the plan as a dataset over the coordinate "time_s", each variable with its unit.

        Parameters
        ----------
        rate_hz : float, optional
            Values per second; by default there is one value for each node of the mesh.

        Returns
        -------
        Dataset
            One variable for each column of the table that `to_frame` returns. Scenario, status and
            energy are attributes of the dataset.

        Raises
        ------
        ScenarioError
            As for `to_frame`.

        Examples
        --------
        >>> data = plan.to_xarray(rate_hz=10.0)
        >>> bool(data.x_m.sel(time_s=2.0) == plan.at(2.0)["x_m"])
        True
        >>> data.power_W.attrs["units"]
        'W'
        """
        about = {"scenario": self.scenario.name, "status": self.status.value}
        told = about | {"energy_J": self.energy, "hover_energy_J": self.hover_energy_J}
        return dataset_of(self.to_frame(rate_hz)).assign_attrs(told)

    def columns(self, times: FloatArray) -> dict[str, FloatArray]:
        """Return the quantities of the plan at given times, by name.

        `times` has n times [s]; each quantity is an array of shape (n,). The names are those of the
        columns in the table of the plan, which the method `to_frame` returns.

        Raises
        ------
        ScenarioError
            If the plan was loaded from a file, which does not contain equations.
        """
        return flight_columns(*self._sampled(times))

    def times(self, rate_hz: float | None = None) -> FloatArray:
        """Return the times [s] of the rows in the table of the plan, which `to_frame` returns.

        By default they are the times of the mesh nodes. If a rate ``rate_hz`` [Hz] is given, the
        times are equally spaced from start to end.

        Raises
        ------
        ScenarioError
            If the rate is not above 0 and at most 1e5 Hz.
        """
        if rate_hz is None:
            return self.trajectories.node_times
        if not 0.0 < rate_hz <= 1e5:
            raise ScenarioError(f"--rate = {rate_hz:g} Hz; must be above 0 and at most 1e5.")
        start, end = self.trajectories.horizon
        return np.linspace(start, end, max(2, round((end - start) * rate_hz) + 1))

    @property
    def passages(self) -> list[Passage]:
        """Waypoints of the mission with position, radius and the plan's passing time."""
        pairs = zip(self.scenario.mission.waypoints, self.passing_times_s, strict=True)
        return [Passage(time_s=at, position=w.position, radius=w.radius) for w, at in pairs]

    def _sampled(
        self, times: FloatArray
    ) -> tuple[Dynamics, FloatArray, FloatArray, FloatArray, FloatArray]:
        held = self.trajectories
        controls = held.controls_at(times, self.dynamics.control_limits(HELD_BREACH))
        return self.dynamics, times, held.states_at(times), controls, held.energy_at(times)

    @overload
    def at(self, t: float) -> pd.Series: ...

    @overload
    def at(self, t: Sequence[float] | FloatArray) -> pd.DataFrame: ...

    def at(self, t: float | Sequence[float] | FloatArray) -> pd.Series | pd.DataFrame:
        """Return all quantities of the plan at a time `t` [s], or at several times.

        The quantities are the columns of `to_frame`. A single time gives a series with the time as
        its name. Several times give a table with the time as its index.

        Raises
        ------
        ScenarioError
            If a time is outside the flight, or if the plan was loaded from a file, which does not
            contain equations.
        """
        start, end = self.trajectories.horizon
        times = np.atleast_1d(np.asarray(t, dtype=float))
        outside = times[~((start <= times) & (times <= end))]
        if outside.size:
            raise ScenarioError(
                f"t = {outside[0]:g} s is outside the flight, [{start:g}, {end:g}] s."
            )
        frame = flight_frame(*self._sampled(times)).set_index(TIME)
        return frame.iloc[0] if np.ndim(t) == 0 else frame

    def flight(self, name: str = "optimal", samples: int = FLIGHT_SAMPLES) -> Flight:
        """Return the plan as a `Flight`, for comparison with simulated flights.

        Parameters
        ----------
        name : str, optional
            Name of the flight in comparisons.
        samples : int, optional
            Number of rows of the flight's table.

        Returns
        -------
        Flight
            Energy and table of the plan, with two results of the simulation that verified the plan:
            the deviations of the final state and the violations of limits. They are infinite for a
            plan that was not simulated.

        Raises
        ------
        ScenarioError
            If the plan was loaded from a file, which does not contain equations.
        """
        verification = self.verification
        return Flight(
            name=name,
            frame=flight_frame(*self._sampled(np.linspace(*self.trajectories.horizon, samples))),
            energy_J=self.energy,
            duration_s=self.duration_s,
            terminal_miss={} if verification is None else verification.terminal_miss,
            terminal_miss_m=np.inf if verification is None else verification.terminal_miss_m,
            max_violation=np.inf if verification is None else verification.max_violation,
            worst_constraint="" if verification is None else verification.worst_constraint,
            is_verified=self.is_flyable,
            wall_s=sum(self.timings.values()),
            owed_energy_J=0.0,  # its end is the required one
            broken_limits=() if verification is None else verification.broken_limits,
        )

    def costate_frame(self) -> pd.DataFrame:
        """Return costates and Hamiltonian as a table, at the collocation points.

        The index is the time, "time_s". The costates are in J per unit of the state, the
        Hamiltonian in W.
        """
        import pandas as pd  # noqa: PLC0415  0.3 s that a solve has no use for

        held = self.trajectories
        times = pd.Index(held.node_times[1:], name=TIME)
        frame = pd.DataFrame(held.costates, columns=list(held.costate_names), index=times)
        frame["hamiltonian"] = held.hamiltonian
        return frame

    def plot(self, what: str = "path") -> Picture:
        """Draw a figure of the plan, or a column of its table over time.

        Parameters
        ----------
        what : str, default "path"
            Name of a figure: "path", "states", "controls", "energy", "motors", "battery", "wind",
            "way", "mesh" and others. If `what` is a column of `to_frame`, this column is drawn over
            time. The error message for an unknown name lists all names.

        Returns
        -------
        Picture
            The figure. A notebook displays it; `Picture.save` writes it to a file, and
            `Picture.figure` is the figure of matplotlib.

        Raises
        ------
        ScenarioError
            If the name is unknown, or if the plan was loaded from a file. No figure of such a plan
            can be drawn, because the file does not contain equations.

        Examples
        --------
        >>> plan.plot("power_W")
        <figure power_W: >
        """
        return presenter().picture_of_plan(self, what)

    def report(self, folder: str | Path, *, figures: str = "svg") -> Path:
        """Write the report of the plan into a folder, as `pyomo-quad solve` does.

        Parameters
        ----------
        folder : str or Path
            Folder for the report, which is new, empty or holds an earlier report. The new report
            appears there only when it is complete.
        figures : {"svg", "png", "all", "none"}, optional
            Formats of the figures.

        Returns
        -------
        Path
            Path of the report's text, `report.md`.

        Raises
        ------
        ScenarioError
            If `figures` has another value, or if the plan was loaded from a file, which does not
            contain equations.
        OutputError
            If the folder cannot be written, or holds files that no report wrote.

        Examples
        --------
        >>> print(plan.report("reports/hop", figures="none"))
        reports/hop/report.md
        """
        return presenter().report_plan(self, folder, figures)

    def save(self, path: str | Path) -> None:
        """Write the plan to a file that `load` reads: an archive of arrays and JSON, not a pickle.

        The attributes `iterations`, `failure`, `solution` and `flown` are not stored.

        Parameters
        ----------
        path : str or Path
            File to write.
        """
        write_plan_file(
            Path(path),
            self.scenario,
            PlanRecord(**{name: getattr(self, name) for name in PlanRecord.model_fields}),
            self.trajectories,
            self.warm_start,
        )

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a plan from a file that `save` wrote.

        The file does not contain equations, so that the loaded plan cannot be simulated. It can
        serve as the initial point of another solve, like the plan that was saved.

        Parameters
        ----------
        path : str or Path
            File that `save` wrote.

        Raises
        ------
        ScenarioError
            If the file is missing, too large, or not a plan of this version; the message names the
            error.
        """
        scenario, record, trajectories, warm_start = read_plan_file(Path(path))
        values = {name: getattr(record, name) for name in PlanRecord.model_fields}
        return cls(scenario=scenario, **values, trajectories=trajectories, warm_start=warm_start)
