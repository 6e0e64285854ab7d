"""How many of 200 random missions come out verified, infeasible with proof, or lost.

    python -m tests.benchmarks.robustness [--missions N] [--seed S] [--workers N] [--minutes M]

Goals lie within 30 m, up and down; durations from 3 to 30 s; winds up to 6 m/s from anywhere in
both couplings; payloads from 0 to 0.25 kg; every power model that is sound everywhere, which
leaves out `efficiency`: below 858 rad/s it has no minimum to find.  No mission gets a guess.
"""

import argparse
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from time import perf_counter

import numpy as np

from pyomo_quad.flight import Planner, PlanStatus
from pyomo_quad.scenario import load_scenario
from pyomo_quad.scenario.messages import FeasibilityError, PyomoQuadError

BASE = "scenarios/paper_calm.toml"
COUPLINGS = ("acceleration", "drag")
# `constant_efficiency` without credit for braking has a corner at zero power, on which optima
# come to lie: it counts among the models that are sound only with regeneration.
REGENERATION = "power.regeneration=true"
POWER_MODELS = ("motor", "shaft", "constant_efficiency", "motor_with_friction")
FARTHEST_M = 30.0
DURATIONS_S = (3.0, 30.0)
STRONGEST_WIND_M_PER_S = 6.0
HEAVIEST_PAYLOAD_KG = 0.25
VERIFIED, INFEASIBLE, LOST = "verified", "infeasible, proven", "lost"
_PLANNERS: dict[None, Planner] = {}


@dataclass(frozen=True)
class Outcome:
    number: int
    settings: tuple[str, ...]
    verdict: str
    detail: str
    attempts: tuple[str, ...]
    wall_s: float


def missions(count, seed):
    """Draw missions as lists of scenario settings; equal seeds give equal missions."""
    random = np.random.default_rng(seed)
    for number in range(count):
        direction = random.normal(size=3)
        goal = FARTHEST_M * random.uniform() ** (1 / 3) * direction / np.linalg.norm(direction)
        yield (
            f"name='random_{number:03d}'",
            f"mission.goal.position=[{', '.join(f'{x:.3f}' for x in goal)}]",
            f"mission.duration={random.uniform(*DURATIONS_S):.3f}",
            "wind.use='constant'",
            f"wind.speed={random.uniform(0, STRONGEST_WIND_M_PER_S):.3f}",
            f"wind.direction={random.uniform(0, 2 * np.pi):.3f}",
            f"wind.coupling='{COUPLINGS[number % 2]}'",
            f"vehicle.payload={random.uniform(0, HEAVIEST_PAYLOAD_KG):.3f}",
            f"power.model='{POWER_MODELS[random.integers(len(POWER_MODELS))]}'",
            REGENERATION,
        )


def fly(numbered):
    number, settings = numbered
    planner = _PLANNERS.setdefault(None, Planner())
    started = perf_counter()
    try:
        plan = planner.solve(load_scenario(BASE, settings))
    except FeasibilityError as error:
        return Outcome(number, settings, INFEASIBLE, str(error), (), perf_counter() - started)
    except PyomoQuadError as error:
        return Outcome(number, settings, LOST, str(error), (), perf_counter() - started)
    verdict, detail = LOST, f"{plan.status.value}: {plan.message}"
    if plan.status is PlanStatus.VERIFIED:
        verdict, detail = VERIFIED, ""
    elif plan.status is PlanStatus.INFEASIBLE:
        verdict, detail = INFEASIBLE, next(iter(plan.failure.causes()), "")
    return Outcome(number, settings, verdict, detail, plan.attempts, perf_counter() - started)


def table(outcomes):
    counts = Counter(outcome.verdict for outcome in outcomes)
    rescued = sum(bool(o.attempts) for o in outcomes if o.verdict == VERIFIED)
    yield "| outcome | missions | share | median time | 95th percentile |"
    yield "|---|---|---|---|---|"
    for verdict in (VERIFIED, INFEASIBLE, LOST):
        times = [o.wall_s for o in outcomes if o.verdict == verdict]
        middle, high = "-", "-"
        if times:
            middle, high = (f"{t:.1f} s" for t in np.percentile(times, (50, 95)))
        share = counts[verdict] / len(outcomes)
        yield f"| {verdict} | {counts[verdict]} | {share:.1%} | {middle} | {high} |"
    yield ""
    yield f"{rescued} of {counts[VERIFIED]} verified missions needed a fallback."
    for outcome in outcomes:
        if outcome.verdict == LOST or (outcome.verdict == VERIFIED and outcome.attempts):
            tried = "; ".join(outcome.attempts)
            yield f"- {outcome.verdict}: {', '.join(outcome.settings)}: {outcome.detail} ({tried})"


def fly_all(arguments):
    numbered = enumerate(missions(arguments.missions, arguments.seed))
    deadline = perf_counter() + 60.0 * (arguments.minutes or np.inf)
    outcomes = []
    with ProcessPoolExecutor(arguments.workers, mp_context=get_context("spawn")) as pool:
        futures = [pool.submit(fly, mission) for mission in numbered]
        for future in as_completed(futures):
            if future.cancelled():
                continue
            outcome = future.result()
            outcomes.append(outcome)
            if arguments.verbose:
                print(outcome.number, f"{outcome.wall_s:.1f} s", outcome.verdict, outcome.detail)
                print("   ", *outcome.settings[1:], *outcome.attempts, flush=True)
            if perf_counter() > deadline:
                for waiting in futures:
                    waiting.cancel()
    return sorted(outcomes, key=lambda outcome: outcome.number)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--missions", type=int, default=200)
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--verbose", action="store_true", help="A line for each mission.")
    parser.add_argument("--minutes", type=float, help="Begin no mission after this long.")
    arguments = parser.parse_args()
    outcomes = fly_all(arguments)
    print(
        f"Seed {arguments.seed}, the first {len(outcomes)} of {arguments.missions} missions, "
        f"{arguments.workers} workers:\n"
    )
    print("\n".join(table(outcomes)))


if __name__ == "__main__":
    main()
