"""All live results of the paper's report, computed by worker processes."""

from collections.abc import Callable, Iterator
from concurrent.futures import Future, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import Any

from numpy.typing import NDArray

from pyomo_quad.paper.experiments import (
    BaselineFlight,
    PaperFlight,
    Reading,
    TrialOutcome,
    baseline_cases,
    battery_cases,
    flight_cases,
    fly_baseline_case,
    fly_case,
    mesh_trials,
    run_trial,
    wind_cases,
)
from pyomo_quad.paper.floors import (
    EfficiencyMap,
    PackFacts,
    chattering_floors,
    critical_acceleration,
    pack_facts,
    sample_efficiency_map,
)
from pyomo_quad.study.processes import process_pool

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
