"""The benchmark's judgement of controls, and its problems, against closed forms."""

import sys
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.benchmarks import peer_table
from tests.benchmarks.peer_table import RUNGS, WANTED, judged
from tests.benchmarks.peers import by_pyomo_quad
from tests.benchmarks.peers.problems import PROBLEMS
from tests.problems import brachistochrone
from tests.problems.__main__ import cases

NAMES = {"oscillator", "soft landing", "moon landing", "container crane", "catalyst mixing",
         "parallel reactions", "zermelo", "bryson-denham", "brachistochrone"}  # fmt: skip


def cycloid(shift=0.0):
    """Return the closed form's control of the brachistochrone in ten pieces."""
    ends, pieces = np.linspace(0.0, 1.0, 11), []
    for begin, end in pairwise(ends):
        nodes = np.linspace(begin, end, 4)
        angles = brachistochrone.control(nodes)["theta"] + shift
        pieces.append((begin, end, nodes.tolist(), angles.reshape(-1, 1).tolist()))
    return pieces


def test_a_closed_form_is_judged_to_be_accurate_and_a_wrong_one_by_what_it_misses():
    problem = PROBLEMS["brachistochrone"]
    error, objective = judged(problem, problem.best, cycloid())
    assert objective == pytest.approx(brachistochrone.objective())
    assert error < 1e-7
    assert judged(problem, problem.best, cycloid(shift=0.01))[0] > 10 * WANTED
    assert judged(problem, 1.01 * problem.best, cycloid())[0] > 10 * WANTED


def test_the_best_known_are_those_of_the_textbook_problems():
    known = {case.name.replace("_", " "): case for case in cases()}
    known["bryson-denham"] = known.pop("bryson denham")
    checked = 0
    for name, problem in PROBLEMS.items():
        if name.lower() in NAMES:
            case = known[name.lower()]
            digits = case.resolution + 1e-9 * abs(case.value)
            assert abs(abs(problem.best) - abs(case.value)) <= digits, name
            checked += 1
    assert checked == len(NAMES)


def test_the_leg_flown_backwards_returns_to_where_forward_rates_began():
    leg, mission = PROBLEMS["the same, a waypoint halfway"], PROBLEMS["the paper's mission"]
    goal = np.array([end for _, end, *_ in mission.states.values()], dtype=float)
    start = np.array([begin for begin, *_ in leg.states.values()], dtype=float)
    assert start[:16] - start[16:] == pytest.approx(goal)
    controls = np.array([40.0, -30.0, 20.0, 10.0, -20.0, 25.0, 30.0, -35.0])

    def flown(problem, state, u):
        rates = lambda _t, x: problem.rates(np, x, u)  # noqa: E731
        return solve_ivp(rates, (0.0, 2.0), state, rtol=1e-10, atol=1e-10).y[:, -1]

    met = flown(leg, start, controls)
    assert met[:16] == pytest.approx(flown(mission, start[:16], controls[:4]), abs=1e-7)
    assert flown(mission, met[:16] - met[16:], controls[4:]) == pytest.approx(goal, abs=1e-7)


def test_a_first_guess_ends_where_the_problem_says_and_otherwise_at_the_start():
    assert PROBLEMS["brachistochrone"].guess(1.0) == [10, 5, 10]
    assert PROBLEMS["moon landing"].guess(1.0) == [0, 0, 1]


@pytest.mark.lengthy
def test_a_peer_that_runs_too_long_is_ended_by_its_processor_seconds(monkeypatch, tmp_path):
    monkeypatch.setattr(peer_table, "PATIENCE_S", 1)
    monkeypatch.setattr(peer_table, "CACHE", tmp_path)
    looping = tmp_path / "looping.py"
    looping.write_text("import resource, sys\nresource.setrlimit(resource.RLIMIT_CPU,"
                       "(int(sys.argv[4]), -1))\nwhile True: pass\n")  # fmt: skip
    monkeypatch.setattr(peer_table, "SCRIPT", looping)
    ended = peer_table.solve(peer_table.OURS, sys.executable, "brachistochrone", 1e-3)
    assert ended.said == "ended after 1 s of the processor"
    assert ended.error == float("inf")


@pytest.mark.lengthy
@pytest.mark.parametrize("name", ["brachistochrone", "soft landing"])
def test_this_engine_reaches_what_peers_are_asked_for(name):
    problem = PROBLEMS[name]
    errors = []
    for tolerance in RUNGS["pyomo_quad"][1:4]:
        duration, pieces, _ = by_pyomo_quad.solve(problem, tolerance)
        errors.append(judged(problem, duration, pieces)[0])
    assert min(errors) <= WANTED
