"""Whole jobs: refinement to a tolerance, re-solves, a long mission, growth, and a peer.

    python -m tests.benchmarks resolve

The peer, rockit (`pip install rockit-meco`), is left out where it is not installed.
"""

import importlib.util
import sys

from tests.benchmarks.measuring import in_own_process, iterations_of, report, seconds, whole_process
from tests.benchmarks.report import Table

TITLE = "Whole jobs, growth and a peer"
ABOUT = (
    "What comes after the first solve, how cost grows with the mesh, and a peer as a whole "
    "process. Processor seconds of one thread; all but whole processes leave imports out."
)

DEGREE = 3
TOLERANCE = 1e-6
GROWTH = (40, 100, 400, 1000, 4000)
LONG = {"mission.duration": 60.0, "mission.goal.position": [36.0, 42.0, 48.0]}
LONG_ELEMENTS = 2000
RESOLVES = {
    "mean wind 1.0 to 1.1 m/s": ("paper_wind", {"wind.x.mean": 1.1}),
    "start moved by 0.5 m": ("paper_calm", {"mission.start.position": [0.5, 0.0, 0.0]}),
}
COMPARED = (40, 100, 400)
OURS = """
from pyomo_quad.collocation import Mesh, solve
from pyomo_quad.model import build_model
from pyomo_quad.scenario import load_scenario
model = build_model(load_scenario("scenarios/paper_calm.toml"))
print(solve(model, mesh=Mesh.uniform({}, {})).objective)
"""
# Of a re-solve only the quickest of several in one process counts: it is to be done often.
TIMES = 5


def _scenario(name, changes=None):
    from pyomo_quad.scenario import load_scenario

    scenario = load_scenario(f"scenarios/{name}.toml")
    return scenario.with_values(changes) if changes else scenario


def measure_refinement(_argument):
    """Build, compile, refine to the tolerance; then once more with the flight that verifies."""
    from pyomo_quad.collocation import compile
    from pyomo_quad.flight import Planner
    from pyomo_quad.model import build_model

    scenario = _scenario("paper_calm")
    started = seconds()
    solution = compile(build_model(scenario)).solve(tolerance=TOLERANCE)
    solved = seconds()
    plan = Planner().solve(scenario)
    report(
        total_s=solved - started,
        planned_s=seconds() - solved,
        meshes=len(solution.history),
        points=solution.mesh.points,
        error=solution.error_estimate,
        status=solution.status.value,
        energy_J=solution.objective,
        plan_status=plan.status.value,
    )


def measure_resolve(label):
    """Cold: build, compile, solve.  Warm: the compiled problem again, from the last solution."""
    from pyomo_quad.collocation import Mesh, compile
    from pyomo_quad.model import build_model, parameter_values

    name, changes = RESOLVES[label]
    old, new = parameter_values(_scenario(name)), parameter_values(_scenario(name, changes))
    mesh = Mesh.uniform(40, DEGREE)
    started = seconds()
    problem = compile(build_model(_scenario(name)))
    compiled = seconds()
    first = problem.solve(mesh=mesh, parameters=old)
    warm_s = cold_s = float("inf")
    for _ in range(TIMES):
        before = seconds()
        warm = problem.solve(mesh=mesh, parameters=new, warm_start=first)
        between = seconds()
        cold = problem.solve(mesh=mesh, parameters=new)
        cold_s = min(cold_s, seconds() - between)
        warm_s = min(warm_s, between - before)
    if abs(warm.objective - cold.objective) > TOLERANCE * cold.objective:
        raise SystemExit(f"{label}: warm {warm.objective} J, cold {cold.objective} J")
    report(
        total_s=warm_s,
        compile_s=compiled - started,
        cold_s=cold_s,
        warm_iterations=iterations_of(warm),
        cold_iterations=iterations_of(cold),
    )


def measure_mesh(elements, changes=None):
    from pyomo_quad.collocation import Mesh, compile
    from pyomo_quad.model import build_model

    scenario = _scenario("paper_calm", changes)
    started = seconds()
    problem = compile(build_model(scenario))
    mesh = Mesh.uniform(int(elements), DEGREE)
    program = problem.program(mesh, problem.instance())
    ready = seconds()
    solution = problem.solve(mesh=mesh)
    solved = seconds()
    if not solution.is_converged:
        raise SystemExit(solution.message)
    report(
        set_up_s=ready - started,
        solve_s=solved - ready,
        total_s=solved - started,
        variables=program.layout.unknowns,
        iterations=iterations_of(solution),
        energy_J=solution.objective,
    )


def measure_long(elements):
    measure_mesh(elements, LONG)


MEASURES = {
    "refinement": measure_refinement,
    "resolve": measure_resolve,
    "growth": measure_mesh,
    "long": measure_long,
}


def jobs():
    """Return the table of whole jobs."""
    refined = in_own_process(__spec__.name, "refinement", "-", repeats=3)
    rows = [
        [
            f"test 1 to a tolerance of {TOLERANCE:g}, build and compile included",
            f"{refined['total_s']:.2f}",
            (
                f"{refined['status']}: {refined['meshes']} meshes, {refined['points']} points, "
                f"error {refined['error']:.1e}, {refined['energy_J']:.4f} J"
            ),
        ],
        [
            "the same as a plan, flown and checked by SciPy",
            f"{refined['planned_s']:.2f}",
            refined["plan_status"],
        ],
    ]
    for label in RESOLVES:
        found = in_own_process(__spec__.name, "resolve", label, repeats=3)
        whole = found["compile_s"] + found["cold_s"]
        rows.append(
            [
                f"40 elements of degree {DEGREE} again, {label}, warm",
                f"{found['total_s']:.3f}",
                (
                    f"{found['warm_iterations']} iterations; cold {found['cold_s']:.3f} s in "
                    f"{found['cold_iterations']}, with build and compile {whole:.2f} s: "
                    f"{whole / found['total_s']:.0f} times"
                ),
            ]
        )
    long = in_own_process(__spec__.name, "long", LONG_ELEMENTS)
    rows.append(
        [
            f"60 s mission, {LONG_ELEMENTS} elements of degree {DEGREE}",
            f"{long['total_s']:.1f}",
            (
                f"{long['variables']} variables, {long['iterations']} iterations, "
                f"{long['peak_MiB']:.0f} MiB, {long['energy_J']:.2f} J"
            ),
        ]
    )
    header = ["job", "s", "note"]
    return Table(name="resolve_jobs", title="Whole jobs", header=header, rows=rows)


def growth():
    """Return the table of growth with the mesh."""
    rows = []
    for elements in GROWTH:
        found = in_own_process(__spec__.name, "growth", elements)
        share = found["solve_s"] / found["iterations"] / found["variables"]
        rows.append(
            [
                elements,
                found["variables"],
                f"{found['set_up_s']:.2f}",
                f"{found['solve_s']:.2f}",
                found["iterations"],
                f"{1e6 * share:.1f}",
                f"{found['peak_MiB']:.0f}",
            ]
        )
    header = ["elements", "variables", "set-up s", "solve s", "iterations"]
    header += ["us per iteration and variable", "peak MiB"]
    return Table(name="resolve_growth", title="Growth with the mesh", header=header, rows=rows)


def peers():
    """Return the table of whole processes, from the start of Python to the printed energy."""
    has_rockit = importlib.util.find_spec("rockit") is not None
    rows = []
    for elements in COMPARED:
        rows.append(["this engine", elements, *_whole(["-c", OURS.format(elements, DEGREE)])])
        if has_rockit:
            rows.append(["rockit", elements, *_whole(["-m", "tests.benchmarks.peer", elements])])
    header = ["whole process", "elements", "s", "energy J"]
    title = "From the start of Python to the printed energy"
    return Table(name="resolve_peer", title=title, header=header, rows=rows)


def _whole(arguments):
    spent, energy = whole_process(*map(str, arguments), repeats=2)
    return [f"{spent:.1f}", f"{float(energy):.4f}"]


def measure(_arguments):
    """Return the tables of jobs, growth and whole processes."""
    return [jobs(), growth(), peers()]


if __name__ == "__main__":
    MEASURES[sys.argv[2]](sys.argv[3])
