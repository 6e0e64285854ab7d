"""Iterations, meshes, points and seconds that no test holds, because rounding moves them.

    python -m tests.benchmarks counts

The problems are those of the tests that hold the optima.
"""

import signal
from contextlib import suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np

from pyomo_quad.collocation import Mesh, RefinementOptions, SolverOptions, compile
from tests.benchmarks.measuring import iterations_of, seconds
from tests.benchmarks.report import Table

TITLE = "Counts and times of what the tests solve"
ABOUT = (
    "Tests hold optima, and not how many iterations, meshes or points they take, nor how long: "
    "another processor rounds otherwise. These are the counts on this one. An iteration is one of "
    "Ipopt's, on all meshes of a refinement and of attempts given up. A warm start is that of the "
    "same problem with the numbers before the change. Seconds are processor seconds unless they "
    "are said to be on the clock."
)

TOLERANCE = 1e-6
MESH = Mesh.uniform(8, 5)


def _counted(problem, **arguments):
    """Return a solution and the iterations of all its meshes and attempts."""
    lines = []
    solution = problem.solve(**arguments, progress=lines.append)
    return solution, sum(line.iteration > 0 for line in lines)


def _cold_and_warm(problem, before=None, after=None, **how):
    first = problem.solve(**how, parameters=before or {})
    _, cold = _counted(problem, **how, parameters=after or {})
    _, warm = _counted(problem, **how, parameters=after or {}, warm_start=first)
    return cold, warm


def warm_starts():
    """Return the table of iterations from a cold start and from a warm one."""
    from tests.problems import brachistochrone, bryson_denham, goddard, hyper_sensitive
    from tests.unit.collocation.test_free_times import push_and_brake
    from tests.unit.collocation.test_joint import rocket
    from tests.unit.collocation.test_resolve import moved_mission, swing_up, wall_problem

    def timed(m, times):
        return compile(m, times=times)

    pushed, ascent = push_and_brake(), goddard.build()
    swing, (mission, here, there) = compile(swing_up()), moved_mission()
    refined, on_mesh = {"tolerance": TOLERANCE}, {"mesh": MESH}
    moved = {"start": 0.02}
    jobs = [
        ("brachistochrone, 8 x 5, unchanged", compile(brachistochrone.build()), {}, {}, on_mesh),
        ("pendulum, 8 x 5, start moved by 0.02 rad", swing, {}, moved, on_mesh),
        ("the same, refined", swing, {}, moved, refined),
        ("hyper-sensitive, unchanged", compile(hyper_sensitive.build()), {}, {}, refined),
        ("Bryson-Denham, unchanged", compile(bryson_denham.build()), {}, {}, refined),
        (
            "push and brake with free times, unchanged",
            timed(pushed, {1: pushed.T1, 2: pushed.T2}),
            {},
            {},
            refined,
        ),
        (
            "Goddard's rocket in three phases, unchanged",
            timed(ascent, goddard.times(ascent)),
            {},
            {},
            refined,
        ),
        ("the same, a set for each phase", timed(*rocket()), {}, {}, refined),
        ("paper_calm, start moved by 0.5 m", mission, here, there, refined),
    ]
    jobs += [
        (
            f"a wall moved from {old} to {new}, where other limits hold",
            wall_problem(),
            {"wall": old},
            {"wall": new},
            refined,
        )
        for old, new in ((0.2, 0.1), (0.1, 0.2), (0.3, 0.08))
    ]
    rows = [[name, *_cold_and_warm(p, old, new, **how)] for name, p, old, new, how in jobs]
    header = ["problem", "cold", "warm"]
    title = "Iterations from a cold start and from a warm one"
    return Table(name="counts_warm", title=title, header=header, rows=rows)


def others():
    """Return the table of other counts."""
    from pyomo_quad.collocation import Status
    from pyomo_quad.flight import Planner
    from pyomo_quad.scenario import load_scenario
    from tests.agreement.test_free_duration import free
    from tests.problems import bryson_denham
    from tests.problems.published.chemistry import lee_ramirez
    from tests.problems.published.mechanics import alp_rider
    from tests.unit.collocation.refining.test_refinement import limited_mass
    from tests.unit.flight.test_planning import FOUR_TURNS

    def on_mesh(problem, **how):
        settings = {"instance": problem.instance(), "options": SolverOptions()}
        return iterations_of(problem.solve_on_mesh(Mesh.uniform(5, 4), **settings, **how))

    def effort(limits_move):
        refinement = RefinementOptions(limits_move=limits_move)
        found = limited_mass().solve(tolerance=1e-8, refinement=refinement)
        assert found.status is Status.CONVERGED
        return sum(record.points * record.iterations for record in found.history)

    def planned(*settings):
        return planner.solve(load_scenario("scenarios/paper_calm.toml", settings))

    planner, wall, rider = Planner(), compile(bryson_denham.build()), compile(alp_rider())
    coarse = rider.solve(mesh=Mesh.uniform(40, 4))
    lost = compile(lee_ramirez()).solve()
    attitudes = [planned(f"vehicle.attitude={name!r}") for name in ("paper", "euler")]
    quick, turns = planner.solve(free(solver={})), planned(*FOUR_TURNS)
    last = planner.problem_for(quick.scenario)[0].solve(mesh=quick.trajectories.mesh)
    rows = [
        ["iterations, Bryson-Denham, 5 x 4, from the guess", on_mesh(wall)],
        ["iterations, the same from an elastic start", on_mesh(wall, is_elastic=True)],
        [
            "iterations, alp rider, 80 x 5, warm from 40 x 4",
            iterations_of(rider.solve(mesh=Mesh.uniform(80, 5), warm_start=coarse)),
        ],
        [
            "iterations times points, limited mass to 1e-8, limits at rest",
            effort(limits_move=False),
        ],
        ["the same, limits that move", effort(limits_move=True)],
        [
            f"iterations of each mesh, Lee-Ramirez bioreactor, {lost.status.value}",
            ", ".join(str(record.iterations) for record in lost.history),
        ],
        *(
            [
                f"iterations and points, paper_calm, attitude of {plan.scenario.vehicle.attitude}",
                f"{plan.iteration_count}, {plan.mesh.points}",
            ]
            for plan in attitudes
        ),
        [
            "most iterations of a mesh, paper_calm with free duration",
            max(record.iterations for record in quick.history),
        ],
        ["iterations of its last mesh from a cold start", iterations_of(last)],
        [
            f"most iterations of a mesh, four turns in 44 s, {turns.status.value}",
            max(record.iterations for record in turns.history),
        ],
    ]
    return Table(name="counts_others", title="Other counts", header=["what", "count"], rows=rows)


def _quickest(work, calls=1, repeats=5):
    """Return the processor seconds of a call, in the quickest of some repeats."""
    spent = []
    for _ in range(repeats):
        started = seconds()
        for _ in range(calls):
            work()
        spent.append((seconds() - started) / calls)
    return min(spent)


def _hostile(size):
    """Refuse files of so many letters that once took work in proportion to the size squared."""
    from pyomo_quad.scenario import ScenarioError
    from pyomo_quad.scenario.resolution import parse_toml
    from tests.fuzz.hostile import hostile_files
    from tests.fuzz.test_hostile_files import LONG_WORDS

    for name in LONG_WORDS:
        with suppress(ScenarioError, ValueError):
            parse_toml(hostile_files(size)[name] + "\n]")


def _until_the_end(number):
    """Return the seconds on the clock from a signal to the end of a solve that is at work."""
    from tests.cli.test_faults import begin, interrupt
    from tests.command import QUICK

    with TemporaryDirectory() as folder:
        process = begin(Path(folder) / "report", *QUICK)
        started = perf_counter()
        interrupt(process, number)
        return perf_counter() - started


def times():
    """Return the table of seconds: compilations, the controller's law, hostile files, signals."""
    from pyomo_quad.flight.baselines import start_state
    from pyomo_quad.flight.controller import COMMAND_SIZE, CONTROLLER_STATES
    from pyomo_quad.model import build_model
    from pyomo_quad.scenario import load_scenario
    from tests import flights
    from tests.agreement.test_controller_energy import in_numbers, looped
    from tests.unit.collocation.test_joint import rocket

    model = build_model(load_scenario("scenarios/paper_calm.toml"))
    phases, ends = rocket()
    dynamics, law, loop = looped("paper_wind")
    hover = start_state(flights.scenario("paper_wind"), dynamics)
    joint = np.concatenate([hover, np.ones(len(CONTROLLER_STATES) + 1)])
    command = np.ones(COMMAND_SIZE)
    rates = partial(loop.rates, 1.0, joint, command)
    plainly = partial(in_numbers, dynamics, law, 1.0, joint, command)
    found = {
        "paper_calm's model compiled": _quickest(partial(compile, model), repeats=1),
        "the rocket in three sets compiled": _quickest(
            partial(compile, phases, times=ends), repeats=1
        ),
        "the controller's law with the vehicle, once, compiled": _quickest(rates, calls=50),
        "the same in numbers": _quickest(plainly, calls=50),
        "seven hostile files of 2,000 letters": _quickest(partial(_hostile, 2_000)),
        "seven hostile files of 64,000 letters": _quickest(partial(_hostile, 64_000)),
        "from Ctrl-C to the end of a solve, on the clock": _until_the_end(signal.SIGINT),
        "from SIGTERM to the end of a solve, on the clock": _until_the_end(signal.SIGTERM),
    }
    rows = [[name, f"{spent:.2g}"] for name, spent in found.items()]
    return Table(name="counts_seconds", title="Seconds", header=["what", "s"], rows=rows)


def measure(_arguments):
    """Return the tables of warm starts, other counts and seconds."""
    return [warm_starts(), others(), times()]
