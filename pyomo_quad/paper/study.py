"""All live results of the paper's report, computed by worker processes.

Among them are the least energy under f_r, the map of f_r, and what the batteries hold and deliver.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import Future, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import product
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pyomo_quad.collocation import Dynamics
from pyomo_quad.flight import Planner
from pyomo_quad.flight.columns import ROTORS
from pyomo_quad.flight.steady import battery_shortfalls
from pyomo_quad.paper.experiments import (
    PAPER_CELL,
    PHANTOM_PACK,
    BaselineFlight,
    Experiment,
    PaperFlight,
    Reading,
    TrialOutcome,
    baseline_cases,
    battery_cases,
    flight_cases,
    fly_baseline_case,
    fly_case,
    mesh_trials,
    paper_scenario,
    run_trial,
    wind_cases,
)
from pyomo_quad.scenario import PowerModel, Scenario
from pyomo_quad.study.processes import process_pool

_DEEPEST_DISCHARGE = 0.99
_SAMPLES = 400
# The cell as printed, cells in series as the library puts them, and the vehicle's pack.
_PACKS: tuple[tuple[str, dict[str, int]], ...] = (
    (PAPER_CELL, {"battery.cells_series": 1, "battery.cells_parallel": 1}),
    (PAPER_CELL, {}),
    (PHANTOM_PACK, {}),
)


@dataclass(frozen=True, kw_only=True)
class PackFacts:
    """A pack, and the hover that it is asked for.

    Attributes
    ----------
    stored_energy_J : float
        Down to one hundredth of the charge, without load.
    shortfalls : tuple of str
        What the pack lacks for hovering through the mission, one line each.
    """

    battery: str
    cells_series: int
    cells_parallel: int
    power_model: PowerModel
    stored_energy_J: float
    hover_power_W: float
    greatest_power_W: float
    hover_energy_J: float
    shortfalls: tuple[str, ...]


def pack_facts() -> tuple[PackFacts, ...]:
    """Return the packs under the motor's power and under f_r."""
    models = (PowerModel.MOTOR, PowerModel.EFFICIENCY)
    planner = Planner()
    return tuple(
        _facts(planner, model, name, cells) for model, (name, cells) in product(models, _PACKS)
    )


def _facts(planner: Planner, model: PowerModel, name: str, cells: dict[str, int]) -> PackFacts:
    scenario = paper_scenario(Experiment.CALM, {"power.model": model, "battery.use": name} | cells)
    steady = planner.steady_flight(scenario)
    at_hover = steady.hover
    return PackFacts(
        battery=name,
        cells_series=scenario.battery.cells_series,
        cells_parallel=scenario.battery.cells_parallel,
        power_model=model,
        stored_energy_J=steady.stored_energy(_DEEPEST_DISCHARGE, _SAMPLES),
        hover_power_W=at_hover.power_W,
        greatest_power_W=at_hover.greatest_battery_power_W,
        hover_energy_J=at_hover.power_W * scenario.mission.fixed_duration,
        shortfalls=battery_shortfalls(scenario, steady),
    )


FloatArray = NDArray[np.float64]

#: Bounds on the rotor acceleration at which the floors are taken, rad/s².
BOUNDS = (10, 30, 100, 200, 300, 500, 600, 700, 800, 900, 1000, 1100, 1150, 1250, 1500, 2000, 3000)
_HIGHER_BOUNDS = (5000, 7500, 10000, 20000)
_SPEEDS = 141
_ACCELERATIONS = 90
_SMALLEST_ACCELERATION = 1.0


@dataclass(frozen=True, kw_only=True)
class RotorMap:
    """Power and efficiency of one rotor, sampled.

    Attributes
    ----------
    speed : ndarray, shape (n,)
        rad/s, rising from 0.
    acceleration : ndarray, shape (k,)
        rad/s², rising, symmetric about 0.
    thrust : ndarray, shape (n,)
        Of one rotor, N.
    torque, power : ndarray, shape (n, k)
        N m and W.
    efficiency : ndarray, shape (n, k)
        f_r without floors where the model has one, else one.
    """

    speed: FloatArray
    acceleration: FloatArray
    thrust: FloatArray
    torque: FloatArray
    power: FloatArray
    efficiency: FloatArray


def rotor_map(
    dynamics: Dynamics, speed: FloatArray, acceleration: FloatArray, efficiency: str | None
) -> RotorMap:
    """Sample the declared power of one rotor.

    Parameters
    ----------
    speed, acceleration : ndarray
        rad/s and rad/s².
    """
    count = speed.size * acceleration.size
    states = np.zeros((count, len(dynamics.state_names)))
    controls = np.zeros((count, len(dynamics.control_names)))
    speeds, accelerations = np.meshgrid(speed, acceleration, indexing="ij")
    for rotor in ROTORS:
        states[:, dynamics.state_names.index(f"rotors.omega[{rotor}]")] = speeds.ravel()
        controls[:, dynamics.control_names.index(f"rotors.alpha[{rotor}]")] = accelerations.ravel()
    first = ROTORS[0]
    keys = [("rotors.total_thrust", None), ("rotors.motor_torque", first)]
    keys += [("power.rotor_power", first)]
    keys += [] if efficiency is None else [(efficiency, first)]
    table = dynamics.table(tuple(keys), np.zeros(count), states, controls)
    grids = [column.reshape(speeds.shape) for column in table.T]
    return RotorMap(
        speed=speed,
        acceleration=acceleration,
        thrust=grids[0][:, 0] / len(ROTORS),
        torque=grids[1],
        power=grids[2],
        efficiency=grids[3] if efficiency is not None else np.ones_like(grids[2]),
    )


def envelope_at(x: FloatArray, y: FloatArray, at: float) -> FloatArray:
    """Return the convex envelope of sampled functions at one place.

    Parameters
    ----------
    x : ndarray, shape (k,)
        Rising.
    y : ndarray, shape (..., k)
        Values of one or more functions.
    at : float
        Between the ends of x.

    Returns
    -------
    ndarray, shape (...)
        The least chord over the place.
    """
    left, right = x <= at, x >= at
    width = x[right][None, :] - x[left][:, None]
    share = np.divide(at - x[left][:, None], width, out=np.zeros_like(width), where=width > 0)
    chords = y[..., left][..., :, None] * (1 - share) + y[..., right][..., None, :] * share
    return chords.min(axis=(-2, -1))


def chattering_floors(
    reading: Reading, bounds: tuple[float, ...] = BOUNDS + _HIGHER_BOUNDS
) -> FloatArray:
    """Return the least energy of any flight of the paper's mission.

    Parameters
    ----------
    bounds : tuple of float
        Bounds on the rotor acceleration, rad/s².

    Returns
    -------
    ndarray, shape (len(bounds), 2)
        Bound and energy [J], minus infinity where f_r passes zero.
    """
    scenario = paper_scenario(Experiment.CALM, reading.values())
    smallest, largest = _SMALLEST_ACCELERATION, max(bounds)
    upward = np.union1d(np.geomspace(smallest, largest, _ACCELERATIONS), bounds)
    sampled = rotor_map(
        reading.planner().dynamics(scenario),
        np.linspace(0.0, scenario.limits.rotor_speed_max, _SPEEDS),
        np.concatenate([-upward[::-1], [0.0], upward]),
        "power.drive_efficiency",
    )
    return np.array([[bound, floor_energy(scenario, sampled, bound)] for bound in bounds])


def floor_energy(scenario: Scenario, sampled: RotorMap, bound: float) -> float:
    """Return the least energy of a flight whose rotors accelerate no faster than a bound.

    Parameters
    ----------
    bound : float
        rad/s².

    Returns
    -------
    float
        J.
    """
    allowed = np.abs(sampled.acceleration) <= bound
    if sampled.efficiency[:, allowed].min() <= 0.0:
        return -np.inf
    steady = envelope_at(sampled.acceleration[allowed], sampled.power[:, allowed], 0.0)
    weight = scenario.vehicle.total_mass * scenario.gravity
    least = envelope_at(sampled.thrust, steady, weight / len(ROTORS))
    return float(least) * len(ROTORS) * scenario.mission.fixed_duration


def critical_acceleration(samples: int = 151) -> tuple[float, float]:
    """Return where f_r first passes zero as the bound on the acceleration grows.

    Parameters
    ----------
    samples : int
        Of speed, and of acceleration between the two bounds that enclose the zero.

    Returns
    -------
    bound, speed : float
        Smallest |alpha| [rad/s²] with f_r = 0, and the rotor speed [rad/s] there.
    """
    scenario = paper_scenario(Experiment.CALM, Reading.LITERAL.values())
    dynamics = Reading.LITERAL.planner().dynamics(scenario)
    speed = np.linspace(0.0, scenario.limits.rotor_speed_max, samples)
    braking = -np.linspace(0.0, max(BOUNDS), samples)[::-1]
    sampled = rotor_map(dynamics, speed, braking, "power.efficiency_polynomial")
    zeros = [
        np.interp(0.0, row[last : last + 2], braking[last : last + 2])
        if (last := _last_negative(row)) >= 0
        else -np.inf
        for row in sampled.efficiency
    ]
    nearest = int(np.argmax(zeros))
    return -float(zeros[nearest]), float(speed[nearest])


def _last_negative(row: FloatArray) -> int:
    below = np.flatnonzero(row <= 0.0)
    return int(below[-1]) if below.size else -1


_MAP_SPEEDS = 106
_TORQUES = 101
#: Torques that the picture shows, N m: braking hard to accelerating hard.
TORQUE_RANGE = (-0.12, 0.14)


@dataclass(frozen=True, kw_only=True)
class EfficiencyMap:
    """f_r without floors on a grid.

    Attributes
    ----------
    speed : ndarray, shape (n,)
        rad/s.
    torque : ndarray, shape (k,)
        N m.
    efficiency : ndarray, shape (n, k)
        Negative where the polynomial is.
    steady_torque : ndarray, shape (n,)
        Torque of a rotor that does not accelerate, N m.
    """

    speed: FloatArray
    torque: FloatArray
    efficiency: FloatArray
    steady_torque: FloatArray


def sample_efficiency_map() -> EfficiencyMap:
    """Sample the recovered f_r as declared."""
    scenario = paper_scenario(Experiment.CALM, Reading.LITERAL.values())
    dynamics = Reading.LITERAL.planner().dynamics(scenario)
    speed = np.linspace(0.0, scenario.limits.rotor_speed_max, _MAP_SPEEDS)
    steady = rotor_map(dynamics, speed, np.zeros(1), None).torque[:, 0]
    torque = np.linspace(*TORQUE_RANGE, _TORQUES)
    efficiency = np.empty((speed.size, torque.size))
    inertia = scenario.vehicle.rotor_inertia
    for row, (one, drag) in enumerate(zip(speed, steady, strict=True)):
        # Eq. (1) is linear in the acceleration, so each torque belongs to one acceleration.
        alpha = (torque - drag) / inertia
        efficiency[row] = rotor_map(
            dynamics, np.array([one]), alpha, "power.efficiency_polynomial"
        ).efficiency[0]
    return EfficiencyMap(speed=speed, torque=torque, efficiency=efficiency, steady_torque=steady)


#: Called with the name of what has ended, how much has ended, and how much there is.
Step = Callable[[str, int, int], None]

WORKERS = 2


@dataclass(frozen=True, kw_only=True)
class PaperStudy:
    """Everything the report shows.

    Attributes
    ----------
    flights, wind_flights, battery_flights : tuple of PaperFlight
        Both experiments under every power model; the second in every reading of the wind; the
        first with both batteries.
    floors : mapping
        Reading of f_r -> bounds on the rotor acceleration and least energies.
    critical_acceleration, critical_speed : float
        Where f_r first passes zero, rad/s² and rad/s.
    seconds : mapping
        Name of each part -> wall time.
    """

    flights: tuple[PaperFlight, ...]
    wind_flights: tuple[PaperFlight, ...]
    battery_flights: tuple[PaperFlight, ...]
    baselines: tuple[BaselineFlight, ...]
    packs: tuple[PackFacts, ...]
    floors: dict[Reading, NDArray[Any]]
    critical_acceleration: float
    critical_speed: float
    efficiency_map: EfficiencyMap
    trials: tuple[TrialOutcome, ...]
    seconds: dict[str, float]


@dataclass(frozen=True, kw_only=True)
class _Task:
    part: str
    name: str
    perform: Callable[[], Any]


def run_paper_study(*, is_quick: bool = False, step: Step | None = None) -> PaperStudy:
    """Compute all results, two at a time.

    Parameters
    ----------
    step : callable, optional
        Told of each result as it arrives.
    """
    tasks = _tasks(is_quick=is_quick)
    results: list[Any] = [None] * len(tasks)
    seconds: dict[str, float] = {}
    with _started(tasks) as futures:
        for done, future in enumerate(as_completed(futures), start=1):
            at = futures[future]
            results[at], taken = future.result()
            seconds[f"{tasks[at].part}: {tasks[at].name}"] = taken
            if step is not None:
                step(tasks[at].name, done, len(tasks))
    parts: dict[str, list[Any]] = {}
    for task, result in zip(tasks, results, strict=True):
        parts.setdefault(task.part, []).append(result)
    return _study(parts, dict(sorted(seconds.items())))


def _tasks(*, is_quick: bool) -> list[_Task]:
    flights = {
        "flights": flight_cases(is_quick=is_quick),
        "wind_flights": wind_cases(is_quick=is_quick),
        "battery_flights": battery_cases(is_quick=is_quick),
    }
    tasks = [
        _Task(part=part, name=case.title, perform=partial(fly_case, case))
        for part, cases in flights.items()
        for case in cases
    ]
    tasks += [
        _Task(part="baselines", name=case.title, perform=partial(fly_baseline_case, case))
        for case in baseline_cases(is_quick=is_quick)
    ]
    tasks += [
        _Task(part="trials", name=trial.title, perform=partial(run_trial, trial))
        for trial in mesh_trials(is_quick=is_quick)
    ]
    tasks += [
        _Task(part="floors", name=f"floor, {r.value} f_r", perform=partial(chattering_floors, r))
        for r in Reading
    ]
    tasks += [
        _Task(part="critical", name="zeros of f_r", perform=critical_acceleration),
        _Task(part="efficiency_map", name="efficiency map", perform=sample_efficiency_map),
        _Task(part="packs", name="batteries", perform=pack_facts),
    ]
    return tasks


def _study(parts: dict[str, list[Any]], seconds: dict[str, float]) -> PaperStudy:
    (bound, speed), (packs,), (sampled,) = (
        parts["critical"][0],
        parts["packs"],
        parts["efficiency_map"],
    )
    return PaperStudy(
        flights=tuple(parts["flights"]),
        wind_flights=tuple(parts["wind_flights"]),
        battery_flights=tuple(parts["battery_flights"]),
        baselines=tuple(parts["baselines"]),
        packs=packs,
        floors=dict(zip(Reading, parts["floors"], strict=True)),
        critical_acceleration=bound,
        critical_speed=speed,
        efficiency_map=sampled,
        trials=tuple(parts["trials"]),
        seconds=seconds,
    )


def _timed(perform: Callable[[], Any]) -> tuple[Any, float]:
    started = perf_counter()
    result = perform()
    return result, perf_counter() - started


@contextmanager
def _started(tasks: list[_Task]) -> Iterator[dict[Future[Any], int]]:
    """Start all tasks in processes of their own, and leave none behind."""
    with process_pool(WORKERS) as pool:
        yield {pool.submit(_timed, task.perform): at for at, task in enumerate(tasks)}
