"""How many missions that a stranger may write come out with a usable plan, and what they cost.

    python -m tests.benchmarks strangers [--minutes M] [--count N]

It goes on where it was stopped, as `robustness` does.
"""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from pyomo_quad.scenario.airspace import Shape
from tests.benchmarks.random_places import SHAPES, Zone, intrusion, spelled
from tests.benchmarks.report import FOLDER, Table
from tests.benchmarks.robustness import INFEASIBLE, LOST, finished, fly, fly_all, outcome_rows

TITLE = "Missions of strangers"
ABOUT = (
    "Random practical missions of one seed, as somebody would write them who has not read how they "
    "are solved: 25 to 400 m across, none to four waypoints with or without a radius, some with a "
    "hold, payload left at one, none to four keep-outs of every shape, some of them taller than "
    "the ceiling, wind by height from a law or a table, free or fixed time, a reserve of thrust, a "
    "largest speed; the two vehicles of the library and one written down by its owner. Fixed "
    "durations follow from the length of the way and a drawn pace, so a few ask for more than the "
    "vehicle can do. Everything else but the time limit is left at its default, and no mission "
    "gets a guess. The first missions of the seed are flown, as many as the table counts. A plan "
    "counts as verified or usable only where its flight by SciPy is outside of every zone too, by "
    "formulas of the benchmark's own. A mission is stopped after 40 s; its first usable plan is "
    "the one that is left to a user who stops earlier; as a rule it is the flight along the "
    "shortest route that needs no optimisation (`docs/theory/geometric_plan.md`), which spends "
    "more than the optimum (6, 20 and 41 % in three missions, `docs/decisions/speed.md`). "
    "Processor seconds of one core, building and flight included."
)
SEEDS = (2029,)
MISSIONS = 200
WORKERS = 2
RESULTS = FOLDER / "strangers.jsonl"
BASES = Path(__file__).parent / "stranger"
ACROSS_M = (25.0, 400.0)
HEIGHTS_M = (2.0, 40.0)
MOST_WAYPOINTS, MOST_ZONES = 4, 4
NEAREST_M = 8.0
PACES_M_PER_S = (2.5, 8.0)
# Gathering speed and braking, at each end and at each stop [s].
STOP_S = 3.0
AROUND_PLACES_M = 0.5
TALL_M = 150.0
LIBRARY, OWN = "library.toml", "own.toml"
# Base file, settings, greatest payload [kg], greatest reserve: the first has little to spare.
VEHICLES = (
    (LIBRARY, ("vehicle.use='dji_phantom_2'", "battery.use='phantom_2_pack'"), 0.1, 0.06),
    (
        LIBRARY,
        (
            "vehicle.use='dji_matrice_100'",
            "battery.use='matrice_100_pack'",
            "power.model='momentum'",
        ),
        0.6,
        0.15,
    ),
    (OWN, (), 0.3, 0.15),
)
# Processor seconds after which the best plan of a mission is taken, which 95 % of the missions are
# to take at most.
LONGEST_S = 40.0
WORST = 10


def missions(count, seed):
    """Draw missions as pairs of a base file and scenario settings; equal seeds draw equal ones."""
    random = np.random.default_rng(seed)
    for number in range(count):
        base, vehicle, heaviest, most_held = VEHICLES[random.integers(len(VEHICLES))]
        places = _places(random, 2 + random.integers(MOST_WAYPOINTS + 1))
        clearance = round(random.choice([0.0, 0.5, 1.0, 2.0]), 3)
        zones = _zones(random, places, random.integers(MOST_ZONES + 1), clearance)
        payload = round(random.choice([0.0, random.uniform(0.1, 1.0)]) * heaviest, 3)
        passings, hold = _passings(random, places[1:-1], payload)
        speed_max = round(random.uniform(5.0, 14.0), 1) if random.uniform() < 0.4 else None
        yield (
            base,
            (
                f"name='stranger_{number:03d}'",
                *vehicle,
                f"vehicle.payload={payload}",
                f"mission.start.position={spelled(places[0])}",
                f"mission.goal.position={spelled(places[-1])}",
                *([f"mission.waypoints=[{', '.join(passings)}]"] if passings else []),
                f"mission.duration={_duration(random, places, hold, speed_max)}",
                *_airspace(random, places, zones, clearance),
                *_wind(random),
                f"limits.reserve={random.choice([0.0, random.uniform(0.02, most_held)]):.2f}",
                *([f"limits.speed_max={speed_max}"] if speed_max else []),
                f"solver.time_limit={LONGEST_S}",
            ),
        )


def _places(random, count):
    """Draw start, waypoints and goal; by every third mission the goal is the start."""
    across = np.exp(random.uniform(*np.log(ACROSS_M)))
    low, high = (
        (0.0, -across / 2, HEIGHTS_M[0]),
        (across, across / 2, min(HEIGHTS_M[1], across / 2)),
    )
    is_return = count > 2 and random.uniform() < 0.33
    while True:
        places = np.round(random.uniform(low, high, size=(count, 3)), 1)
        places[0] = 0.0, 0.0, places[0, 2]
        if count == 2:
            places[1, 0] = across
        if is_return:
            places[-1] = places[0]
        if min(np.linalg.norm(b - a) for a, b in pairwise(places)) >= NEAREST_M:
            return places


def _zones(random, places, count, clearance):
    zones, tries = [], 0
    while len(zones) < count and tries < 200:
        tries += 1
        leg = random.integers(len(places) - 1)
        step = places[leg + 1] - places[leg]
        on_leg = places[leg] + random.uniform(0.2, 0.8) * step
        size = random.uniform(2.0, max(3.0, 0.12 * np.linalg.norm(step)), size=3)
        shape = SHAPES[random.integers(len(SHAPES))]
        if shape is not Shape.BOX:
            size[: 3 if shape is Shape.SPHERE else 2] = size[0]
        centre = on_leg + random.normal(size=3) * [*size[:2], 1.0]
        if shape is not Shape.SPHERE:
            top = TALL_M if random.uniform() < 0.3 else on_leg[2] + random.uniform(1.0, 15.0)
            centre[2], size[2] = top / 2, top / 2
        zone = Zone(shape=shape, centre=centre, size=size)
        around = np.maximum(0.0, np.abs(places - zone.centre) - zone.size)
        if np.all(around.max(axis=1) > clearance + AROUND_PLACES_M):
            zones.append(zone)
    return zones


def _passings(random, places, payload):
    """Return the waypoints as written, and for how long the vehicle holds at them together."""
    leaves = random.integers(len(places)) if len(places) and payload > 0 else None
    written, holds = [], 0.0
    for k, place in enumerate(places):
        told = [f"position={spelled(place)}"]
        if random.uniform() < 0.6:
            told.append(f"radius={random.choice([0.5, 1.0, 2.0, 5.0])}")
        if k == leaves or random.uniform() < 0.25:
            hold = round(random.uniform(1.0, 5.0), 1)
            holds += hold
            told.append(f"hold={hold}")
        if k == leaves and random.uniform() < 0.7:
            told.append(f"release={payload}")
        written.append(f"{{{', '.join(told)}}}")
    return written, holds


def _duration(random, places, hold, speed_max):
    length = np.linalg.norm(np.diff(places, axis=0), axis=1).sum()
    pace = min(random.uniform(*PACES_M_PER_S), 0.9 * (speed_max or np.inf))
    stops = 2 + (len(places) - 2) * (hold > 0.0)
    lasting = length / pace + hold + STOP_S * stops
    return "'free'" if random.uniform() < 0.5 else f"{lasting:.1f}"


def _airspace(random, places, zones, clearance):
    heights = places[:, 2]
    if zones:
        told = ", ".join(zone.written(f"zone_{k}") for k, zone in enumerate(zones))
        yield f"airspace.keep_out=[{told}]"
        yield f"airspace.clearance={clearance}"
    if random.uniform() < 0.6:
        yield f"airspace.floor={heights.min() - random.uniform(0.5, 1.5):.1f}"
    if random.uniform() < 0.5:
        yield f"airspace.ceiling={heights.max() + random.uniform(3.0, 40.0):.1f}"


def _wind(random):
    kind = random.choice(["calm", "law", "table", "steady"], p=[0.15, 0.35, 0.3, 0.2])
    if kind == "calm":
        return
    yield "wind.coupling='drag'"
    if kind == "table":
        yield f"wind.file='{BASES / 'wind_by_height.csv'}'"
        return
    yield "wind.use='constant'"
    yield f"wind.speed={random.uniform(1.0, 7.0):.1f}"
    yield f"wind.direction={random.uniform(0, 2 * np.pi):.2f}"
    if kind == "law" and random.uniform() < 0.5:
        yield "wind.profile={law='logarithmic', roughness=0.1}"
    elif kind == "law":
        yield "wind.profile={law='power', exponent=0.2}"


def fly_stranger(mission):
    """Fly a mission that is a seed, a number, and a base file with settings."""
    seed, number, (base, settings) = mission
    outcome = fly((seed, number, settings), intrusion, BASES / base)
    told = tuple(setting.replace(f"{BASES}/", "") for setting in outcome.settings)
    return replace(outcome, settings=told)


def measure(arguments):
    """Return tables of outcomes and of the missions that cost most or were lost."""
    count = arguments.count or MISSIONS
    drawn = [(seed, *told) for seed in SEEDS for told in enumerate(missions(count, seed))]
    fly_all(arguments.minutes, drawn, RESULTS, fly_stranger, WORKERS)
    return tables(finished(RESULTS))


def tables(outcomes):
    """Return what outcomes hold as tables."""
    times = np.array([o.processor_s for o in outcomes])
    usable = np.array([np.inf if o.usable_s is None else o.usable_s for o in outcomes])
    lost = [o for o in outcomes if o.verdict == LOST]
    proven = sum(o.verdict == INFEASIBLE for o in outcomes)
    told = [
        len(outcomes),
        len(lost),
        proven,
        *(f"{time:.1f}" for time in np.percentile(usable, (50, 95), method="lower")),
        *(f"{time:.1f}" for time in np.percentile(times, (50, 95))),
    ]
    header = ["missions", "without a usable plan", "proven infeasible"]
    header += ["usable plan: median s", "95 % s", "end of the solve: median s", "95 % within s"]
    dearest = sorted(outcomes, key=lambda o: -o.processor_s)[:WORST]
    rows = [
        [o.verdict, o.number, f"{o.processor_s:.1f}", ", ".join(o.settings[1:]), o.detail]
        for o in (*lost, *(o for o in dearest if o not in lost))
    ]
    return [
        Table(name="strangers", title="All", header=header, rows=[told]),
        Table(
            name="strangers_outcomes",
            title="Outcomes",
            header=["seed", "outcome", "missions", "share", "median s", "95th percentile s"],
            rows=list(outcome_rows(SEEDS[0], outcomes)),
        ),
        Table(
            name="strangers_worst",
            title="Lost, and the dearest",
            header=["outcome", "number", "s", "mission", "what happened"],
            rows=rows,
        ),
    ]
