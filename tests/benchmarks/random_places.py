"""How many random missions between waypoints and zones come out verified, infeasible, or lost.

    python -m tests.benchmarks places [--minutes M]

It goes on where it was stopped, as `robustness` does.  A verified plan is looked at once more: its
flight, integrated by SciPy, must be outside of every zone as the zones are written, and above the
floor and below the ceiling.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pyomo_quad.flight.flight import POSITION_STATES
from pyomo_quad.scenario.accuracy import FIGURES, Accuracy
from pyomo_quad.scenario.airspace import Shape
from tests.benchmarks.report import FOLDER
from tests.benchmarks.robustness import fly, fly_all, tables

TITLE = "Robustness between waypoints and zones"
ABOUT = (
    "Random missions, 100 of one seed, of which the table counts those flown so far: start, 1 to 4 "
    "waypoints and goal in a room of 20 x 20 x 8 m, some of them passed within a radius, held at, "
    "slowly, at a heading or at a time; 0 to 4 cylinders, spheres and boxes beside the legs, with "
    "and without clearance, floor, ceiling and a largest speed; fixed durations at 1 to 3 m/s on "
    "average, or free with and without a price of time; motor and shaft power, calm and windy. A "
    "plan counts as verified only where its flight by SciPy is outside of every zone too, by "
    "formulas of the benchmark's own. No mission gets a guess, or more than 900 s of a processor. "
    "Those that earlier code lost were flown again by later code, the others were not."
)
SEEDS = (2027,)
MISSIONS = 100
WORKERS = 2
RESULTS = FOLDER / "places.jsonl"
MOST_WAYPOINTS, MOST_ZONES = 4, 4
LOWEST, HIGHEST = np.array([-10.0, -10.0, 1.0]), np.array([10.0, 10.0, 9.0])
NEAREST_M = 2.0
PACES_M_PER_S = (1.0, 3.0)
PRICES_W = (0.0, 60.0)
# From a place to the nearest zone with its clearance, so that the mission says nothing false.
AROUND_PLACES_M = 0.2
POWER_MODELS = ("motor", "shaft")
LONGEST_SOLVE_S = 900

#: Shapes that are drawn.
SHAPES = (Shape.CYLINDER, Shape.SPHERE, Shape.BOX)


@dataclass(frozen=True)
class Zone:
    """A keep-out as written, and its depth by the plainest formula for its shape."""

    shape: Shape
    centre: np.ndarray
    size: np.ndarray

    def written(self, name):
        low, high = self.centre - self.size, self.centre + self.size
        head = f"name='{name}', shape='{self.shape.value}'"
        if self.shape is Shape.BOX:
            return f"{{{head}, low={spelled(low)}, high={spelled(high)}}}"
        if self.shape is Shape.SPHERE:
            return f"{{{head}, centre={spelled(self.centre)}, radius={self.size[0]:.3f}}}"
        heights = f"bottom={low[2]:.3f}, top={high[2]:.3f}"
        return (
            f"{{{head}, centre={spelled(self.centre[:2])}, radius={self.size[0]:.3f}, {heights}}}"
        )


def depth(zone, places):
    """Return how far inside a keep-out places of shape (n, 3) are [m], negative outside."""
    if zone.shape is Shape.BOX:
        return np.minimum(places - zone.low, np.array(zone.high) - places).min(axis=1)
    if zone.shape is Shape.SPHERE:
        return zone.radius - np.linalg.norm(places - zone.centre, axis=1)
    aside = zone.radius - np.hypot(*(places[:, :2] - zone.centre).T)
    return np.minimum(aside, np.minimum(places[:, 2] - zone.bottom, zone.top - places[:, 2]))


def spelled(numbers):
    """Return numbers as a list of a scenario file."""
    return f"[{', '.join(f'{number:.3f}' for number in numbers)}]"


def missions(count, seed):
    """Draw missions as tuples of scenario settings; equal seeds give equal missions."""
    random = np.random.default_rng(seed)
    for number in range(count):
        places = _places(random, 2 + random.integers(1, MOST_WAYPOINTS + 1))
        clearance = round(random.choice([0.0, random.uniform(0.0, 0.4)]), 3)
        zones = _zones(random, places, random.integers(MOST_ZONES + 1), clearance)
        lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
        holds = np.where(random.uniform(size=len(places)) < 0.2, random.uniform(0.5, 2.0), 0.0)
        lasting = lengths.sum() / random.uniform(*PACES_M_PER_S) + holds[1:-1].sum()
        is_free = random.uniform() < 0.5
        passings = [
            {"position": spelled(place), **_extras(random, hold)}
            for place, hold in zip(places[1:-1], holds[1:-1], strict=True)
        ]
        if not is_free and random.uniform() < 0.3:
            way = lengths[0] / lengths.sum() * random.uniform(0.9, 1.1)
            passings[0]["at"] = f"{way * lasting:.3f}"
        written = [", ".join(f"{k}={v}" for k, v in passing.items()) for passing in passings]
        duration = ["mission.duration='free'", f"mission.price_of_time={_price(random):.1f}"]
        yield (
            f"name='places_{number:03d}'",
            f"mission.start.position={spelled(places[0])}",
            f"mission.goal.position={spelled(places[-1])}",
            f"mission.waypoints=[{', '.join(f'{{{told}}}' for told in written)}]",
            *(duration if is_free else [f"mission.duration={lasting:.3f}"]),
            *_airspace(random, places, zones, clearance),
            *_air(random),
            f"solver.time_limit={LONGEST_SOLVE_S}",
            f"power.model='{POWER_MODELS[random.integers(len(POWER_MODELS))]}'",
        )


def _places(random, count):
    while True:
        places = np.round(random.uniform(LOWEST, HIGHEST, size=(count, 3)), 3)
        if min(np.linalg.norm(b - a) for a, b in pairwise(places)) >= NEAREST_M:
            return places


def _zones(random, places, count, clearance):
    zones = []
    while len(zones) < count:
        leg = random.integers(len(places) - 1)
        on_leg = places[leg] + random.uniform(0.2, 0.8) * (places[leg + 1] - places[leg])
        shape = SHAPES[random.integers(len(SHAPES))]
        size = random.uniform(0.3, 1.8, size=3) * [1.0, 1.0, random.choice([1.0, 3.0])]
        if shape is not Shape.BOX:
            size[: 3 if shape is Shape.SPHERE else 2] = size[0]
        zone = Zone(shape=shape, centre=on_leg + random.normal(size=3), size=size)
        around = np.maximum(0.0, np.abs(places - zone.centre) - zone.size)
        # Outside of the box round it, which holds every shape.
        if np.all(around.max(axis=1) > clearance + AROUND_PLACES_M):
            zones.append(zone)
    return zones


def _extras(random, hold):
    """Return what a waypoint asks beside its place."""
    chances = random.uniform(size=3)
    extras = {"hold": f"{hold:.3f}"} if hold > 0.0 else {}
    if chances[0] < 0.3:
        extras["radius"] = f"{random.uniform(0.1, 1.0):.3f}"
    if chances[1] < 0.15:
        extras["speed_max"] = f"{random.uniform(0.5, 3.0):.3f}"
    if chances[2] < 0.15:
        extras["yaw"] = f"{random.uniform(-1.5, 1.5):.3f}"
    return extras


def _price(random):
    return random.choice([0.0, random.uniform(*PRICES_W)])


def _airspace(random, places, zones, clearance):
    chances = random.uniform(size=3)
    heights = places[:, 2]
    if zones:
        written = ", ".join(zone.written(f"zone_{k}") for k, zone in enumerate(zones))
        yield f"airspace.keep_out=[{written}]"
        yield f"airspace.clearance={clearance:.3f}"
    if chances[0] < 0.5:
        yield f"airspace.floor={heights.min() - random.uniform(0.1, 1.0):.3f}"
    if chances[1] < 0.5:
        yield f"airspace.ceiling={heights.max() + random.uniform(0.1, 3.0):.3f}"
    if chances[2] < 0.2:
        yield f"limits.speed_max={random.uniform(3.0, 6.0):.3f}"


def _air(random):
    if random.uniform() < 0.5:
        return ()
    speed, direction = random.uniform(0.0, 5.0), random.uniform(0.0, 2 * np.pi)
    return (
        "wind.use='constant'",
        f"wind.speed={speed:.3f}",
        f"wind.direction={direction:.3f}",
        f"wind.coupling='{random.choice(['acceleration', 'drag'])}'",
    )


def intrusion(plan):
    """Say where the flight of a plan is that it must not be; nothing where it keeps out."""
    told, dynamics = plan.scenario.airspace, plan.dynamics
    columns = [dynamics.state_names.index(name) for name in POSITION_STATES]
    places = plan.flown.states[:, columns]
    found = {zone.name: depth(zone, places).max() + told.clearance for zone in told.keep_out}
    if told.floor is not None:
        found["floor"] = told.floor - places[:, 2].min()
    if told.ceiling is not None:
        found["ceiling"] = places[:, 2].max() - told.ceiling
    worst = max(found, key=found.get, default=None)
    if worst is None or found[worst] <= FIGURES[Accuracy.PROOF].breach * max(
        1.0, np.abs(places).max()
    ):
        return ""
    return f"the flight is {found[worst]:.2g} m past {worst}"


def fly_between(mission):
    return fly(mission, intrusion)


def measure(arguments):
    """Return a table of outcomes, and the missions to look at."""
    drawn = [(seed, *told) for seed in SEEDS for told in enumerate(missions(MISSIONS, seed))]
    fly_all(arguments.minutes, drawn, RESULTS, fly_between, WORKERS)
    return tables("places", SEEDS, RESULTS)
