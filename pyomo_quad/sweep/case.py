"""Solution of one case of a sweep: the worker's input, the solve, and the output columns.

A case is one variant of the sweep's base scenario. A worker receives a `CaseTask` and plans the
case's flight. With the task `FLY_PLAN`, the worker instead flies the base scenario's plan under the
controller in the case's scenario. It returns a `CaseOutcome`, the row of the case in the sweep's
result table.
"""

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

_LONGEST_REASON = 500  # largest length of a stored failure reason [characters]: a report's line
# Largest output of any column, in SI units, so that sums and squares of outputs do not overflow.
LARGEST_OUTPUT = 1e15


class StudyTask(StrEnum):
    """Task of a sweep for each case: plan the case's flight, or fly the base scenario's plan.

    `OPTIMISE` plans the minimum-energy flight of each case. `FLY_PLAN` plans the flight of the base
    scenario only, and the controller tracks this plan under the changed conditions of each case.
    """

    OPTIMISE = "optimise"
    FLY_PLAN = "fly_plan"


class CaseStatus(StrEnum):
    """Outcome of a case of a sweep.

    `FINISHED`: the case was solved, and simulation verified the solution. `FAILED`: the solve or
    the verification failed, or the field values are not allowed. `LOST`: the worker process died
    while it solved the case; a resumed sweep solves the case again.
    """

    FINISHED = "finished"
    FAILED = "failed"
    LOST = "lost"


@dataclass(frozen=True, kw_only=True)
class CaseTask:
    """Input that a worker of a sweep receives to solve one case.

    Attributes
    ----------
    position : int
        Row number of the case, from 0.
    key : str
        Hash of the values that vary.
    solver : str
        Case solver, as ``module:function``; takes this object, returns a `CaseResult`.
    scenario, base : str
        The case's and the base scenario as JSON text.
    task : StudyTask
        Whether to plan, or to fly the base scenario's plan.
    baselines : tuple of Reference
        Trajectories that the controller also tracks.
    warm_start : bytes or None
        Packed solution of a neighbouring case, the initial guess.
    """

    position: int
    key: str
    # Only the program chooses the case solver, so that a study file cannot run code of its own.
    solver: str
    scenario: str
    base: str
    task: StudyTask
    baselines: tuple[Reference, ...]
    warm_start: bytes | None = None


@dataclass(frozen=True, kw_only=True)
class CaseResult:
    """Result that a case solver returns for one case of a sweep.

    Attributes
    ----------
    values : mapping
        Numeric value of each output column.
    warm_start : bytes or None
        Packed solution: the initial guess of the children, the neighbouring cases that are solved
        after this case.
    reason : str
        Reason of the failure; empty for a success. After a failure, `values` still holds the
        numbers that could be computed.
    """

    values: Mapping[str, float]
    warm_start: bytes | None = None
    reason: str = ""


CaseSolver = Callable[[CaseTask], CaseResult]


@dataclass(frozen=True, kw_only=True)
class CaseOutcome:
    """Row of a sweep's result table: status, output values and solve time of one case.

    Attributes
    ----------
    position, key : int, str
        Row number of the case, from 0, and hash of its field values.
    status : CaseStatus
        Whether the case finished, failed or was lost.
    reason : str
        Why the case did not finish; else empty.
    values : mapping
        Value of each output column.
    warm_start : bytes or None
        Packed initial guess of later neighbours: the solution or, without one, this case's own
        guess.
    seconds : float
        Wall time of the solve.
    worker : str
        Host name and process number.
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
        """Whether the case was solved, and verified by simulation."""
        return self.status is CaseStatus.FINISHED

    @classmethod
    def of(cls, task: CaseTask, result: CaseResult) -> "CaseOutcome":
        """Make the row of a sweep's case from the result that the case solver returned.

        Output values that are not finite, or whose magnitude exceeds `LARGEST_OUTPUT`, are dropped.
        If the result has no warm start, the row takes that of the task.
        """
        # JSON has no NaN, and sums and squares of larger values may overflow.
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
        """Make the row of a sweep's case whose solve failed, without output values.

        `task` is the input of the case, and `reason` says in words why the solve failed.
        """
        return cls.of(task, CaseResult(values={}, reason=reason))

    @classmethod
    def loss(cls, task: CaseTask) -> "CaseOutcome":
        """Make the row of a sweep's case that was lost because its worker process died.

        A resumed sweep solves a lost case again. `task` is the input of the case.
        """
        reason = "its worker died, also when it was tried alone; run the same command to try again"
        return replace(cls.failure(task, reason), status=CaseStatus.LOST)


def perform(task: CaseTask) -> CaseOutcome:
    """Solve one case of a sweep in this process, and return its row.

    An exception in the case solver becomes a row with the status `FAILED`, so that a fault in one
    case does not end the sweep.
    """
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
    """Return the version of pyomo_quad in this process.

    A sweep calls the function on each worker of a cluster, and rejects workers with another
    version.
    """
    return __version__


ENERGY = "energy_J"
HOVER_ENERGY = "hover_energy_J"
EXCESS_ENERGY = "excess_energy_J"
MEAN_POWER = "mean_power_W"
# Column with the distance between goal and end of the case's own flight; the columns for flights of
# the baselines end in the same name.
TERMINAL_MISS = "terminal_miss_m"
# Scenario field for which figures over duration are drawn.
DURATION_FIELD = "mission.duration"

_SAMPLES = 501  # rows of a plan's table, from which peak power, tilt and lowest voltage are taken
# Stored outputs have nine digits: a solve is accurate to six, and further digits differ between
# machines by rounding. Limit violation and terminal miss are rounded to multiples of the smallest
# residual, and the error estimate to two digits, because they are rounding noise themselves.
_DIGITS = 9
_SMALLEST_RESIDUAL = 1e-7
_RESIDUALS = ("max_violation", TERMINAL_MISS)
_ERROR_ESTIMATE = "error_estimate"
_ERROR_DIGITS = 2


@dataclass(frozen=True, kw_only=True)
class _Flown:
    """Flight of a sweep's case, from which the output columns of the sweep are computed.

    `plan` is the case's plan, or the base scenario's if all cases fly it.
    """

    flight: Flight
    plan: Plan
    scenario: Scenario

    @property
    def charge_used(self) -> float:
        """Battery charge that the flight uses, in percent of the capacity."""
        charge = self.flight.frame["state_of_charge_percent"]
        return float(charge.iloc[0] - charge.iloc[-1])

    @property
    def repeats(self) -> float:
        """Number of repetitions of the flight that one battery charge permits.

        The result is NaN if the flight uses no charge.
        """
        least = self.scenario.limits.state_of_charge_min or 0.0
        usable = self.scenario.battery.initial_state_of_charge - least
        # Every flight counts as the first. In truth the voltage falls, later flights use more
        # charge, and the number is slightly smaller.
        return usable / self.charge_used if self.charge_used > 0.0 else np.nan

    @property
    def peak_tilt(self) -> float:
        """Largest angle between the thrust and the vertical during the flight, in rad."""
        frame = self.flight.frame
        return float(np.arccos(np.cos(frame["phi_rad"]) * np.cos(frame["theta_rad"])).max())

    @property
    def saved(self) -> float:
        """Energy saving of the plan compared with this flight, as a fraction: 1 - P / E.

        P is the energy of the plan, E that of the flight to the goal state. The result is NaN if
        `is_comparable` is false for the flight.
        """
        if not is_comparable(self.flight):
            return np.nan
        return 1.0 - self.plan.energy / settled_energy(self.flight)

    @property
    def distance(self) -> float:
        """Straight-line distance from start to goal, in m."""
        mission = self.scenario.mission
        return math.dist(mission.start.position, mission.goal.position)


# For each output column: its unit, and the function that computes its value.
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
    """Return the unit of an output column of a sweep, spelled as in the column's name.

    For example, the unit of ``energy_J`` is "J". The result is empty for a column without unit.
    """
    tables = (_OF_A_PLAN, _OF_A_PLAN_FLOWN, *map(_of_a_baseline, Reference))
    return next((table[name][0] for table in tables if name in table), "")


def output_columns(task: StudyTask, baselines: Iterable[Reference]) -> tuple[str, ...]:
    """Return the names of all output columns that a sweep can have, in the order of its table.

    If each case is planned, each reference trajectory in `baselines` adds its own columns.
    """
    if task is StudyTask.FLY_PLAN:
        return tuple(_OF_A_PLAN_FLOWN)
    flown = [name for reference in baselines for name in _of_a_baseline(reference)]
    return (*_OF_A_PLAN, *flown)


def unknown_column(
    names: Iterable[str], task: StudyTask, baselines: Iterable[Reference]
) -> str | None:
    """Return the first of some names that is not an output column of the sweep, or None.

    `names` are the columns that a study file asks for.
    """
    known = output_columns(task, baselines)
    return next((name for name in names if name not in known), None)


def _read(
    columns: _Columns, flight: Flight, plan: Plan, scenario: Scenario | None = None
) -> dict[str, float]:
    """Return the output columns of a sweep for a case's flight, rounded.

    Values have nine significant digits; the error estimate has two, and residuals are multiples of
    1e-7. An undefined value is NaN. `scenario` is the case's scenario; by default, it is that of
    `plan`.
    """
    flown = _Flown(flight=flight, plan=plan, scenario=scenario or plan.scenario)
    return {name: _meaningful(name, read(flown)) for name, (_, read) in columns.items()}


def _meaningful(name: str, value: float) -> float:
    if name.endswith(_RESIDUALS) and math.isfinite(value):
        return float(f"{round(value / _SMALLEST_RESIDUAL) * _SMALLEST_RESIDUAL:.{_DIGITS}g}")
    digits = _ERROR_DIGITS if name == _ERROR_ESTIMATE else _DIGITS
    return float(f"{value:.{digits}g}")


def pack(start: WarmStart) -> bytes:
    """Pack a warm start into the bytes of an .npz file.

    A warm start is an initial guess for a neighbouring case, made from a solution.
    """
    target = BytesIO()
    np.savez(target, allow_pickle=False, **start.arrays())
    return target.getvalue()


def unpack(packed: bytes) -> WarmStart | None:
    """Unpack a warm start that `pack` wrote, for `Planner.solve`.

    The result is None if the bytes are damaged.
    """
    try:
        with np.load(BytesIO(packed), allow_pickle=False) as file:
            return WarmStart.from_arrays({name: file[name] for name in file.files})
    except (BadZipFile, EOFError, OSError, TranscriptionError, ValueError):
        return None


def solve_case(task: CaseTask) -> CaseResult:
    """Solve one case of a sweep: plan its flight, or fly the base scenario's plan.

    All sweeps that the commands run use this function as their case solver. The compiled model is
    kept for later cases.
    """
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
    """Simulate a controller that tracks the base scenario's plan in the scenario of a case.

    The case fails if the plan is not verified, or if two integrators disagree on the flight.
    """
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
    """Planner and base scenario's plan that one worker of a sweep keeps from case to case.

    A thread that uses the planner or the plan must hold the mutex `lock`.
    """

    lock: threading.Lock = field(default_factory=threading.Lock)
    planner: Planner = field(default_factory=Planner)
    _base_plans: dict[str, Plan] = field(default_factory=dict)

    def plan(self, scenario: Scenario, warm_start: bytes | None) -> Plan:
        """Plan a case's flight, starting from the solution of its parent if there is one.

        `warm_start` is the solution of the parent, a neighbouring case solved before, packed by
        `pack`. If this gives no verified plan, a new planner solves the case from its own initial
        guess.
        """
        parent = unpack(warm_start) if warm_start is not None else None
        if parent is not None:
            plan = self.planner.solve(scenario, warm_start=parent)
            if plan.is_verified:
                return plan
        self.planner = Planner()
        return self.planner.solve(scenario)

    def base_plan(self, base: Scenario, text: str) -> Plan:
        """Return the plan of the sweep's base scenario, and keep it for the next call.

        `text` is the base scenario as JSON text.
        """
        if text not in self._base_plans:
            self._base_plans = {text: self.plan(base, None)}
        return self._base_plans[text]


_BENCH = _Bench()
