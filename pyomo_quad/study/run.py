"""One run of a scenario: the optimum, every baseline, the comparison and the certificate."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter

import pandas as pd

from pyomo_quad.collocation import Dynamics, EngineError, Progress, Summarised
from pyomo_quad.flight import Flight, Plan, Planner
from pyomo_quad.flight.baselines import OPEN_LOOP, baseline_name, fly_baseline, fly_open_loop
from pyomo_quad.flight.columns import WIND
from pyomo_quad.flight.replanning import fly_replanned, replanned_name
from pyomo_quad.flight.routes import SETTLINGS_S, cruise_at
from pyomo_quad.scenario import Reference, Scenario, ScenarioError
from pyomo_quad.study.certificate import Certificate, certify
from pyomo_quad.study.check import plan_cautions
from pyomo_quad.study.comparison import (
    OPTIMAL,
    adaptation_study,
    combine,
    compare_flights,
    has_arrived,
)
from pyomo_quad.study.front import energy_time_front
from pyomo_quad.study.processes import side_by_side


@dataclass(frozen=True, kw_only=True, repr=False)
class RunResult(Summarised):
    """All there is to report of a scenario.

    Attributes
    ----------
    scenario : Scenario
    plan : Plan
        Of any status.
    flights : tuple of Flight
        The optimum first; empty where the solve failed.
    comparison : DataFrame
        One row per flight, see `study.comparison`.
    certificate : Certificate
        Of the mission in the wind that really blows.
    adaptation : DataFrame or None
        Effect of the adaptation in that wind, see `comparison.adaptation_study`; None in calm air.
    front : DataFrame
        Energy against time, see `study.front`; no rows where the mission fixes its duration.
    timings : mapping
        Seconds of the plan's phases, of the certificate and of the front, and those that flights
        and cautions add to them.
    warnings : tuple of str
        What a reader should know beside the numbers, one line each.
    """

    scenario: Scenario
    plan: Plan
    flights: tuple[Flight, ...]
    comparison: pd.DataFrame
    certificate: Certificate
    adaptation: pd.DataFrame | None
    front: pd.DataFrame
    timings: Mapping[str, float]
    warnings: tuple[str, ...]

    @property
    def summary(self) -> dict[str, str]:
        """Scenario, status, the energy of each flight and the bound."""
        bound = self.certificate.lower_bound_J
        return {
            "scenario": self.scenario.name,
            "status": self.plan.status.value,
            **{flight.name: f"{flight.energy_J:.2f} J" for flight in self.flights},
            "no flight below": "unknown" if bound is None else f"{bound:.2f} J",
        }

    @property
    def gap_percent(self) -> float | None:
        """By how much any flight could undercut the optimum, in per cent of it.

        None where no bound is known, or the optimum was made for a wind that does not blow.
        """
        if not self.flights or self.scenario.wind.forecast is not None:
            return None
        return self.certificate.gap_percent(self.plan.energy)


def run_scenario(
    scenario: Scenario,
    *,
    planner: Planner | None = None,
    baselines: Sequence[Reference] | None = None,
    progress: Progress | None = None,
    meanwhile: Callable[[], object] = lambda: None,
) -> RunResult:
    """Solve, verify, fly every baseline, compare and certify; a failure of these is a result.

    On Linux flights go on all cores if the environment keeps BLAS to one thread, by
    `OMP_NUM_THREADS=1`, as the commands do: by copies of the process.

    Parameters
    ----------
    progress : callable, optional
        Called at each Ipopt iteration; returning False stops the solve.
    meanwhile : callable, optional
        Called once while others fly, such as to import what the report needs.
    """
    planner = planner or Planner()
    references = scenario.baseline.references if baselines is None else tuple(baselines)
    plan = planner.solve(scenario, progress=progress)
    began = perf_counter()
    mission, dynamics = plan.mission_flown, planner.dynamics(plan.mission_flown)
    tried = [*_baselines(mission, plan, planner, references)] if plan.verification else []
    optimum = plan.flight(OPTIMAL) if plan.verification else None
    # The flights that take longest are the last that are listed, and are begun first.
    tasks: tuple[Callable[[], object], ...] = (
        *(partial(_flown_or_why_not, name, fly) for name, fly in reversed(tried)),
        partial(_adaptation, mission, optimum, dynamics),
        partial(plan_cautions, plan, planner=planner),
    )
    with side_by_side(tasks) as finish:
        here = perf_counter()
        certificate = certify(scenario, planner=planner)
        certified = perf_counter()
        front = energy_time_front(plan, planner=planner, progress=progress)
        swept = perf_counter()
        meanwhile()
        helping = perf_counter()
        *flown, adaptation, cautions = finish()
    flown.reverse()
    came_about = tuple(flight for flight in flown if isinstance(flight, Flight))
    flights = () if optimum is None else (optimum, *came_about)
    flights = _priced(flights, mission, planner, progress)
    ended = perf_counter()
    comparison = combine([])
    if flights:
        comparison = compare_flights(mission, flights, certificate, plan.hover_energy_J)
    return RunResult(
        scenario=scenario,
        plan=plan,
        flights=flights,
        comparison=comparison,
        certificate=certificate,
        adaptation=adaptation,
        front=front,
        timings={
            **plan.timings,
            "fly": (ended - began) - (helping - here),
            "certify": certified - here,
            "front": swept - certified,
        },
        warnings=(
            *cautions,
            *(why for why in flown if isinstance(why, str)),
            *(f"{f.name}: not confirmed: {f.doubt}." for f in flights if f.doubt),
        ),
    )


def _priced(
    flights: tuple[Flight, ...], scenario: Scenario, planner: Planner, progress: Progress | None
) -> tuple[Flight, ...]:
    """Return the flights with what their ends owe in the wind that blows.

    A plan made for a forecast prices the ends of flights in that forecast; the others need the
    optimum of one who was told.
    """
    if scenario.wind.forecast is None or not flights:
        return flights
    told = planner.solve(scenario.as_it_blows(), progress=progress)
    prices = told.end_prices if told.verification is not None else {}
    optimum, *others = flights
    return (optimum, *(flight.priced(prices) for flight in others))


def _adaptation(
    scenario: Scenario, optimum: Flight | None, dynamics: Dynamics
) -> pd.DataFrame | None:
    """Return the flights with adaptation and without, where a wind blows and both come about."""
    if optimum is None or not set(WIND) <= set(optimum.frame):
        return None
    if not optimum.frame[list(WIND)].to_numpy().any():
        return None
    try:
        return adaptation_study(scenario, dynamics=dynamics)
    except EngineError:
        return None


def _flown_or_why_not(name: str, fly: Callable[[], Flight]) -> Flight | str:
    try:
        return fly()
    except (EngineError, ScenarioError) as error:
        return f"{name} could not be flown: {error}"


def _baselines(
    scenario: Scenario, plan: Plan, planner: Planner, references: Sequence[Reference]
) -> Iterator[tuple[str, Callable[[], Flight]]]:
    dynamics = planner.dynamics(scenario)
    for speed in scenario.baseline.cruise_speeds or () if Reference.CRUISE in references else ():
        yield (
            baseline_name(Reference.CRUISE, speed),
            partial(fly_cruise, scenario, speed, plan, planner),
        )
    for reference in references:
        if reference is Reference.CRUISE:
            continue
        yield (
            baseline_name(reference),
            partial(fly_baseline, scenario, reference, dynamics=dynamics, plan=plan),
        )
    for knowledge in () if scenario.baseline.mpc is None else scenario.baseline.mpc.knowledge:
        told = partial(fly_replanned, scenario, knowledge, dynamics=dynamics, planner=planner)
        yield replanned_name(knowledge), partial(told, plan=plan)
    yield OPEN_LOOP, partial(fly_open_loop, scenario, plan, dynamics)


def fly_cruise(
    scenario: Scenario, speed: float | None, plan: Plan | None, planner: Planner
) -> Flight:
    """Fly the mission as an autopilot would, at a speed or the one it has, in its own time.

    It waits at the goal until it has arrived there, or has waited longest.
    """
    for settling_s in SETTLINGS_S:
        told = cruise_at(scenario, speed, settling_s)
        flight = fly_baseline(told, Reference.CRUISE, dynamics=planner.dynamics(told), plan=plan)
        if has_arrived(flight):
            break
    return flight
