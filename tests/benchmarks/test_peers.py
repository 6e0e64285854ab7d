"""The benchmark's judgement of controls, and its problems, against closed forms."""

from itertools import pairwise

import numpy as np
import pytest

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


@pytest.mark.parametrize("name", ["brachistochrone", "soft landing"])
def test_this_engine_reaches_what_peers_are_asked_for(name):
    problem = PROBLEMS[name]
    errors = []
    for tolerance in RUNGS["pyomo_quad"][1:4]:
        duration, pieces, _ = by_pyomo_quad.solve(problem, tolerance)
        errors.append(judged(problem, duration, pieces)[0])
    assert min(errors) <= WANTED
