"""Print the table of problems: published optimum, the engine's at two tolerances, what it claims.

Run ``python -m tests.problems [name ...]``.
"""

import sys
import time
from importlib import import_module
from pathlib import Path

from pyomo_quad.collocation import compile

TOLERANCES = (1e-6, 1e-8)
COLUMNS = ("problem", "published", "at 1e-6", "at 1e-8", "off", "claimed", "points", "seconds")
HEADER = "{:<18}{:>18}{:>18}{:>18}{:>10}{:>10}{:>8}{:>9}"
LINE = "{:<18}{:>18.10g}{:>18.10g}{:>18.10g}{:>10.1e}{:>10.1e}{:>8d}{:>9.2f}"


def names():
    """Return the modules of this folder that state a problem."""
    files = sorted(Path(__file__).parent.glob("[!_]*.py"))
    return [file.stem for file in files]


def compiled(problem):
    """Return a problem compiled, with its free times."""
    model = problem.build()
    return compile(model, times=problem.times(model) if hasattr(problem, "times") else None)


def row(name):
    """Return what one problem's line holds; error, points and seconds are those at 1e-8."""
    problem = import_module(f"tests.problems.{name}")
    published = problem.objective()
    began = time.process_time()
    whole = compiled(problem)
    rough, fine = (whole.solve(tolerance=tolerance) for tolerance in TOLERANCES)
    off = abs(fine.objective - published) / max(1.0, abs(published))
    found = (rough.objective, fine.objective, off, fine.error_estimate, fine.mesh.points)
    return (name, published, *found, time.process_time() - began)


def main(chosen):
    sys.stdout.write(HEADER.format(*COLUMNS) + "\n")
    for name in chosen or names():
        sys.stdout.write(LINE.format(*row(name)) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
