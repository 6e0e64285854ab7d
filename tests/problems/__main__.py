"""Print the table of problems: published optimum, the engine's at two tolerances, what it claims.

Run ``python -m tests.problems [--no-stock] [name ...]``.  Seconds are of the processor; `stock` is
the optimum of the same model on 30 elements of 3 points of `pyomo.dae`, its integrals trapezoids.
"""

import sys
import time
from importlib import import_module
from pathlib import Path

from pyomo.common.errors import PyomoException
from pyomo.environ import TransformationFactory

from pyomo_quad.collocation import EngineError, SolverOptions, compile
from tests.problems.published import chemistry, flight, geometry, mechanics
from tests.problems.published.statement import Case

TOLERANCES = (1e-6, 1e-8)
COLUMNS = (
    "problem",
    "published",
    "at 1e-6",
    "at 1e-8",
    "off",
    "claimed",
    "points",
    "s at 1e-6",
    "s at 1e-8",
    "stock",
)
HEADER = "{:<22}{:>18}{:>18}{:>18}{:>10}{:>10}{:>8}{:>11}{:>11}{:>14}"
LINE = "{:<22}{:>18}{:>18.11g}{:>18.11g}{:>10.1e}{:>10.1e}{:>8d}{:>11.2f}{:>11.2f}{:>14}"
# Seconds that a solve is worth waiting for.
_PATIENCE = 120.0


def textbook(name):
    """Return a module of this folder as a case."""
    problem = import_module(f"tests.problems.{name}")
    return Case(
        name=name,
        build=problem.build,
        published=float(problem.objective()),
        source=problem.__doc__.split("Source: ")[-1],
        times=getattr(problem, "times", None),
    )


def cases():
    """Return every problem: those with known trajectories, then those with a known optimum."""
    files = sorted(Path(__file__).parent.glob("[!_]*.py"))
    found = [textbook(file.stem) for file in files]
    for module in (geometry, mechanics, flight, chemistry):
        found.extend(module.CASES)
    return found


def names():
    """Return the names of all problems."""
    return [case.name for case in cases()]


def compiled_case(case):
    """Return a problem compiled, with its free times."""
    m = case.build()
    return compile(m, times=None if case.times is None else case.times(m))


def off_by(case, objective):
    """Return by how much an objective misses what is published, beyond its last digit, relative."""
    missed = max(0.0, abs(objective - case.value) - case.resolution)
    return missed / max(1.0, abs(case.value))


def stock(case):
    """Return what `pyomo.dae`'s own collocation makes of a problem, "-" where nothing."""
    if case.times is not None:
        return "-"
    m = case.build()
    try:
        TransformationFactory("dae.collocation").apply_to(m, nfe=30, ncp=3, scheme="LAGRANGE-RADAU")
        options = SolverOptions(max_wall_s=_PATIENCE)
        solution = compile(m).solve(options=options)
    except (PyomoException, EngineError, ValueError, TypeError, KeyError):
        return "-"
    return f"{solution.objective:.8g}" if solution.is_converged else "-"


def row(case, *, with_stock=True):
    """Return what one problem's line holds; error and points are those at 1e-8."""
    compiled = compiled_case(case)
    solutions, seconds = [], []
    for tolerance in TOLERANCES:
        began = time.process_time()
        solutions.append(
            compiled.solve(
                tolerance=tolerance,
                starts=case.starts,
                options=SolverOptions(max_wall_s=_PATIENCE),
            )
        )
        seconds.append(time.process_time() - began)
    rough, fine = solutions
    published = case.published if isinstance(case.published, str) else f"{case.published:.11g}"
    found = (rough.objective, fine.objective, off_by(case, fine.objective), fine.error_estimate)
    beside = stock(case) if with_stock else ""
    return (case.name, published, *found, fine.mesh.points, *seconds, beside)


def main(chosen):
    with_stock = "--no-stock" not in chosen
    wanted = {name for name in chosen if name != "--no-stock"}
    sys.stdout.write(HEADER.format(*COLUMNS).rstrip() + "\n")
    total = [0.0, 0.0]
    for case in cases():
        if wanted and case.name not in wanted:
            continue
        cells = row(case, with_stock=with_stock)
        total = [t + s for t, s in zip(total, cells[7:9], strict=True)]
        sys.stdout.write(LINE.format(*cells).rstrip() + "\n")
        sys.stdout.flush()
    sys.stdout.write(f"{total[0]:.1f} s at 1e-6, {total[1]:.1f} s at 1e-8\n")


if __name__ == "__main__":
    main(sys.argv[1:])
