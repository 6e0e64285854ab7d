"""Plans between random places of a block of buildings, beside the best of random starts.

    python -m tests.benchmarks pairs [--minutes M] [--count N]

In the computed wind of `scenarios/street.toml`, from each of five directions, missions lead from
one random place to another.  Each is planned as users plan it: the search for corridors gives the
routes at which solves begin.  Beside it the same solve begins at random routes: through one or two
random places, by the shortest ways between them round the buildings.  All starts are solved on the
first mesh, the nearest to the best on the next one, and the best to the tolerance, as the planner
itself does with its corridors.  A pair is written down as it ends, and a run that was stopped goes
on.
"""

from dataclasses import dataclass
from math import nan
from time import process_time

import numpy as np

from pyomo_quad.flight import Planner, PlanStatus
from pyomo_quad.flight.corridors import WindMap
from pyomo_quad.flight.deadline import Deadline
from pyomo_quad.flight.mission_problem import MissionProblem
from pyomo_quad.flight.route_flights import RouteFlights
from pyomo_quad.flight.routes import NoRouteError, Route, find_journeys, journeys_of
from pyomo_quad.scenario import load_scenario
from pyomo_quad.scenario.accuracy import Accuracy
from pyomo_quad.scenario.messages import PyomoQuadError
from pyomo_quad.study.certificate import certify
from tests.benchmarks.random_places import spelled
from tests.benchmarks.report import FOLDER, Table
from tests.benchmarks.robustness import fly_all, stored
from tests.benchmarks.wind_fields import DIRECTIONS_DEG, SCENARIO

TITLE = "Random pairs of places in the wind between buildings"
DIRECTIONS = DIRECTIONS_DEG[:5]
PAIRS, STARTS = 10, 20
NEAREST_M, FARTHEST_M = 60.0, 150.0
# A plan may cost so much more than the best random start [%].
DEARER_PERCENT = 0.5
# Accuracy of the plans, the default of the command line. Starts have that of the scenario.
ACCURACY = Accuracy.STANDARD.value
# A random start that is still unsolved is given up.
MOST_ITERATIONS, MOST_MESHES = 200, 4
LONGEST_SOLVE_S = 300
ABOUT = (
    f"Missions of `scenarios/street.toml` between random places {NEAREST_M:g} to {FARTHEST_M:g} m "
    f"apart, in the wind of {len(DIRECTIONS)} of its directions, 6 m/s undisturbed; {PAIRS} pairs "
    "of places for each direction are drawn, between which the buildings leave a way inside the "
    "field, and the table has those planned so far. *Plan*: what "
    f"`pyomo-quad solve` finds at accuracy `{ACCURACY}`, from the corridors that its search on a "
    f"grid finds. *Best start*: the best of {STARTS} solves of the same problem from random "
    "routes, each through one or two random places and round the buildings; all are solved on the "
    "first mesh, and the best are refined as the planner refines its corridors, to `quick` and on "
    f"at most {MOST_MESHES} meshes; where that fails or takes more than {LONGEST_SOLVE_S} s, the "
    "best energy on the first mesh stands, which is as a rule too low. Starts are not flown: their "
    "solutions may pass a corner between points a little closer than a flight may. *Solved*: how "
    "many of "
    "the random starts ended in a solution on the first mesh, and how many different energies, "
    "apart by more than 0.1 %, were among them. The excess is that of the plan over the best "
    "start; a plan was found badly where it is above "
    f"{DEARER_PERCENT} %. *Bound*: no flight of the mission spends less, proven over all winds of "
    "the field (`docs/theory/bound.md`); the gap is that of the plan above it."
)
RESULTS = FOLDER / "pairs.jsonl"
HEIGHT_M = 15.0
# From a place to the nearest building, beside the clearance of the mission [m].
AROUND_PLACES_M = 3.0
# Random places of a start lie within this share of the distance round start and goal.
ROUND_SHARE = 0.4
# Energies this near are those of one flight.
SAME_SHARE = 1e-3

_PLANNERS: dict[None, Planner] = {}


@dataclass(frozen=True)
class Outcome:
    """Energies of a pair; `seed` is the direction of the wind, from which the pair was drawn."""

    seed: int
    number: int
    settings: tuple[str, ...]
    ended: str
    plan_J: float
    best_J: float
    energies_J: tuple[float, ...]
    bound_J: float | None
    corridors: int
    plan_s: float
    starts_s: float

    @property
    def excess_percent(self):
        """Excess of the plan over the best start; nan where there is no plan that can be flown."""
        if self.ended not in {PlanStatus.VERIFIED.value, PlanStatus.USABLE.value}:
            return nan
        return 100.0 * (self.plan_J / self.best_J - 1.0)

    @property
    def gap_percent(self):
        """Gap of the plan above the lower bound, in per cent of the plan; nan without either."""
        if self.bound_J is None or np.isnan(self.excess_percent):
            return nan
        return 100.0 * (1.0 - self.bound_J / self.plan_J)

    @property
    def different(self):
        """Number of different energies among the random starts."""
        energies = np.sort(self.energies_J)
        return len(energies) and 1 + int(np.sum(np.diff(energies) > SAME_SHARE * energies[0]))


def mission_of(direction_deg, start, goal):
    """Return the settings of a mission between two places in the wind of a direction."""
    field = SCENARIO.parent / "winds" / f"street_{direction_deg:03d}.nc"
    return (
        f"wind.field='winds/{field.name}'",
        f"mission.start.position={spelled(start)}",
        f"mission.goal.position={spelled(goal)}",
        f"solver.time_limit={LONGEST_SOLVE_S}",
    )


def told_of(settings):
    """Return the scenario of settings whose wind lies beside the scenarios."""
    beside = f"wind.field='{SCENARIO.parent}/"
    return load_scenario(SCENARIO, [s.replace("wind.field='", beside) for s in settings])


def is_free(told, place):
    """Return whether a place has wind, and room to every building."""
    airspace, places = told.airspace, np.array([place])
    if np.isnan(WindMap(told).at(places, np.zeros(1))).any():
        return False
    room = airspace.clearance + AROUND_PLACES_M
    return all(zone.depth(places)[0] + room <= 0.0 for zone in airspace.keep_out)


def drawn(random, told, low, high):
    """Draw a free place between two corners of the ground."""
    while True:
        place = np.append(random.uniform(low, high), HEIGHT_M)
        if is_free(told, place):
            return place


def has_way(told):
    """Return whether the buildings leave a way from start to goal inside the field."""
    try:
        return bool(journeys_of(told))
    except NoRouteError:
        return False


def missions(count, direction_deg):
    """Draw missions as tuples of scenario settings; equal directions give equal missions."""
    random = np.random.default_rng(direction_deg)
    told = load_scenario(
        SCENARIO, [f"wind.field='{SCENARIO.parent}/winds/street_{direction_deg:03d}.nc'"]
    )
    grid = told.wind.grid
    low, high = (grid.x[0], grid.y[0]), (grid.x[-1], grid.y[-1])
    found = 0
    while found < count:
        start, goal = drawn(random, told, low, high), drawn(random, told, low, high)
        settings = mission_of(direction_deg, start, goal)
        is_near = NEAREST_M <= np.linalg.norm(goal - start) <= FARTHEST_M
        if is_near and has_way(told_of(settings)):
            found += 1
            yield settings


def random_routes(told, count, seed):
    """Return journeys of one leg each through random places, round the buildings."""
    random, journeys = np.random.default_rng(seed), []
    start, goal = told.mission.positions[0], told.mission.positions[-1]
    ends = np.array([start, goal])[:, :2]
    aside = ROUND_SHARE * np.linalg.norm(ends[1] - ends[0])
    grid = told.wind.grid
    low = np.maximum(ends.min(axis=0) - aside, [grid.x[0], grid.y[0]])
    high = np.minimum(ends.max(axis=0) + aside, [grid.x[-1], grid.y[-1]])
    while len(journeys) < count:
        between = [tuple(drawn(random, told, low, high)) for _ in range(random.integers(1, 3))]
        try:
            legs = find_journeys(told.airspace, (start, *between, goal))[0]
        except NoRouteError:
            continue
        places = np.vstack([legs[0].places[:1], *(leg.places[1:] for leg in legs)])
        journeys.append((Route(places=places, sides=(), label=f"start {len(journeys) + 1}"),))
    return journeys


def fly(mission):
    """Plan a mission, and solve it from random starts."""
    direction, number, settings = mission
    told, planner = told_of(settings), _PLANNERS.setdefault(None, Planner())
    began = process_time()
    try:
        plan = planner.solve(told_of((*settings, f"solver.accuracy='{ACCURACY}'")))
        ended, plan_J, corridors = plan.status.value, plan.energy, len(plan.routes)
    except PyomoQuadError as error:
        ended, plan_J, corridors = str(error), nan, 0
    planned = process_time()
    solver = told.solver.model_copy(
        update={"max_iterations": MOST_ITERATIONS, "max_refinements": MOST_MESHES - 1}
    )
    problem = MissionProblem(planner, told.model_copy(update={"solver": solver}).as_forecast())
    flights = RouteFlights(problem)
    # Each random route is one start.
    flights.has_several_optima = False
    rough = []
    fly_one = flights.fly

    def counted(journey):
        solution = fly_one(journey)
        if solution.status.is_solved:
            rough.append(flights.energy_of(solution))
        return solution

    flights.fly = counted
    with Deadline(told) as deadline:
        problem.arguments["progress"] = deadline
        best, _ = flights.compared(random_routes(told, STARTS, number))
    starts_s = process_time() - planned
    return Outcome(
        seed=direction,
        number=number,
        settings=settings,
        ended=ended,
        plan_J=plan_J,
        best_J=flights.energy_of(best) if best.status.is_solved else min(rough, default=nan),
        energies_J=tuple(round(energy, 3) for energy in rough),
        bound_J=certify(told, planner=planner).lower_bound_J,
        corridors=corridors,
        plan_s=round(planned - began, 1),
        starts_s=round(starts_s, 1),
    )


def finished(results=RESULTS):
    """Return the outcomes that a results file holds."""
    tuples = ("settings", "energies_J")
    outcomes = [
        Outcome(**line | {key: tuple(line[key]) for key in tuples}) for line in stored(results)
    ]
    return sorted(outcomes, key=lambda o: (DIRECTIONS.index(o.seed), o.number))


def measure(arguments):
    """Return the tables of all pairs and of each."""
    drawn_for = {d: missions(PAIRS, d) for d in DIRECTIONS}
    # Direction by direction in turn, so that a run that is stopped has planned as many of each.
    turns = enumerate(zip(*drawn_for.values(), strict=True))
    wanted = [
        (d, number, settings)
        for number, turn in turns
        for d, settings in zip(DIRECTIONS, turn, strict=True)
    ]
    fly_all(arguments.minutes, wanted[: arguments.count], RESULTS, fly, workers=1)
    return tables(finished())


def tables(outcomes):
    """Return what outcomes hold as tables."""
    return [
        Table(
            name="pairs",
            title=f"{len(outcomes)} of {PAIRS * len(DIRECTIONS)} pairs",
            header=["wind toward deg", "pairs", "with plan and start", "worst excess %",
                    f"above {DEARER_PERCENT} %", "plan better by 0.5 %", "plans below bound",
                    "median gap to bound %", "median plan s", "median starts s"],
            rows=[
                _row(direction, chosen)
                for direction in (*DIRECTIONS, "all")
                if (chosen := [o for o in outcomes if direction in (o.seed, "all")])
            ],
        ),
        Table(
            name="pairs_each",
            title="Each pair",
            header=["wind toward deg", "number", "places m", "ended", "plan J", "best start J",
                    "excess %", "bound J", "corridors", "solved", "different", "plan s",
                    "starts s"],
            rows=[_pair_row(o) for o in outcomes],
        ),
    ]  # fmt: skip


def _row(direction, outcomes):
    excess = [o.excess_percent for o in outcomes if np.isfinite(o.excess_percent)]
    gaps = [o.gap_percent for o in outcomes if np.isfinite(o.gap_percent)]
    return [
        direction,
        len(outcomes),
        len(excess),
        f"{max(excess):.2f}" if excess else "-",
        sum(e > DEARER_PERCENT for e in excess),
        sum(e < -DEARER_PERCENT for e in excess),
        sum(gap < 0.0 for gap in gaps),
        f"{np.median(gaps):.0f}" if gaps else "-",
        f"{np.median([o.plan_s for o in outcomes]):.1f}",
        f"{np.median([o.starts_s for o in outcomes]):.1f}",
    ]


def _pair_row(outcome):
    places = [s.partition("=")[2] for s in outcome.settings if ".position=" in s]
    numbers = (outcome.plan_J, outcome.best_J, outcome.excess_percent)
    energies = [
        "-" if np.isnan(n) else f"{n:.{d}f}" for n, d in zip(numbers, (1, 1, 2), strict=True)
    ]
    return [
        outcome.seed,
        outcome.number,
        " to ".join(places),
        outcome.ended,
        *energies,
        "-" if outcome.bound_J is None else f"{outcome.bound_J:.1f}",
        outcome.corridors,
        f"{len(outcome.energies_J)} of {STARTS}",
        outcome.different,
        f"{outcome.plan_s:.0f}",
        f"{outcome.starts_s:.0f}",
    ]
