"""A case of a sweep: its task for a worker, its solution, and the outputs of its flights."""

import importlib
import math
import os
import socket
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from io import BytesIO
from zipfile import BadZipFile

import numpy as np

from pyomo_quad.collocation import TranscriptionError, WarmStart
from pyomo_quad.flight import Flight, Plan, Planner
from pyomo_quad.flight.baselines import fly_baseline
from pyomo_quad.flight.weather import vehicle_flown
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.tables import Reference
from pyomo_quad.study.comparison import is_comparable, settled_energy
from pyomo_quad.version import __version__

_LONGEST_REASON = 500  # characters of a stored reason: one line of a report
# Largest output of any column, in SI units, so that sums and squares of outputs do not overflow.
LARGEST_OUTPUT = 1e15


class StudyTask(StrEnum):
    """Kind of case: solve a plan, or fly the plan of the base case."""

    OPTIMISE = "optimise"
    FLY_PLAN = "fly_plan"


class CaseStatus(StrEnum):
    """Outcome of a case: finished, failed, or lost with its worker."""

    FINISHED = "finished"
    FAILED = "failed"
    LOST = "lost"


@dataclass(frozen=True, kw_only=True)
class CaseTask:
    """Input of a worker for one case.

    Attributes
    ----------
    position : int
        Row number of the case.
    key : str
        The case's key.
    solver : str
        Case solver as ``module:function``; the program chooses it, never an input file.
    scenario : str
        The complete scenario, JSON.
    base : str
        The complete base scenario, JSON.
    task : StudyTask
        Task of the study.
    baselines : tuple of Reference
        References that the controller flies.
    warm_start : bytes or None
        Packed warm start from the parent case.
    """

    position: int
    key: str
    solver: str
    scenario: str
    base: str
    task: StudyTask
    baselines: tuple[Reference, ...]
    warm_start: bytes | None = None


@dataclass(frozen=True, kw_only=True)
class CaseResult:
    """Output of a case solver.

    Attributes
    ----------
    values : mapping
        Column -> number.
    warm_start : bytes or None
        Packed warm start for the children of this case.
    reason : str
        Reason of the failure, empty for a success; the values are kept in both cases.
    """

    values: Mapping[str, float]
    warm_start: bytes | None = None
    reason: str = ""


CaseSolver = Callable[[CaseTask], CaseResult]


@dataclass(frozen=True, kw_only=True)
class CaseOutcome:
    """Row of a sweep for a case that ended.

    Attributes
    ----------
    position, key : int, str
        Row number and key of the case.
    status : CaseStatus
        Finished, failed by its numbers, or lost with its worker.
    reason : str
        Why the case did not finish.
    values : mapping
        Column -> number.
    warm_start : bytes or None
        Packed warm start for the children of this case.
    seconds : float
        Wall time of the solve.
    worker : str
        Host and process that solved it.
    """

    position: int
    key: str
    status: CaseStatus
    reason: str = ""
    values: Mapping[str, float]
    warm_start: bytes | None = None
    seconds: float = 0.0
    worker: str = ""

    @property
    def is_finished(self) -> bool:
        """Whether the case has results."""
        return self.status is CaseStatus.FINISHED

    @classmethod
    def of(cls, task: CaseTask, result: CaseResult) -> "CaseOutcome":
        """Make a row from the result of a case solver."""
        # A column without a number is left empty, because JSON has no NaN.
        finite = {n: float(v) for n, v in result.values.items() if abs(v) <= LARGEST_OUTPUT}
        return cls(
            position=task.position,
            key=task.key,
            status=CaseStatus.FAILED if result.reason else CaseStatus.FINISHED,
            reason=" ".join(result.reason.split())[:_LONGEST_REASON],
            values=finite,
            warm_start=result.warm_start if result.warm_start is not None else task.warm_start,
        )

    @classmethod
    def failure(cls, task: CaseTask, reason: str) -> "CaseOutcome":
        """Make a row for a case that failed."""
        return cls.of(task, CaseResult(values={}, reason=reason))

    @classmethod
    def loss(cls, task: CaseTask) -> "CaseOutcome":
        """Make a row for a case whose workers died; a resumed sweep retries it."""
        reason = "its worker died, also when it was tried alone; run the same command to try again"
        return replace(cls.failure(task, reason), status=CaseStatus.LOST)


def perform(task: CaseTask) -> CaseOutcome:
    """Solve one case in the present process; an exception becomes a failed row."""
    started = time.perf_counter()
    module, _, function = task.solver.partition(":")
    try:
        solver: CaseSolver = getattr(importlib.import_module(module), function)
        outcome = CaseOutcome.of(task, solver(task))
    except Exception as error:  # noqa: BLE001  a fault in one case must not end the sweep
        outcome = CaseOutcome.failure(task, f"{type(error).__name__}: {error}")
    return replace(
        outcome,
        seconds=time.perf_counter() - started,
        worker=f"{socket.gethostname()}:{os.getpid()}",
    )


def worker_version() -> str:
    """Return the pyomo_quad version that this process runs."""
    return __version__


ENERGY = "energy_J"
HOVER_ENERGY = "hover_energy_J"
EXCESS_ENERGY = "excess_energy_J"
MEAN_POWER = "mean_power_W"
# Column of the case's own flight; columns of controlled flights end in this name.
TERMINAL_MISS = "terminal_miss_m"
# Scenario field for which figures over duration are drawn.
DURATION_FIELD = "mission.duration"

_SAMPLES = 501  # rows of a plan's flight, from which its peaks and lowest voltage are taken
# Stored outputs have nine digits: a solve is accurate to six, and further digits differ between
# machines by rounding.
_DIGITS = 9
_SMALLEST_RESIDUAL = 1e-7
_RESIDUALS = ("max_violation", TERMINAL_MISS)
_ERROR_ESTIMATE = "error_estimate"
_ERROR_DIGITS = 2


@dataclass(frozen=True, kw_only=True)
class _Flown:
    """Flight of a case with its plan and scenario, from which the output columns are read."""

    flight: Flight
    plan: Plan
    scenario: Scenario

    @property
    def charge_used(self) -> float:
        """Charge used by the flight, in percent."""
        charge = self.flight.frame["state_of_charge_percent"]
        return float(charge.iloc[0] - charge.iloc[-1])

    @property
    def repeats(self) -> float:
        """Number of missions on one battery charge.

        At the voltage of the first flight; the falling voltage makes the true number slightly
        lower.
        """
        least = self.scenario.limits.state_of_charge_min or 0.0
        usable = self.scenario.battery.initial_state_of_charge - least
        return usable / self.charge_used if self.charge_used > 0.0 else np.nan

    @property
    def peak_tilt(self) -> float:
        """Greatest angle between thrust and vertical, in rad."""
        frame = self.flight.frame
        return float(np.arccos(np.cos(frame["phi_rad"]) * np.cos(frame["theta_rad"])).max())

    @property
    def saved(self) -> float:
        """Relative saving of the plan over the flight, NaN if they are not comparable."""
        if not is_comparable(self.flight):
            return np.nan
        return 1.0 - self.plan.energy / settled_energy(self.flight)

    @property
    def distance(self) -> float:
        """Distance from start to goal, in m."""
        mission = self.scenario.mission
        return math.dist(mission.start.position, mission.goal.position)


# Unit and reading of a column, by its name.
_Columns = Mapping[str, tuple[str, Callable[[_Flown], float]]]

_OF_A_FLIGHT: _Columns = {
    MEAN_POWER: ("W", lambda one: one.flight.energy_J / one.flight.duration_s),
    "peak_power_W": ("W", lambda one: float(one.flight.frame["power_W"].max())),
    "peak_tilt_rad": ("rad", lambda one: one.peak_tilt),
    "battery_used_percent": ("percent", lambda one: one.charge_used),
    "lowest_voltage_V": ("V", lambda one: float(one.flight.frame["battery_voltage_V"].min())),
    "range_m": ("m", lambda one: one.repeats * one.distance),
    "endurance_s": ("s", lambda one: one.repeats * one.flight.duration_s),
    "max_violation": ("", lambda one: one.flight.max_violation),
    TERMINAL_MISS: ("m", lambda one: one.flight.terminal_miss_m),
}
_OF_A_PLAN: _Columns = {
    ENERGY: ("J", lambda one: one.plan.energy),
    HOVER_ENERGY: ("J", lambda one: one.plan.hover_energy_J),
    EXCESS_ENERGY: ("J", lambda one: one.plan.energy - one.plan.hover_energy_J),
    **_OF_A_FLIGHT,
    _ERROR_ESTIMATE: ("", lambda one: one.plan.error_estimate),
}
_OF_A_PLAN_FLOWN: _Columns = {
    ENERGY: ("J", lambda one: one.flight.energy_J),
    "planned_energy_J": ("J", lambda one: one.plan.energy),
    "energy_above_plan_J": ("J", lambda one: one.flight.energy_J - one.plan.energy),
    **_OF_A_FLIGHT,
}


def _of_a_baseline(reference: Reference) -> _Columns:
    name = reference.value
    return {
        f"{name}_energy_J": ("J", lambda one: one.flight.energy_J),
        f"{name}_owed_energy_J": ("J", lambda one: one.flight.owed_energy_J),
        f"{name}_{TERMINAL_MISS}": ("m", lambda one: one.flight.terminal_miss_m),
        f"saving_over_{name}_percent": ("percent", lambda one: 100.0 * one.saved),
    }


def unit_of_column(name: str) -> str:
    """Return the unit of an output column, as in its name; "" without a unit."""
    tables = (_OF_A_PLAN, _OF_A_PLAN_FLOWN, *map(_of_a_baseline, Reference))
    return next((table[name][0] for table in tables if name in table), "")


def output_columns(task: StudyTask, baselines: Iterable[Reference]) -> tuple[str, ...]:
    """Return the columns of a case's row, in their order, before any case is solved."""
    if task is StudyTask.FLY_PLAN:
        return tuple(_OF_A_PLAN_FLOWN)
    flown = [name for reference in baselines for name in _of_a_baseline(reference)]
    return (*_OF_A_PLAN, *flown)


def unknown_column(
    names: Iterable[str], task: StudyTask, baselines: Iterable[Reference]
) -> str | None:
    """Return the first name that is no output column of a study, or None."""
    known = output_columns(task, baselines)
    return next((name for name in names if name not in known), None)


def _read(
    columns: _Columns, flight: Flight, plan: Plan, scenario: Scenario | None = None
) -> dict[str, float]:
    """Return the output columns of a case's flight, by name; NaN where undefined."""
    flown = _Flown(flight=flight, plan=plan, scenario=scenario or plan.scenario)
    return {name: _meaningful(name, read(flown)) for name, (_, read) in columns.items()}


def _meaningful(name: str, value: float) -> float:
    if name.endswith(_RESIDUALS) and math.isfinite(value):
        return float(f"{round(value / _SMALLEST_RESIDUAL) * _SMALLEST_RESIDUAL:.{_DIGITS}g}")
    digits = _ERROR_DIGITS if name == _ERROR_ESTIMATE else _DIGITS
    return float(f"{value:.{digits}g}")


def pack(start: WarmStart) -> bytes:
    """Pack a warm start into bytes."""
    target = BytesIO()
    np.savez(target, allow_pickle=False, **start.arrays())
    return target.getvalue()


def unpack(packed: bytes) -> WarmStart | None:
    """Unpack a warm start.

    Returns
    -------
    WarmStart or None
        For `Planner.solve`; None when the bytes are damaged.
    """
    try:
        with np.load(BytesIO(packed), allow_pickle=False) as file:
            return WarmStart.from_arrays({name: file[name] for name in file.files})
    except (BadZipFile, EOFError, OSError, TranscriptionError, ValueError):
        return None


def solve_case(task: CaseTask) -> CaseResult:
    """Solve one case."""
    with _BENCH.lock:
        scenario = Scenario.model_validate_json(task.scenario)
        if task.task == StudyTask.FLY_PLAN:
            return _fly_base_plan(task, scenario)
        return _optimise(task, scenario)


def _optimise(task: CaseTask, scenario: Scenario) -> CaseResult:
    plan = _BENCH.plan(scenario, task.warm_start)
    values = _read(_OF_A_PLAN, plan.flight(samples=_SAMPLES), plan)
    if not plan.is_verified:
        return CaseResult(values=values, reason=f"{plan.status}: {plan.message}")
    reason = ""
    flown = plan.mission_flown
    vehicle = plan.dynamics
    if task.baselines and flown.wind.turbulence is not None:
        vehicle = vehicle_flown(_BENCH.planner, flown)
    for reference in task.baselines:
        flight = fly_baseline(flown, reference, dynamics=vehicle, plan=plan)
        values |= _read(_of_a_baseline(reference), flight, plan)
        if not flight.is_verified:
            reason = f"{flight.name}: two integrators disagree on this flight"
    warm_start = pack(plan.warm_start) if plan.warm_start is not None else None
    return CaseResult(values=values, warm_start=warm_start, reason=reason)


def _fly_base_plan(task: CaseTask, scenario: Scenario) -> CaseResult:
    """Simulate the base case's plan and controller in another case's scenario."""
    base = Scenario.model_validate_json(task.base)
    plan = _BENCH.base_plan(base, task.base)
    if not plan.is_verified:
        return CaseResult(values={}, reason=f"base case: {plan.status}: {plan.message}")
    world = scenario.lasting(plan.duration_s) if scenario.mission.is_free else scenario
    flight = fly_baseline(
        plan.mission_flown, Reference.PLAN, dynamics=vehicle_flown(_BENCH.planner, world), plan=plan
    )
    reason = "" if flight.is_verified else "two integrators disagree on this flight"
    values = _read(_OF_A_PLAN_FLOWN, flight, plan, scenario)
    return CaseResult(values=values, reason=reason)


@dataclass
class _Bench:
    """A worker's planner and base plan, kept between cases; used by one thread at a time."""

    lock: threading.Lock = field(default_factory=threading.Lock)
    planner: Planner = field(default_factory=Planner)
    _base_plans: dict[str, Plan] = field(default_factory=dict)

    def plan(self, scenario: Scenario, warm_start: bytes | None) -> Plan:
        """Solve from the parent's warm start; retry without if the plan is not verified."""
        parent = unpack(warm_start) if warm_start is not None else None
        if parent is not None:
            plan = self.planner.solve(scenario, warm_start=parent)
            if plan.is_verified:
                return plan
        self.planner = Planner()
        return self.planner.solve(scenario)

    def base_plan(self, base: Scenario, text: str) -> Plan:
        """Return the cached plan of a study's base case."""
        if text not in self._base_plans:
            self._base_plans = {text: self.plan(base, None)}
        return self._base_plans[text]


_BENCH = _Bench()
