"""Computation of all results of the report on a paper of Yacef et al., in two worker processes.

The report states which results of their paper on energy-efficient path planning are reproduced.
The paper has two experiments, one in calm air and one in wind.
"""

from collections.abc import Callable
from concurrent.futures import as_completed
from dataclasses import dataclass
from functools import partial
from itertools import product
from time import perf_counter
from typing import Any, NamedTuple

from pyomo_quad.arrays import FloatArray
from pyomo_quad.flight import Planner
from pyomo_quad.flight.steady import battery_shortfalls
from pyomo_quad.paper import experiments
from pyomo_quad.paper.readings import Reading, TrialOutcome, mesh_trials, run_trial
from pyomo_quad.paper.rotor_map import (
    EfficiencyMap,
    chattering_floors,
    critical_acceleration,
    sample_efficiency_map,
)
from pyomo_quad.processes import process_pool
from pyomo_quad.scenario import PowerModel

# Fraction of the charge up to which the stored energy is counted, because the model's voltage falls
# without bound as the charge runs out.
_DEEPEST_DISCHARGE = 0.99
_SAMPLES = 400
# Batteries of the study: the single cell that the paper prints, this cell in series as in the
# library, and the battery of the vehicle's maker.
_PACKS: tuple[tuple[str, dict[str, int]], ...] = (
    (experiments.PAPER_CELL, {"battery.cells_series": 1, "battery.cells_parallel": 1}),
    (experiments.PAPER_CELL, {}),
    (experiments.PHANTOM_PACK, {}),
)


@dataclass(frozen=True, kw_only=True)
class PackFacts:
    """Energy and greatest power of a battery pack, compared with hovering.

    Attributes
    ----------
    battery : str
        Name of the battery in the package's library.
    cells_series, cells_parallel : int
        Cells in series, and parallel strings of such cells.
    power_model : PowerModel
        Power model of the hover.
    stored_energy_J : float
        Integral of the open-circuit voltage over the charge, from full to 1 %.
    hover_energy_J, hover_power_W : float
        Energy and power of a hover of the mission's duration.
    greatest_power_W : float
        Greatest power of the pack at the start.
    shortfalls : tuple of str
        Reasons why the pack cannot supply the hover.
    """

    battery: str
    cells_series: int
    cells_parallel: int
    power_model: PowerModel
    stored_energy_J: float
    hover_energy_J: float
    hover_power_W: float
    greatest_power_W: float
    shortfalls: tuple[str, ...]


def pack_facts() -> tuple[PackFacts, ...]:
    """Compare energy and power of three battery packs with those that a hover needs.

    The hover lasts as long as the flight of the paper's experiment in calm air. The power models
    are `MOTOR` and `EFFICIENCY`. The result has one entry for each power model and pack.
    """
    planner = Planner()
    cases = product((PowerModel.MOTOR, PowerModel.EFFICIENCY), _PACKS)
    return tuple(_facts(planner, model, name, cells) for model, (name, cells) in cases)


def _facts(planner: Planner, model: PowerModel, name: str, cells: dict[str, int]) -> PackFacts:
    scenario = experiments.paper_scenario(
        experiments.Experiment.CALM, {"power.model": model, "battery.use": name} | cells
    )
    steady = planner.steady_flight(scenario)
    return PackFacts(
        battery=name,
        cells_series=scenario.battery.cells_series,
        cells_parallel=scenario.battery.cells_parallel,
        power_model=model,
        stored_energy_J=steady.stored_energy(_DEEPEST_DISCHARGE, _SAMPLES),
        hover_energy_J=steady.hover.power_W * scenario.mission.fixed_duration,
        hover_power_W=steady.hover.power_W,
        greatest_power_W=steady.hover.greatest_battery_power_W,
        shortfalls=battery_shortfalls(scenario, steady),
    )


#: Function that shows the progress of a study: it receives the name of a finished result, the
#: number of results so far, and the number of all results.
Step = Callable[[str, int, int], None]

WORKERS = 2


@dataclass(frozen=True, kw_only=True)
class PaperStudy:
    """All results of the study that reproduces the experiments of Yacef et al.

    Attributes
    ----------
    flights : tuple of PaperFlight
        Flights of `flight_cases`.
    wind_flights : tuple of PaperFlight
        Flights of `wind_cases`.
    battery_flights : tuple of PaperFlight
        Flights of `battery_cases`.
    baselines : tuple of BaselineFlight
        Flights of both experiments under the adaptive controller.
    packs : tuple of PackFacts
        Energy and greatest power of each battery, beside those that a hover needs.
    floors : dict
        Result of `chattering_floors` for each interpretation of the efficiency f_r.
    critical_acceleration, critical_speed : float
        Result of `critical_acceleration` [rad/s², rad/s].
    efficiency_map : EfficiencyMap
        f_r over rotor speed and torque.
    trials : tuple of TrialOutcome
        Solves under f_r on fixed meshes.
    seconds : dict
        Wall time of each result [s], by "part: name", such as "critical: zeros of f_r".
    """

    flights: tuple[experiments.PaperFlight, ...]
    wind_flights: tuple[experiments.PaperFlight, ...]
    battery_flights: tuple[experiments.PaperFlight, ...]
    baselines: tuple[experiments.BaselineFlight, ...]
    packs: tuple[PackFacts, ...]
    floors: dict[Reading, FloatArray]
    critical_acceleration: float
    critical_speed: float
    efficiency_map: EfficiencyMap
    trials: tuple[TrialOutcome, ...]
    seconds: dict[str, float]


class _Task(NamedTuple):
    part: str
    name: str
    perform: Callable[[], Any]


def run_paper_study(*, is_quick: bool = False, step: Step | None = None) -> PaperStudy:
    """Compute all results of the study of Yacef et al. in two worker processes.

    If `is_quick` is true, meshes are coarse and fewer. After each result, `step` is called with its
    name, the number of results so far and the number of all results.
    """
    tasks = _tasks(is_quick=is_quick)
    results: list[Any] = [None] * len(tasks)
    seconds: dict[str, float] = {}
    with process_pool(WORKERS) as pool:
        futures = {pool.submit(_timed, task.perform): at for at, task in enumerate(tasks)}
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
    families: tuple[tuple[str, Any, Callable[[Any], Any]], ...] = (
        ("flights", experiments.flight_cases, experiments.fly_case),
        ("wind_flights", experiments.wind_cases, experiments.fly_case),
        ("battery_flights", experiments.battery_cases, experiments.fly_case),
        ("baselines", experiments.baseline_cases, experiments.fly_baseline_case),
        ("trials", mesh_trials, run_trial),
    )
    return [
        *(
            _Task(part, case.title, partial(perform, case))
            for part, cases, perform in families
            for case in cases(is_quick=is_quick)
        ),
        *(_Task("floors", f"floor, {r.value} f_r", partial(chattering_floors, r)) for r in Reading),
        _Task("critical", "zeros of f_r", critical_acceleration),
        _Task("efficiency_map", "efficiency map", sample_efficiency_map),
        _Task("packs", "batteries", pack_facts),
    ]


def _study(parts: dict[str, list[Any]], seconds: dict[str, float]) -> PaperStudy:
    single = ("critical", "packs", "efficiency_map")
    (bound, speed), packs, sampled = (parts.pop(part)[0] for part in single)
    return PaperStudy(
        floors=dict(zip(Reading, parts.pop("floors"), strict=True)),
        critical_acceleration=bound,
        critical_speed=speed,
        packs=packs,
        efficiency_map=sampled,
        seconds=seconds,
        **{part: tuple(results) for part, results in parts.items()},
    )


def _timed(perform: Callable[[], Any]) -> tuple[Any, float]:
    started = perf_counter()
    result = perform()
    return result, perf_counter() - started
