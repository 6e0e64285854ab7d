"""A solve ends within its time limit, whatever it is at, and falls back in a given order."""

from dataclasses import dataclass, field, replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from pyomo_quad import load_scenario
from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.collocation import Mesh, SolverOptions, Status, Trajectory
from pyomo_quad.flight import Planner, PlanStatus, candidate, deadline, planning
from pyomo_quad.flight.candidate import Candidate
from pyomo_quad.flight.mission_problem import MissionProblem
from pyomo_quad.flight.planning import solve_scenario
from pyomo_quad.flight.routes import TriedRoute
from pyomo_quad.flight.search import Search, Stage
from pyomo_quad.flight.strategies import MISSION, RETRIES, Strategy, carry_out
from pyomo_quad.model import build_model
from pyomo_quad.model.power import wider_smoothings
from pyomo_quad.scenario.mission import NamedDuration
from pyomo_quad.study.run import run_scenario
from tests.command import IMPOSSIBLE, PAPER_CALM

TOO_SHORT = [setting.removeprefix("--set=") for setting in IMPOSSIBLE]


class IterationClock:
    """A clock that ticks once an iteration, so that a limit of so many seconds is exact."""

    def __init__(self):
        self.now = 0.0

    def thread_time(self):
        return self.now

    def perf_counter(self):
        return self.now

    def tick(self, _iteration):
        self.now += 1.0


def solve(monkeypatch, limit):
    clock = IterationClock()
    for module in (planning, deadline):
        monkeypatch.setattr(module, "time", clock)
    scenario = load_scenario(PAPER_CALM, [*TOO_SHORT, f"solver.time_limit={limit}"])
    return solve_scenario(scenario, progress=clock.tick), clock.now


@pytest.mark.slow
def test_every_part_of_a_failing_solve_keeps_the_limit(monkeypatch):
    """The first solve, the elastic one, the shortest flight and each remedy are all stopped."""
    whole, iterations = solve(monkeypatch, 1e6)
    assert whole.status is PlanStatus.INFEASIBLE
    for share in (0.02, 0.3, 0.6):
        limit = int(share * iterations)
        plan, used = solve(monkeypatch, limit)
        assert limit <= used <= limit + 1
        if plan.status is not PlanStatus.INFEASIBLE:
            assert plan.status is PlanStatus.NOT_CONVERGED
            assert plan.message.startswith(f"given up after solver.time_limit = {limit} s; allow")


class WatchedClock:
    """A clock that ticks each time that someone looks at it for the time limit."""

    def __init__(self):
        self.now = 0.0

    def thread_time(self):
        self.now += 1.0
        return self.now


def timed(monkeypatch, act, limit):
    """What an act on a coarse hop gives within a limit, and when it was over."""
    clock = WatchedClock()
    monkeypatch.setattr(deadline, "time", clock)
    return act(load_scenario(PAPER_CALM, [*COARSE_HOP, f"solver.time_limit={limit}"])), clock.now


COARSE_HOP = ["mission.goal.position=[1.0, 0.0, 0.5]", "mission.duration=4.0"]
# Looks at the clock after its time was up: none goes on, but each begins.
FEW_LOOKS = 60


@pytest.mark.lengthy
def test_the_flight_that_checks_a_plan_keeps_the_limit(monkeypatch):
    told = []

    def solve_hop(scenario):
        # What is told last of a solve is told before its flight.
        return solve_scenario(scenario, progress=lambda line: told.append(line.iteration))

    plan, whole = timed(monkeypatch, solve_hop, 1e6)
    assert plan.is_verified
    in_solve = len(told)
    assert whole > in_solve + 10 * FEW_LOOKS
    limit = (in_solve + whole) // 2
    stopped, used = timed(monkeypatch, solve_hop, limit)
    assert used <= limit + FEW_LOOKS
    assert (stopped.status, stopped.verification) == (PlanStatus.NOT_CONVERGED, None)
    assert stopped.message.startswith(f"given up after solver.time_limit = {limit:g} s; allow")
    assert stopped.energy == pytest.approx(plan.energy, rel=1e-6)


@pytest.mark.lengthy
def test_the_flights_beside_a_plan_keep_the_limit_that_it_left(monkeypatch):
    """In one process, where all look at one clock."""
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    _, solving = timed(monkeypatch, solve_scenario, 1e6)
    whole, used = timed(monkeypatch, run_scenario, 1e6)
    assert used > solving + 10 * FEW_LOOKS
    assert len(whole.flights) > 1
    limit = int(solving) + FEW_LOOKS
    result, used = timed(monkeypatch, run_scenario, limit)
    assert result.plan.is_verified
    assert used <= limit + FEW_LOOKS
    assert [flight.name for flight in result.flights] == ["optimal"]
    why = f"could not be flown: given up after solver.time_limit = {limit:g} s; allow more time."
    assert sum(why in warning for warning in result.warnings) == len(whole.flights) - 1


def test_a_copy_of_a_process_has_what_was_left_when_it_was_copied(monkeypatch):
    """The clock of a copy begins anew."""
    clock, process = WatchedClock(), [1]
    monkeypatch.setattr(deadline, "time", clock)
    monkeypatch.setattr(deadline.os, "getpid", lambda: process[0])
    scenario = load_scenario(PAPER_CALM, ["solver.time_limit=30.0"])
    with deadline.Deadline(scenario):
        for _ in range(20):
            deadline.keep_time()
        clock.now, process[0] = 0.0, 2
        for _ in range(11):
            deadline.keep_time()
        with pytest.raises(deadline.TimeIsUpError, match=r"solver\.time_limit = 30 s; allow more"):
            deadline.keep_time()


def test_the_command_says_that_time_ran_out(capsys):
    arguments = ["fly", PAPER_CALM, "--reference=plan", "--set=solver.time_limit=1e-3"]
    assert main(arguments) == ExitCode.NOT_SOLVED
    said = capsys.readouterr().err
    assert said.startswith(
        "paper_calm: no plan to follow, not_converged: given up after "
        "solver.time_limit = 0.001 s; allow more time"
    )
    assert len(said.splitlines()) == 1


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("settings", "durations"),
    [
        pytest.param((), (4.04, 4.012, 4.004, 4.0012), marks=pytest.mark.slow),
        (["mission.duration_min=4.02"], (4.04, 4.02)),
    ],
)
def test_the_least_time_is_approached_by_flights_that_are_proven(monkeypatch, settings, durations):
    hop = ["mission.goal.position=[1.0, 0.0, 0.5]", "solver.elements=10"]
    slow = solve_scenario(load_scenario(PAPER_CALM, [*hop, "mission.duration=4.0"]))
    shortest = replace(slow.solution, objective=4.0)
    monkeypatch.setattr(planning, "shortest_flight", lambda *_told, **_how: shortest)
    asked = ["mission.duration='free'", "mission.aim='time'", *settings]
    plan = solve_scenario(load_scenario(PAPER_CALM, [*hop, *asked]))
    tried = [said.partition(" s: ") for said in plan.attempts[1:]]
    assert [float(duration) for duration, _, _ in tried] == pytest.approx(durations)
    assert {status for _, _, status in tried} == {"verified"}
    assert plan.attempts[0] == "shortest flight: 4 s"
    assert plan.is_verified
    assert plan.duration_s == pytest.approx(durations[-1], abs=1e-9)
    assert plan.message.endswith(f"It takes {durations[-1]:g} s, where the least time is 4 s.")


@pytest.mark.parametrize("value", ["0", "-1.0", "1e300"])
def test_a_limit_is_a_time(value):
    with pytest.raises(ValueError, match=r"solver\.time_limit = .* s; must be"):
        load_scenario(PAPER_CALM, [f"solver.time_limit={value}"])


DURATION = 10.0


def path(name):
    return Trajectory(mesh=Mesh.uniform(1, 1), states=name, algebraics=name, statics=())


@dataclass(frozen=True)
class Pretended:
    status: Status
    trajectory: Trajectory = field(default_factory=lambda: path("mission"))
    objective: float = 0.0


FAILED, DONE = Pretended(Status.NOT_CONVERGED), Pretended(Status.CONVERGED)


class Solves:
    """A mission whose solves give their answers in turn, and what was asked of it."""

    def __init__(self, *answers, plainly=None, slowly=DONE):
        self.answers, self.slowly = list(answers), slowly
        self.past_waypoints = plainly and SimpleNamespace(solve_roughly=lambda: plainly)
        longest = NamedDuration("mission.duration", DURATION)
        mission, solver = SimpleNamespace(longest=longest, is_free=False), SimpleNamespace()
        solver.tolerance = 1e-6
        wind = SimpleNamespace(grid=None)
        self.told = SimpleNamespace(mission=mission, solver=solver, wind=wind)
        self.problems = SimpleNamespace(builder=lambda _told: None)
        self.guesses, self.slow = [], []

    @staticmethod
    def in_own_variables(other, _own):
        return other.trajectory

    def solve_from(self, trajectory, _mesh):
        self.guesses.append(trajectory.states)
        return self.answers.pop(0)

    def solve_roughly(self, *, horizon, guess):
        self.slow.append((horizon[1], None if guess is None else guess.states))
        return self.slowly


def new_search():
    return Search(deadline.Deadline(load_scenario(PAPER_CALM)))


def retried(mission, routes=()):
    """The candidate and the record of all retries of a mission that failed."""
    search = new_search()
    tried = Candidate(scenario=None, mission=mission, search=search, solution=FAILED, routes=routes)
    carry_out(RETRIES, tried, search)
    return tried, search.record


@pytest.fixture
def diagnosed(monkeypatch):
    def answer(*, feasible_point=None, is_infeasible=False, shortest=None):
        found = SimpleNamespace(
            feasible_point=feasible_point, is_infeasible=is_infeasible, relaxations=(), active=()
        )
        monkeypatch.setattr(candidate, "diagnose", lambda *_, **__: found)
        monkeypatch.setattr(candidate, "shortest_flight", lambda *_: shortest)

    return answer


def shortest(duration):
    return Pretended(Status.CONVERGED, path("shortest"), duration)


def test_a_flight_that_keeps_every_limit_is_the_first_guess(diagnosed):
    diagnosed(feasible_point=path("elastic"))
    mission = Solves(DONE)
    tried, record = retried(mission)
    assert mission.guesses == ["elastic"]
    assert tried.solution is DONE
    assert tried.failure is None
    assert record == ["elastic restoration: converged"]


def test_a_flight_past_the_waypoints_themselves_leads_to_one_within_their_radius(diagnosed):
    diagnosed(feasible_point=path("elastic"))
    mission = Solves(DONE, plainly=Pretended(Status.CONVERGED, path("plain")))
    _, record = retried(mission)
    assert mission.guesses == ["plain"]
    assert record[-1] == "from a flight exactly through the waypoints: converged"


def test_a_slow_flight_is_sped_up_when_that_guess_fails(diagnosed):
    diagnosed(feasible_point=path("elastic"))
    mission = Solves(FAILED, DONE, slowly=Pretended(Status.CONVERGED, path("slow")))
    _, record = retried(mission)
    assert [duration for duration, _ in mission.slow] == pytest.approx([30, 20, 15, 12, 11])
    assert [guess for _, guess in mission.slow] == [None, *["slow"] * 4]
    assert mission.guesses == ["elastic", "slow"]
    assert record[0] == "elastic restoration: not_converged"
    assert record[-1] == "continuation in duration: converged"


def test_the_shortest_flight_is_the_last_guess(diagnosed):
    diagnosed(shortest=shortest(4.0))
    mission = Solves(FAILED, DONE)
    _, record = retried(mission)
    assert mission.guesses == ["mission", "shortest"]
    assert record[-2:] == ["shortest flight: 4 s", "guess from the shortest flight: converged"]


def test_a_mission_is_infeasible_when_the_shortest_flight_takes_longer(diagnosed):
    diagnosed(is_infeasible=True, shortest=shortest(12.5))
    tried, _ = retried(Solves())
    assert tried.solution.status is Status.INFEASIBLE
    assert next(tried.failure.causes()).startswith("mission.duration = 10 s is 2.5 s too short")


def test_a_shorter_flight_contradicts_the_elastic_solve(diagnosed):
    diagnosed(is_infeasible=True, shortest=shortest(4.0))
    tried, _ = retried(Solves(FAILED))
    assert tried.solution.status is Status.NOT_CONVERGED
    assert tried.failure is not None


def along_route(energy):
    return TriedRoute(
        name="left", length_m=10.0, energy_J=energy, is_refined=False, is_kept=False, estimate_J=9.0
    )


@pytest.mark.parametrize("least_time", [None, shortest(12.5)])
def test_a_flight_on_a_coarse_mesh_contradicts_the_elastic_solve(diagnosed, least_time):
    diagnosed(is_infeasible=True, shortest=least_time)
    tried, _ = retried(Solves(FAILED), (along_route(None), along_route(700.0)))
    assert tried.solution.status is Status.NOT_CONVERGED
    (only,) = tried.failure.causes()
    assert only.startswith("1 flight keeps all limits on a coarse mesh, of 2 routes tried, but")


def test_without_a_flight_on_any_mesh_the_elastic_solve_stands(diagnosed):
    diagnosed(is_infeasible=True)
    tried, _ = retried(Solves(FAILED), (along_route(None), along_route(None)))
    assert tried.solution.status is Status.INFEASIBLE


@pytest.mark.parametrize(
    ("least_time", "status"),
    [(None, Status.NOT_CONVERGED), (shortest(12.5), Status.INFEASIBLE)],
)
def test_among_the_corridors_of_a_field_one_elastic_solve_proves_nothing(
    diagnosed, monkeypatch, least_time, status
):
    diagnosed(is_infeasible=True, shortest=least_time)
    monkeypatch.setattr(candidate, "has_corridors", lambda _told: True)
    tried, _ = retried(Solves(FAILED), (along_route(None),))
    assert tried.solution.status is status
    first = next(tried.failure.causes())
    assert first.startswith("no flight was found (routes tried: 1)") is (least_time is None)


def test_an_interruption_ends_the_retries(diagnosed):
    diagnosed()
    stopped = Pretended(Status.INTERRUPTED)
    tried, _ = retried(Solves(slowly=stopped))
    assert tried.solution is stopped
    assert tried.failure is None


def test_strategies_are_carried_out_while_they_apply_and_their_outcomes_recorded():
    search, stages = new_search(), []

    def act(counts, name):
        stages.append(search.stage)
        counts[name] = counts.get(name, 0) + 1
        return None if name == "silent" else f"{counts[name]}"

    table = [
        Strategy("twice", Stage.ROUTES, lambda _: True, partial(act, name="twice"), repeats=2),
        Strategy("never", Stage.COARSE, lambda _: False, partial(act, name="never")),
        Strategy("silent", Stage.COARSE, lambda _: True, partial(act, name="silent"), repeats=3),
        Strategy("once", Stage.REFINING, lambda n: "once" not in n, partial(act, name="once"), 9),
    ]
    counts = {}
    carry_out(table, counts, search)
    assert counts == {"twice": 2, "silent": 1, "once": 1}
    assert search.record == ["twice: 1", "twice: 2", "once: 1"]
    assert stages == [Stage.ROUTES, Stage.ROUTES, Stage.COARSE, Stage.REFINING]


def test_each_strategy_of_a_mission_has_a_name_of_its_own():
    names = [strategy.name for strategy in MISSION]
    assert len(set(names)) == len(names)


KINKED = ["power.model='constant_efficiency'", "power.regeneration=false"]
LOST_BEFORE = [
    ("mission.goal.position=[4.187, -7.089, -35.413]", "mission.duration=13.389"),
    (
        "mission.goal.position=[-0.816, -2.018, 7.944]",
        "mission.duration=14.956",
        "wind.use='constant'",
        "wind.speed=6.2415",
        "wind.direction=5.942",
        "wind.coupling='drag'",
        "vehicle.drag_quadratic=0.04213",
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize("lost_before", LOST_BEFORE)
def test_a_kinked_power_is_reached_from_wider_corners(lost_before):
    plan = solve_scenario(load_scenario(PAPER_CALM, [*KINKED, *lost_before]))
    assert plan.is_verified
    credited = [*KINKED[:1], "power.regeneration=true", *lost_before]
    assert plan.energy > solve_scenario(load_scenario(PAPER_CALM, credited)).energy


@pytest.mark.slow
def test_the_energy_of_a_flat_power_is_as_good_as_its_tolerance():
    """It was 1.2e-6 off where 1e-6 was allowed."""
    settings = KINKED[:1]
    wind = "scenarios/paper_wind.toml"
    plan = solve_scenario(load_scenario(wind, settings))
    finer = solve_scenario(load_scenario(wind, [*settings, "solver.tolerance=1e-8"]))
    assert plan.is_verified
    assert finer.is_verified
    assert plan.energy == pytest.approx(finer.energy, rel=1e-6)


def test_a_limit_counts_the_processor_s_time_and_not_what_else_the_machine_does(monkeypatch):
    class Busy(IterationClock):
        def perf_counter(self):
            return 1e6 * super().thread_time()

        def thread_time(self):
            return 0.0

    clock = Busy()
    for module in (planning, deadline):
        monkeypatch.setattr(module, "time", clock)
    scenario = load_scenario(PAPER_CALM, ["solver.time_limit=1.0"])
    assert solve_scenario(scenario, progress=clock.tick).is_verified


@pytest.mark.slow
@pytest.mark.parametrize(
    "mission",
    [
        (
            "mission.goal.position=[10.716, 25.477, 10.246]",
            "mission.duration=11.419",
            "wind={use='constant', speed=2.54, direction=5.201}",
            "vehicle.payload=0.102",
        ),
        (
            "mission.goal.position=[25.520, -0.599, 6.175]",
            "mission.duration=8.536",
            "wind={use='constant', speed=1.547, direction=2.925, coupling='acceleration'}",
            "vehicle.payload=0.205",
        ),
        (
            "mission.goal.position=[20.178, 3.551, 1.184]",
            "mission.duration=18.294",
            "wind={use='constant', speed=2.351, direction=2.884, coupling='drag'}",
            "vehicle.payload=0.013",
        ),
        (
            "mission.goal.position=[1.404, -22.850, -1.329]",
            "mission.duration=24.724",
            "wind={use='constant', speed=4.944, direction=3.436, coupling='acceleration'}",
            "vehicle.payload=0.198",
            "power.model='shaft'",
        ),
    ],
)
def test_rotors_that_chatter_under_a_flat_power_come_to_rest_within_the_limit(mission):
    flat = [*KINKED[:1], "power.regeneration=true", "solver.time_limit=150"]
    assert solve_scenario(load_scenario(PAPER_CALM, [*flat, *mission])).is_verified


@pytest.mark.slow
def test_rotors_that_still_chatter_at_the_limit_fly_a_usable_plan():
    """On fast processors the limit suffices for a verified plan."""
    mission = (
        "mission.goal.position=[7.706, -8.787, 27.629]",
        "mission.duration=11.291",
        "wind={use='constant', speed=4.424, direction=3.895, coupling='acceleration'}",
        "vehicle.payload=0.172",
        "power={model='shaft', regeneration=true}",
        "solver.time_limit=150",
    )
    plan = solve_scenario(load_scenario(PAPER_CALM, mission))
    assert plan.is_flyable
    assert plan.verification.flown_energy_J == pytest.approx(plan.energy, rel=1e-6)


@pytest.mark.slow
def test_a_mission_with_hardly_any_time_begins_on_the_mesh_of_the_shortest_flight():
    """On ten elements it cannot be flown."""
    mission = (
        "mission.goal.position=[-3.435, 9.134, -26.226]",
        "mission.duration=16.746",
        "wind={use='constant', speed=5.439, direction=1.499, coupling='acceleration'}",
        "vehicle.payload=0.150",
        "power.model='motor'",
    )
    assert solve_scenario(load_scenario(PAPER_CALM, mission)).is_verified


@pytest.mark.slow
def test_ways_past_waypoints_within_a_radius_are_found_by_way_of_the_waypoints_themselves():
    mission = (
        "mission.start.position=[-5.933, -7.656, 6.849]",
        "mission.goal.position=[8.009, 6.070, 4.513]",
        (
            "mission.waypoints=[{position=[6.909, -9.334, 7.153], hold=0.840, radius=0.860, "
            "at=6.215}, {position=[6.789, 2.029, 2.139], radius=0.274, yaw=0.894},"
            " {position=[7.923, 8.289, 1.458], radius=0.821}, {position=[-2.440, -7.453, 3.613]}]"
        ),
        "mission.duration=30.568",
        (
            "airspace.keep_out=[{name='mast', shape='cylinder', centre=[7.555, -7.393], "
            "radius=1.437, bottom=5.500, top=9.453}, "
            "{name='tank', shape='cylinder', centre=[1.780, -4.508], "
            "radius=0.567, bottom=3.256, top=5.588}]"
        ),
        "power.model='shaft'",
        "solver.max_refinements=0",
        "solver.time_limit=60",
    )
    plan = solve_scenario(load_scenario(PAPER_CALM, mission))
    assert plan.status is PlanStatus.SOLVED
    assert all(route.energy_J is not None for route in plan.routes)


@pytest.mark.lengthy
def test_without_zones_waypoints_within_a_radius_are_passed_by_way_of_themselves_too(monkeypatch):
    solve, solve_from = MissionProblem.solve_roughly, MissionProblem.solve_from
    plain_flights, guesses = [], []

    def noted(mission, **chosen):
        plain_flights.append(solve(mission, **chosen))
        return plain_flights[-1]

    def failing(mission, guess=None, mesh=None):
        if guess is None:
            return mission.solve(tolerance=None, options=SolverOptions(max_iterations=1))
        guesses.append(guess)
        return solve_from(mission, guess, mesh)

    monkeypatch.setattr(MissionProblem, "solve_roughly", noted)
    monkeypatch.setattr(MissionProblem, "solve_from", failing)
    mission = (
        "mission.start.position=[3.694, 7.765, 6.966]",
        "mission.goal.position=[-3.231, 5.085, 5.310]",
        (
            "mission.waypoints=[{position=[4.228, 6.727, 5.147]}, {position=[-5.140, 6.471, 1.337],"
            " radius=0.103}, {position=[-4.381, -7.643, 5.636], speed_max=1.291}]"
        ),
        "mission.duration='free'",
        "mission.price_of_time=33.1",
        "wind.use='constant'",
        "wind.speed=1.640",
        "wind.direction=1.295",
        "wind.coupling='drag'",
        "solver.max_refinements=0",
        "power.model='shaft'",
    )
    plan = solve_scenario(load_scenario(PAPER_CALM, mission))
    (plain,) = plain_flights
    assert plain.status.is_solved
    assert guesses[0] is plain.trajectory
    assert plan.attempts[1].startswith("from a flight exactly through the waypoints")
    assert plan.status is PlanStatus.SOLVED


FOUR_TURNS = (
    "mission.start.position=[-6.653, 3.754, 7.594]",
    "mission.goal.position=[-7.849, -0.682, 1.211]",
    (
        "mission.waypoints=[{position=[7.543, -3.736, 3.210]}, "
        "{position=[-6.985, 9.054, 5.422], radius=0.312, speed_max=1.510}, "
        "{position=[7.300, -5.694, 1.840], radius=0.947, yaw=-0.678}, "
        "{position=[-5.230, -6.557, 5.082], hold=0.981}]"
    ),
    "mission.duration=44.058",
    "airspace.ceiling=8.319",
    "power.model='shaft'",
)


@pytest.mark.slow
def test_convex_valleys_are_not_regularised():
    """Four turns in 44 s: steps solved to few digits crept through 1,600 iterations, and gave up.

    Curvatures counted wrong made Ipopt push against directions that its KKT matrix had right.
    """
    plan = solve_scenario(load_scenario(PAPER_CALM, FOUR_TURNS))
    assert plan.status is PlanStatus.VERIFIED


def test_a_solve_stopped_on_the_way_has_the_mission_s_own_numbers():
    scenario = load_scenario(PAPER_CALM, KINKED)
    plan = solve_scenario(scenario, progress=lambda iteration: iteration.iteration < 3)
    assert plan.status is PlanStatus.INTERRUPTED
    assert plan.solution.instance.overrides["power.smoothing"] == scenario.power.smoothing


@pytest.mark.parametrize(("value", "widths"), [(0.1, [10, 3, 1, 0.3]), (1.0, [10, 3]), (8.0, [])])
def test_corners_are_narrowed_to_the_one_asked_for(value, widths):
    scenario = load_scenario(PAPER_CALM, [*KINKED, f"power.smoothing={value}"])
    assert wider_smoothings(scenario) == tuple({"power.smoothing": w} for w in widths)
    assert wider_smoothings(load_scenario(PAPER_CALM)) == ()


@pytest.mark.slow
@pytest.mark.parametrize(("duration", "status"), [(3.41, "infeasible"), (3.44, "verified")])
def test_the_least_time_parts_what_can_be_flown_from_what_cannot(duration, status):
    plan = solve_scenario(load_scenario(PAPER_CALM, [f"mission.duration={duration}"]))
    assert plan.status.value == status
    if plan.failure is not None:
        assert 3.41 < plan.failure.shortest_duration_s < 3.44


MOMENTUM = ["power.model='momentum'", "vehicle.rotor_radius=0.12"]


def numbers_of_a_solve(planner, scenario, *, is_whole):
    """Return where a solve began, or ended, with its scales and bounds."""
    if is_whole:
        solution = planner.solve(scenario).solution
    else:
        solution = planner.problem_for(scenario)[0].solve(
            mesh=Mesh.uniform(3, 3),
            parameters=planner.parameters(scenario),
            options=SolverOptions(max_iterations=0),
        )
    kept = {"unknowns": solution.unknowns, "evaluator": id(solution.problem.evaluator)}
    return kept | vars(solution.scaling) | vars(solution.bounds)


@pytest.mark.parametrize(
    ("power", "is_whole"),
    [([], False), pytest.param(MOMENTUM, True, marks=pytest.mark.slow)],
)
def test_no_plan_depends_on_what_was_solved_before(power, is_whole):
    """The equations are compiled once; first point, scales and bounds are the mission's own."""
    coarse = [*power, "solver.elements=5", "solver.max_refinements=0"]
    before = ["mission.goal.position=[0, 30, 9]", "mission.duration=21.0", "vehicle.payload=0.2"]
    told, other = load_scenario(PAPER_CALM, coarse), load_scenario(PAPER_CALM, [*coarse, *before])
    # A builder of one's own is compiled anew for every scenario.
    planner, fresh = Planner(), Planner(partial(build_model))
    compiled = planner.problem_for(other)[0].evaluator
    after, alone = (numbers_of_a_solve(p, told, is_whole=is_whole) for p in (planner, fresh))
    assert after.pop("evaluator") == id(compiled) != alone.pop("evaluator")
    for name, numbers in alone.items():
        assert np.array_equal(after[name], numbers), name
