"""Every public function has an example in its docstring, and each example is right.

Examples run in a folder of their own, which holds the shipped scenarios, a study of two durations
(`hop_study.toml`) and the folder `swept` of its results. They know `scenario`, a hop of 1 m in 4 s;
`plan` and `result`, its plan and its run; `m` and `solution`, the model of the example of
`collocation.solve` and its optimum.
"""

from doctest import NORMALIZE_WHITESPACE, DocTestFinder, DocTestRunner
from importlib import import_module
from inspect import isclass, unwrap
from pathlib import Path

import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Objective, Var

import pyomo_quad
from pyomo_quad.collocation import solve
from pyomo_quad.sweep import ResultStore, SilentListener, Sweep, design_sweep, load_study
from tests.architecture.test_public_api import public_names
from tests.sweep.sweeping import Here

ROOT = Path(__file__).parents[2]
# These start processes, draw many figures, or fly once more what `known` has flown.
SLOW = {
    "pyomo_quad.RunResult",
    "pyomo_quad.run_scenario",
    "pyomo_quad.sweep.cluster_workers",
    "pyomo_quad.sweep.estimate_sweep",
    "pyomo_quad.sweep.process_workers",
}
HOP = """
name = "hop"
vehicle = { use = "dji_phantom_2" }
power = { model = "motor" }
mission = { goal = { position = [1, 0, 0.5] }, duration = 4 }
"""
STUDY = """
name = "hop_study"
title = "Two durations of a hop"
scenario = "hop.toml"
report_on = ["energy_J"]

[[axis]]
path = "mission.duration"
values = [4.0, 5.0]
"""


def held():
    """Return the public functions and classes by name, each once."""
    found = {}
    for line in public_names():
        package, name = line.split()
        thing = getattr(import_module(package), name)
        if (isclass(thing) or hasattr(thing, "__code__") or hasattr(thing, "__wrapped__")) and (
            thing not in found.values()
        ):
            found[f"{package}.{name}"] = thing
    return found


def examples_of(name):
    """Return the examples of a public function, or of a public class and its methods."""
    thing = held()[name]
    home = import_module(unwrap(thing).__module__)
    kept = DocTestFinder(exclude_empty=True).find(thing, name, module=home, globs=vars(home))
    return [test for test in kept if test.examples]


def names():
    with_examples = [name for name in held() if examples_of(name)]
    return [
        pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name
        for name in with_examples
    ]


def straight_move():
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 1))
    m.x, m.u = Var(m.t), Var(m.t)
    m.dx_dt = DerivativeVar(m.x, wrt=m.t)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx_dt[t] == m.u[t])
    m.x[0].fix(0)
    m.x[1].fix(1)
    m.effort = Integral(m.t, rule=lambda m, t: m.u[t] ** 2)
    m.cost = Objective(expr=m.effort)
    return m


@pytest.fixture(scope="module")
def known():
    scenario = pyomo_quad.load_scenario(ROOT / "scenarios" / "paper_calm.toml").replace(
        {"mission": {"goal": {"position": [1.0, 0.0, 0.5]}, "duration": 4.0}}
    )
    result = pyomo_quad.run_scenario(scenario, baselines=[])
    solution = solve(straight_move())
    return {"scenario": scenario, "result": result, "plan": result.plan, "solution": solution}


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    folder = tmp_path_factory.mktemp("examples")
    (folder / "scenarios").symlink_to(ROOT / "scenarios")
    (folder / "hop.toml").write_text(HOP, encoding="utf-8")
    (folder / "hop_study.toml").write_text(STUDY, encoding="utf-8")
    loaded = load_study(folder / "hop_study.toml")
    design = design_sweep(loaded)
    with ResultStore.writing(folder / "swept", design) as store:
        Sweep(design, loaded.base, store, SilentListener()).run(Here())
    return folder


def test_every_public_function_has_an_example():
    without = [
        name for name, thing in held().items() if not isclass(thing) and not examples_of(name)
    ]
    assert without == []


@pytest.mark.parametrize("name", names())
def test_the_examples_are_right(name, known, swept, monkeypatch):
    monkeypatch.chdir(swept)
    told = []
    for test in examples_of(name):
        test.globs.update(known, m=straight_move())
        DocTestRunner(optionflags=NORMALIZE_WHITESPACE).run(test, out=told.append)
    assert told == []
