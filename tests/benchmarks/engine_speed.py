"""Speed and memory of the engine beside the two usual ways to solve the same problem.

    python -m tests.benchmarks engine

Every row is a process of its own.  Fails if the energies of one mesh differ by more than a
millionth.
"""

import sys

from tests.benchmarks.measuring import in_own_process, iterations_of, report, seconds
from tests.benchmarks.report import Table

TITLE = "The engine beside the two usual ways"
ABOUT = (
    "The paper's first mission under the motors' electrical power, at elements of degree 3: by "
    "this engine; the same declared model through stock `dae.collocation`, an NL file, CasADi's "
    "derivatives and cyipopt; and the mission written by hand in CasADi with its own Ipopt. Each "
    "rival has its best form. Seconds are processor seconds of one thread without imports; memory "
    "holds them."
)
DEGREE = 3
SCENARIO = "scenarios/paper_calm.toml"
AGREEMENT = 1e-6
NAMES = {"engine": "this engine", "stock": "stock", "handwritten": "by hand"}
# The quickest of so many runs, to keep a busy machine out of the small numbers.
REPEATS = {40: 3, 100: 3, 400: 1, 4000: 1}
RIVALS = ("stock", "handwritten")
COMPARED, ALONE = (40, 100, 400), 4000
HEADER = (
    "elements", "formulation", "build s", "derivatives s", "solve s", "total s", "variables",
    "iterations", "peak MiB", "energy J",
)  # fmt: skip


def measure_engine(elements):
    from pyomo_quad.collocation import Mesh, compile
    from pyomo_quad.model import build_model
    from pyomo_quad.scenario import load_scenario

    scenario = load_scenario(SCENARIO)
    started = seconds()
    model = build_model(scenario)
    built = seconds()
    problem = compile(model)
    mesh = Mesh.uniform(elements, DEGREE)
    program = problem.program(mesh, problem.instance())
    derived = seconds()
    solution = problem.solve(mesh=mesh)
    solved = seconds()
    if not solution.is_converged:
        raise SystemExit(solution.message)
    report(
        build_s=built - started,
        derivatives_s=derived - built,
        solve_s=solved - derived,
        total_s=solved - started,
        variables=program.layout.unknowns,
        iterations=iterations_of(solution),
        energy_J=solution.objective,
    )


def measure_stock(elements):
    from pyomo_quad.model import build_model
    from pyomo_quad.scenario import load_scenario
    from tests.benchmarks.stock_route import solve_by_stock_route

    scenario = load_scenario(SCENARIO)
    started = seconds()
    model = build_model(scenario)
    built = seconds()
    numbers = solve_by_stock_route(model, elements, DEGREE)
    report(
        **numbers,
        build_s=built - started + numbers["discretise_s"],
        total_s=seconds() - started,
    )


def measure_handwritten(elements):
    from tests.benchmarks.handwritten import solve_by_hand

    result = solve_by_hand(elements, DEGREE)
    report(
        build_s=result.build_s,
        derivatives_s=result.derivatives_s,
        solve_s=result.solve_s,
        total_s=result.build_s + result.derivatives_s + result.solve_s,
        variables=result.variables,
        iterations=result.iterations,
        energy_J=result.energy_J,
    )


MEASURES = {
    "engine": measure_engine,
    "stock": measure_stock,
    "handwritten": measure_handwritten,
}


def row(elements, name, numbers):
    spent = [f"{numbers[k]:.2f}" for k in ("build_s", "derivatives_s", "solve_s", "total_s")]
    counts = [numbers["variables"], numbers["iterations"], f"{numbers['peak_MiB']:.0f}"]
    return [elements, NAMES[name], *spent, *counts, f"{numbers['energy_J']:.6f}"]


def measured(elements, names):
    found = {
        name: in_own_process(__spec__.name, name, elements, repeats=REPEATS[elements])
        for name in names
    }
    energies = [numbers["energy_J"] for numbers in found.values()]
    if max(energies) - min(energies) > AGREEMENT * max(energies):
        raise SystemExit(f"energies differ at {elements} elements: {energies}")
    return found


def measure(_arguments):
    """Return the table of all formulations, and how many times as fast this engine is."""
    found = {elements: measured(elements, NAMES) for elements in COMPARED}
    found[ALONE] = measured(ALONE, ["engine"])
    rows = [row(n, name, held) for n, by_name in found.items() for name, held in by_name.items()]
    times = [
        [
            n,
            *(
                f"{found[n][name]['total_s'] / found[n]['engine']['total_s']:.1f}"
                for name in RIVALS
            ),
        ]
        for n in COMPARED
    ]
    header = ["elements", *(f"{NAMES[name]}, times as long" for name in RIVALS)]
    return [
        Table(name="engine", title="Each formulation", header=HEADER, rows=rows),
        Table(
            name="engine_gain", title="Total time beside this engine's", header=header, rows=times
        ),
    ]


if __name__ == "__main__":
    MEASURES[sys.argv[2]](int(sys.argv[3]))
