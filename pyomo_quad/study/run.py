"""Run of a scenario: the optimum, every baseline, their comparison and the certificate."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter

import pandas as pd

from pyomo_quad.collocation import Dynamics, EngineError, Progress, Summarised
from pyomo_quad.flight import Flight, Plan, Planner
from pyomo_quad.flight.baselines import OPEN_LOOP, baseline_name, fly_baseline, fly_open_loop
from pyomo_quad.flight.columns import WIND
from pyomo_quad.flight.deadline import Deadline
from pyomo_quad.flight.replanning import fly_replanned, replanned_name
from pyomo_quad.flight.risk import plan_at_risk
from pyomo_quad.flight.routes import SETTLINGS_S, cruise_at
from pyomo_quad.flight.weather import vehicle_flown
from pyomo_quad.scenario import Reference, Scenario, ScenarioError
from pyomo_quad.study.aims import disagreement, energy_and_charge
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
    """Results of a scenario: plan, flights, comparison and certificate.

    Attributes
    ----------
    scenario : Scenario
    plan : Plan
        The optimum, of any status.
    flights : tuple of Flight
        The optimum first; empty if the solve failed.
    comparison : DataFrame
        One row per flight, see `study.comparison`.
    certificate : Certificate
        The lower bound of the mission in the actual wind.
    adaptation : DataFrame or None
        Effect of adaptation in that wind, see `comparison.adaptation_study`; None in calm air.
    front : DataFrame
        Energy against time, see `study.front`; empty if the mission fixes its duration.
    aims : DataFrame
        Least energy against least charge, see `study.aims`; empty under the paper's equations.
    timings : mapping
        Seconds of the plan's phases, of the certificate, of the front, and of flights and cautions
        beyond these.
    warnings : tuple of str
        Cautions about the results, one line each.
    """

    scenario: Scenario
    plan: Plan
    flights: tuple[Flight, ...]
    comparison: pd.DataFrame
    certificate: Certificate
    adaptation: pd.DataFrame | None
    front: pd.DataFrame
    aims: pd.DataFrame
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
        """Largest possible saving over the optimum, in per cent of its energy.

        None if no bound is known, or if the optimum was planned for a forecast of the wind.
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
    """Solve, verify, fly every baseline, compare and certify.

    A solve or a flight that fails is part of the result, not an exception.  On Linux copies of the
    process fly on all cores if BLAS has one thread (`OMP_NUM_THREADS=1`, as the commands set it).

    Parameters
    ----------
    progress : callable, optional
        Called at each Ipopt iteration; returning False stops the solve. The run ends after
        `solver.time_limit`; flights that are missing by then become warnings.
    meanwhile : callable, optional
        Called once during the flights, for instance to import modules of the report.
    """
    references = scenario.baseline.references if baselines is None else tuple(baselines)
    with Deadline(scenario):
        return _run(scenario, planner or Planner(), references, progress, meanwhile)


def _run(
    scenario: Scenario,
    planner: Planner,
    references: Sequence[Reference],
    progress: Progress | None,
    meanwhile: Callable[[], object],
) -> RunResult:
    plan = plan_at_risk(scenario, planner, progress=progress)
    began = perf_counter()
    mission, dynamics = plan.mission_flown, vehicle_flown(planner, plan.mission_flown)
    tried = [*_baselines(mission, plan, planner, references)] if plan.verification else []
    optimum = plan.flight(OPTIMAL) if plan.verification else None
    # The slowest flights are listed last, so tasks begin with them.
    tasks: tuple[Callable[[], object], ...] = (
        *(partial(_flight_or_reason, name, fly) for name, fly in reversed(tried)),
        partial(_adaptation, mission, optimum, dynamics),
        partial(plan_cautions, plan, planner=planner),
    )
    with side_by_side(tasks) as finish:
        here = perf_counter()
        certificate = certify(scenario, planner=planner)
        certified = perf_counter()
        front = energy_time_front(plan, planner=planner, progress=progress)
        aims = energy_and_charge(plan, planner=planner, progress=progress)
        swept = perf_counter()
        meanwhile()
        helping = perf_counter()
        *flown, adaptation, cautions = finish()
    flown.reverse()
    completed = tuple(flight for flight in flown if isinstance(flight, Flight))
    flights = () if optimum is None else (optimum, *completed)
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
        aims=aims,
        timings={
            **plan.timings,
            "fly": (ended - began) - (helping - here),
            "certify": certified - here,
            "front": swept - certified,
        },
        warnings=(
            *cautions,
            *disagreement(aims),
            *(why for why in flown if isinstance(why, str)),
            *(f"{f.name}: not confirmed: {f.doubt}." for f in flights if f.doubt),
        ),
    )


def _priced(
    flights: tuple[Flight, ...], scenario: Scenario, planner: Planner, progress: Progress | None
) -> tuple[Flight, ...]:
    """Return the flights with the energy that their end states owe in the actual wind.

    A plan for a forecast prices end states in that forecast; the other flights need the end prices
    of a plan for the actual wind.
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
    """Return the flights with and without adaptation; None in calm air or if one fails."""
    if optimum is None or not set(WIND) <= set(optimum.frame):
        return None
    if not optimum.frame[list(WIND)].to_numpy().any():
        return None
    try:
        return adaptation_study(scenario, dynamics=dynamics)
    except EngineError:
        return None


def _flight_or_reason(name: str, fly: Callable[[], Flight]) -> Flight | str:
    try:
        return fly()
    except (EngineError, ScenarioError) as error:
        return f"{name} could not be flown: {error}"


def _baselines(
    scenario: Scenario, plan: Plan, planner: Planner, references: Sequence[Reference]
) -> Iterator[tuple[str, Callable[[], Flight]]]:
    dynamics = vehicle_flown(planner, scenario)
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
    """Fly the mission as an autopilot does: at a cruise speed, in the time that it takes.

    ``speed`` None is the cruise speed of the scenario.  The flight waits at the goal until it has
    arrived, at most the last of `SETTLINGS_S`.
    """
    for settling_s in SETTLINGS_S:
        told = cruise_at(scenario, speed, settling_s)
        flight = fly_baseline(
            told, Reference.CRUISE, dynamics=vehicle_flown(planner, told), plan=plan
        )
        if has_arrived(flight):
            break
    return flight
