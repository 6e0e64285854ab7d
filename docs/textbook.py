"""Cells of the gallery of textbook problems: one call solves, asserts, tells and draws."""

import sys
from importlib import import_module
from inspect import getsource
from io import BytesIO
from pathlib import Path

from IPython.display import Image, Markdown, display

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np
from matplotlib.figure import Figure

from pyomo_quad.collocation import compile as compiled_model
from tests.problems.__main__ import cases, off_by

_TOLERANCE = 1e-6
# Problems that are solved to a larger tolerance here.  At 1e-6, rounding decides whether singular5
# converges: on one of four processors tried, the controls of a restart by Pontryagin's principle
# lead to no optimum, and the status is `tolerance_not_met` with an optimum 5e-7 too high.
_ROUGHER = {"singular5": 1e-5}
# Relative error of an optimum, beside its tolerance, of problems that end in a corner of it.
_MARGIN = 10.0
_MOST_CURVES = 8
_SAMPLES = 401


def solved(name):
    """Solve a problem, assert its published optimum, and return the problem and its solution."""
    case = next(case for case in cases() if case.name == name)
    model = case.build()
    problem = compiled_model(model, times=None if case.times is None else case.times(model))
    tolerance = _ROUGHER.get(name, _TOLERANCE)
    solution = problem.solve(tolerance=tolerance, starts=case.starts)
    assert solution.is_converged, solution.message
    assert off_by(case, solution.objective) < _MARGIN * tolerance
    return case, solution


def show(name):
    """Solve a problem, and display its statement, its numbers and its plot."""
    case, solution = solved(name)
    display(Markdown(_told(case, solution)))
    return _drawn(solution)


def source_of(name):
    """Return the source of the declaration of a problem with a file of its own."""
    return getsource(import_module(f"tests.problems.{name}").build)


def _told(case, solution):
    statement = ""
    try:
        statement = import_module(f"tests.problems.{case.name}").__doc__.split("Source:")[0]
    except ImportError:
        statement = (case.build.__doc__ or "").strip()
    shown = f"```text\n{statement.strip()}\n```\n\n" if statement else ""
    source = " ".join(case.source.split())
    return (
        f"{shown}Source: {source}\n\n"
        f"| published | found | estimated error | points |\n|---:|---:|---:|---:|\n"
        f"| {case.published} | {solution.objective:.9g} | {solution.error_estimate:.1e} "
        f"| {solution.mesh.points} |\n"
    )


def _drawn(solution):
    times = None  # of several horizons, the nodes
    if solution.parts == (solution,):
        times = np.linspace(solution.times[0], solution.times[-1], _SAMPLES)
    frame = solution.to_frame(times) if times is not None else solution.to_frame()
    time, *names = frame.columns
    shown = [name for name in names if frame[name].dtype.kind == "f"][:_MOST_CURVES]
    figure = Figure(figsize=(7.2, 2.4), layout="constrained")
    axes = figure.subplots()
    for name in shown:
        axes.plot(frame[time], frame[name], label=name)
    axes.set_xlabel(time)
    axes.legend(fontsize="small", ncols=2, loc="center left", bbox_to_anchor=(1.0, 0.5))
    drawn = BytesIO()
    figure.savefig(drawn, format="png", dpi=130)
    return Image(drawn.getvalue(), width=620)
