"""How many random missions come out verified, infeasible with proof, or lost: 200 for each seed.

    python -m tests.benchmarks robustness [--minutes M]

An outcome is written to the results as soon as it is known, and a mission that is there is not
flown again: a run that was stopped goes on where it was.
"""

import json
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from time import perf_counter, process_time

import numpy as np

from pyomo_quad.flight import Planner, PlanStatus
from pyomo_quad.scenario import load_scenario
from pyomo_quad.scenario.messages import FeasibilityError, PyomoQuadError
from tests.benchmarks.report import FOLDER, Table

TITLE = "Robustness"
ABOUT = (
    "Random missions, 200 of each seed: goals within 30 m, up and down; durations from 3 to 30 s; "
    "winds up to 6 m/s from anywhere in both couplings; payloads up to 0.25 kg; every power model "
    "that is sound everywhere, which leaves out `efficiency`: below 858 rad/s it has no minimum to "
    "find. `constant_efficiency` is flown with credit for braking and, by every other mission of "
    "it, without; `motor_with_friction` with a pack that can feed it. No mission gets a guess. "
    "Those that earlier code lost were flown again by later code, the others were not."
)
BASE = "scenarios/paper_calm.toml"
COUPLINGS = ("acceleration", "drag")
POWER_MODELS = ("motor", "shaft", "constant_efficiency", "motor_with_friction")
# Without credit for braking it has a corner at zero power, on which optima come to lie.
KINKED = "constant_efficiency"
# The published friction asks for more power than the vehicle's own three cells in series give.
PACKS = {"motor_with_friction": ("battery.cells_series=8",)}
SEEDS = (2026, 1, 2)
MISSIONS = 200
WORKERS = 2
RESULTS = FOLDER / "robustness.jsonl"
FARTHEST_M = 30.0
DURATIONS_S = (3.0, 30.0)
STRONGEST_WIND_M_PER_S = 6.0
HEAVIEST_PAYLOAD_KG = 0.25
VERIFIED, USABLE, INFEASIBLE, LOST = "verified", "usable", "infeasible, proven", "lost"
VERDICTS = (VERIFIED, USABLE, INFEASIBLE, LOST)
_PLANNERS: dict[None, Planner] = {}


@dataclass(frozen=True)
class Outcome:
    seed: int
    number: int
    settings: tuple[str, ...]
    verdict: str
    detail: str
    attempts: tuple[str, ...]
    processor_s: float
    wall_s: float
    usable_s: float | None = None


def missions(count, seed):
    """Draw missions as tuples of scenario settings; equal seeds give equal missions."""
    random = np.random.default_rng(seed)
    kinked = 0
    for number in range(count):
        direction = random.normal(size=3)
        goal = FARTHEST_M * random.uniform() ** (1 / 3) * direction / np.linalg.norm(direction)
        settings = (
            f"name='random_{number:03d}'",
            f"mission.goal.position=[{', '.join(f'{x:.3f}' for x in goal)}]",
            f"mission.duration={random.uniform(*DURATIONS_S):.3f}",
            "wind.use='constant'",
            f"wind.speed={random.uniform(0, STRONGEST_WIND_M_PER_S):.3f}",
            f"wind.direction={random.uniform(0, 2 * np.pi):.3f}",
            f"wind.coupling='{COUPLINGS[number % 2]}'",
            f"vehicle.payload={random.uniform(0, HEAVIEST_PAYLOAD_KG):.3f}",
        )
        model = POWER_MODELS[random.integers(len(POWER_MODELS))]
        kinked += model == KINKED
        has_credit = model != KINKED or kinked % 2 == 1
        credit = f"power.regeneration={str(has_credit).lower()}"
        pack = PACKS.get(model, ())
        yield (*settings, *pack, f"power.model='{model}'", credit)


def fly(mission, doubt=lambda _plan: "", base=BASE):
    """Fly a mission; a verified or usable plan of which the doubt says something is lost."""
    seed, number, settings = mission
    planner = _PLANNERS.setdefault(None, Planner())
    started, processor = perf_counter(), process_time()
    usable = []

    def show(state):
        if state.has_usable and not usable:
            usable.append(process_time() - processor)

    verdict, detail, attempts = _verdict(planner, base, settings, doubt, show)
    spent = process_time() - processor
    return Outcome(
        seed=seed,
        number=number,
        settings=settings,
        verdict=verdict,
        detail=detail,
        attempts=attempts,
        processor_s=spent,
        wall_s=perf_counter() - started,
        usable_s=(usable or [spent])[0] if verdict in (VERIFIED, USABLE) else None,
    )


def _verdict(planner, base, settings, doubt, show):
    try:
        plan = planner.solve(load_scenario(base, settings), show=show)
    except FeasibilityError as error:
        return INFEASIBLE, str(error), ()
    except PyomoQuadError as error:
        return LOST, str(error), ()
    if plan.status.value in (VERIFIED, USABLE):
        said = doubt(plan)
        return (LOST if said else plan.status.value), said, plan.attempts
    if plan.status is PlanStatus.INFEASIBLE:
        causes = () if plan.failure is None else plan.failure.causes()
        return INFEASIBLE, next(iter(causes), plan.message), plan.attempts
    return LOST, f"{plan.status.value}: {plan.message}", plan.attempts


def outcome_rows(seed, outcomes):
    """Yield a row for each verdict, with processor seconds of its missions."""
    counts = Counter(outcome.verdict for outcome in outcomes)
    for verdict in VERDICTS:
        times = [o.processor_s for o in outcomes if o.verdict == verdict]
        middle, high = "-", "-"
        if times:
            middle, high = (f"{t:.1f}" for t in np.percentile(times, (50, 95)))
        share = counts[verdict] / len(outcomes)
        yield [seed, verdict, counts[verdict], f"{share:.1%}", middle, high]


def stored(results):
    """Return the lines of a results file, each a mapping with a seed and a number."""
    if not results.exists():
        return []
    return [json.loads(line) for line in results.read_text(encoding="utf-8").splitlines()]


def finished(results):
    """Return the outcomes that a results file holds."""
    return [
        Outcome(**line | {key: tuple(line[key]) for key in ("settings", "attempts")})
        for line in stored(results)
    ]


def fly_all(minutes, drawn, results=RESULTS, fly_one=fly, workers=WORKERS):
    """Fly every mission drawn that the results do not hold, and write each down as it ends."""
    known = {(line["seed"], line["number"]) for line in stored(results)}
    wanted = [mission for mission in drawn if mission[:2] not in known]
    deadline = perf_counter() + 60.0 * (np.inf if minutes is None else minutes)
    results.parent.mkdir(parents=True, exist_ok=True)
    with (
        ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool,
        results.open("a", encoding="utf-8") as file,
    ):
        futures = [pool.submit(fly_one, mission) for mission in wanted]
        try:
            for future in as_completed(futures):
                if future.cancelled():
                    continue
                file.write(json.dumps(asdict(future.result())) + "\n")
                file.flush()
                if perf_counter() > deadline:
                    _cancel(futures)
        except BaseException:
            # Otherwise the pool would fly all missions that wait, and lose their outcomes.
            _cancel(futures)
            raise


def _cancel(futures):
    for future in futures:
        future.cancel()


def measure(arguments):
    """Return a table of outcomes for each seed and for all, and the missions to look at."""
    drawn = {seed: enumerate(missions(MISSIONS, seed)) for seed in SEEDS}
    # Seed by seed in turn, so that a run that is stopped has flown as many of each.
    turns = zip(*drawn.values(), strict=True)
    fly_all(
        arguments.minutes,
        [(seed, *told) for turn in turns for seed, told in zip(SEEDS, turn, strict=True)],
    )
    return tables("robustness", SEEDS, RESULTS)


def tables(name, seeds, results):
    """Return what the results hold as tables of a benchmark."""
    flown = sorted(finished(results), key=lambda o: (o.seed, o.number))
    rows = []
    for seed in seeds if len(seeds) == 1 else (*seeds, None):
        outcomes = [o for o in flown if seed is None or o.seed == seed]
        if outcomes:
            rows += outcome_rows("all" if seed is None else seed, outcomes)
    told = [o for o in flown if o.verdict == LOST or (o.verdict == VERIFIED and o.attempts)]
    remarkable = [
        [o.verdict, o.seed, o.number, ", ".join(o.settings[1:]), o.detail, "; ".join(o.attempts)]
        for o in told
    ]
    outcome_header = ["seed", "outcome", "missions", "share", "median s", "95th percentile s"]
    header = ["outcome", "seed", "number", "mission", "what happened", "tried before"]
    return [
        Table(name=name, title="Outcomes", header=outcome_header, rows=rows),
        Table(
            name=f"{name}_remarkable",
            title="Lost, or verified only after a fallback",
            header=header,
            rows=remarkable,
        ),
    ]
