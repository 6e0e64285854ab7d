"""Missions planned again in flight by a vehicle and in a wind that are not what was believed.

    python -m tests.benchmarks mpc [--minutes M]

A flight is written to the results as it ends, and one that is there is not flown again.
"""

import json
from dataclasses import asdict, dataclass
from time import perf_counter

import numpy as np

from pyomo_quad.collocation import SolveError
from pyomo_quad.flight import Planner
from pyomo_quad.flight.baselines import fly_baseline
from pyomo_quad.flight.replanning import fly_replanned
from pyomo_quad.scenario import load_scenario
from pyomo_quad.scenario.tables import Knowledge, Reference
from pyomo_quad.study.comparison import has_arrived
from tests.benchmarks.report import FOLDER, Table

TITLE = "Re-planning in flight"
ABOUT = (
    "The mission of paper_wind, planned again every 0.2 s by a vehicle that believes it is that of "
    "the scenario in the wind of Table 2. What flies has a mass up to 10 % off, the gusts of "
    "another time and up to 1.5 times as strong, and a steady wind of up to 0.5 m/s more, from "
    "anywhere. A flight has arrived within 5 cm of the goal and slower than 0.1 m/s; it is lost "
    "where it is out of control or ends half a metre off. Seconds are processor seconds of one "
    "core."
)
BASE = "scenarios/paper_wind.toml"
MISSIONS, SEED = 100, 2026
MASS_SHARE = 0.1
STEADY_M_PER_S = 0.5
GUSTS = (0.5, 1.5)
LOST_M = 0.5
WANTED_S = 0.06
RESULTS = FOLDER / "mpc.jsonl"
ARRIVED, OFF, LOST = "arrived", "off the goal", "lost"


@dataclass(frozen=True)
class Outcome:
    number: int
    settings: tuple[str, ...]
    controller: str
    verdict: str
    miss_m: float
    energy_J: float
    failed: int
    solves_s: tuple[float, ...]


def perturbed(count):
    """Draw the vehicles and winds that fly, as tuples of scenario settings."""
    random = np.random.default_rng(SEED)
    believed = load_scenario(BASE)
    for _ in range(count):
        gusts = random.uniform(*GUSTS)
        yield (
            f"vehicle.mass={believed.vehicle.mass * (1 + MASS_SHARE * random.uniform(-1, 1)):.4f}",
            f"wind.speed={random.uniform(0, STEADY_M_PER_S):.3f}",
            f"wind.direction={random.uniform(0, 2 * np.pi):.3f}",
            f"wind.time_offset={random.uniform(0, 60):.2f}",
            f"wind.x.gust_amplitude={gusts * believed.wind.x.gust_amplitude:.4f}",
            f"wind.y.gust_amplitude={gusts * believed.wind.y.gust_amplitude:.4f}",
        )


def fly(number, settings, planner):
    """Fly one mission under both controllers, which believe what the scenario says."""
    believed = load_scenario(BASE)
    dynamics = planner.dynamics(load_scenario(BASE, settings))
    flights = {
        "mpc": lambda: fly_replanned(
            believed, Knowledge.ESTIMATED, dynamics=dynamics, planner=planner
        ),
        "adaptive": lambda: fly_baseline(believed, Reference.QUINTIC, dynamics=dynamics),
    }
    for controller, made in flights.items():
        try:
            flight = made()
        except SolveError:
            yield Outcome(number, settings, controller, LOST, float("inf"), float("nan"), 0, ())
            continue
        verdict = LOST if flight.terminal_miss_m > LOST_M else OFF
        yield Outcome(
            number=number,
            settings=settings,
            controller=controller,
            verdict=ARRIVED if has_arrived(flight) else verdict,
            miss_m=flight.terminal_miss_m,
            energy_J=flight.energy_J,
            failed=sum(not solve.is_converged for solve in flight.resolves),
            solves_s=tuple(solve.solve_s for solve in flight.resolves),
        )


def finished(results):
    """Return the outcomes that a results file holds."""
    if not results.exists():
        return []
    lines = [json.loads(line) for line in results.read_text(encoding="utf-8").splitlines()]
    return [Outcome(**line | {k: tuple(line[k]) for k in ("settings", "solves_s")})
            for line in lines]  # fmt: skip


def fly_all(minutes):
    """Fly what the results do not hold, and write each flight down as it ends."""
    known = {outcome.number for outcome in finished(RESULTS)}
    deadline = perf_counter() + 60.0 * (np.inf if minutes is None else minutes)
    RESULTS.parent.mkdir(parents=True, exist_ok=True)
    planner = Planner()
    for number, settings in enumerate(perturbed(MISSIONS)):
        if number in known:
            continue
        if perf_counter() > deadline:
            break
        lines = [json.dumps(asdict(outcome)) for outcome in fly(number, settings, planner)]
        with RESULTS.open("a", encoding="utf-8") as file:
            file.write("\n".join(lines) + "\n")


def rows_of(outcomes):
    """Yield for each controller how its missions ended, and for mpc how long its solves took."""
    for controller in ("mpc", "adaptive"):
        flown = [o for o in outcomes if o.controller == controller]
        counts = [sum(o.verdict == verdict for o in flown) for verdict in (ARRIVED, OFF, LOST)]
        middle, high = np.percentile([o.miss_m for o in flown], (50, 95))
        yield [controller, len(flown), *counts, f"{middle:.3f}", f"{high:.3f}"]


def measure(arguments):
    """Return tables of outcomes and of the times of solves."""
    fly_all(arguments.minutes)
    outcomes = finished(RESULTS)
    replanned = [o for o in outcomes if o.controller == "mpc"]
    times = np.array([time for o in replanned for time in o.solves_s])
    spread = [f"{1e3 * time:.0f}" for time in np.percentile(times, (50, 95, 99, 100))]
    within = f"{np.mean(times <= WANTED_S):.2%}"
    header = ["controller", "missions", ARRIVED, OFF, LOST, "median miss m", "95 % miss m"]
    solve_header = ["solves", "failed", "median ms", "95 % ms", "99 % ms", "longest ms"]
    solve_header.append(f"within {1e3 * WANTED_S:.0f} ms")
    failed = sum(o.failed for o in replanned)
    return [
        Table(name="mpc", title="Outcomes", header=header, rows=list(rows_of(outcomes))),
        Table(
            name="mpc_solves",
            title="Solves",
            header=solve_header,
            rows=[[len(times), failed, *spread, within]],
        ),
    ]
