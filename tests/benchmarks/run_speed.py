"""Whole commands, side by side with those of another environment.

    python -m tests.benchmarks run --against /path/to/another/.venv/bin/python

The two take turns, so that what else the machine does weighs on both.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

from tests.benchmarks.measuring import ONE_THREAD
from tests.benchmarks.report import Table

TITLE = "Whole commands"
ABOUT = (
    "From the start of the process to its end, imports, figures and report included, with bytecode "
    "as an installed package has it. Processor seconds are those of the process and its children, "
    "user and system; the least, middle and greatest of some runs. `before` is another "
    "environment, whose runs take turns with these, each with the scenario of that name in its own "
    "checkout. The last column is the clock on the wall without what the command itself counts as "
    "its solve. Flights that are planned again on their way, which older checkouts do not know, "
    "are flown where the command does not say otherwise. Checkouts that have no `--figures svg` "
    "draw each figure as PNG too."
)
PACKAGE = "import pyomo_quad; print(pyomo_quad.__file__)"
# Of an option for a table that a scenario does not have, it knows nothing.
REPLANNED = "baseline.mpc"
COMMANDS = (
    ("run", "paper_calm.toml"),
    ("run", "paper_wind.toml", f"--set={REPLANNED}.knowledge=[]"),
    ("run", "paper_wind.toml"),
    ("solve", "paper_calm.toml", "--quiet"),
    ("solve", "paper_wind.toml", "--quiet", "--figures", "none"),
)
# As `pip install` leaves it; the first run of each environment makes what is missing.
KEPT_BYTECODE = {"PYTHONDONTWRITEBYTECODE": ""}
TIMES = 5
_BAD_USAGE = 2


def scenarios_of(python):
    """Return the scenarios of an environment's own checkout, whose fields are of its age."""
    elsewhere = tempfile.gettempdir()
    module = subprocess.check_output([python, "-c", PACKAGE], text=True, cwd=elsewhere)
    return Path(module).parents[1] / "scenarios"


def spent(python, scenarios, command, scenario, *options):
    """Return processor and wall seconds of one command in a folder of its own, and those to spare.

    The last are wall seconds beyond the command's own solve, as its summary has it. None where an
    older environment does not know an option.
    """
    file = scenarios / scenario
    if f"[{REPLANNED}]" not in file.read_text(encoding="utf-8"):
        options = [option for option in options if REPLANNED not in option]
    arguments = [python, "-m", "pyomo_quad", command, str(file), *options]
    with tempfile.TemporaryDirectory() as folder:
        before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        finished = subprocess.run(
            arguments,
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
            env=os.environ | ONE_THREAD | KEPT_BYTECODE,
        )
        wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
        if finished.returncode == _BAD_USAGE:
            return None
        if finished.returncode != 0:
            raise SystemExit(f"{' '.join(arguments)} failed:\n{finished.stderr}")
        (summary,) = Path(folder).rglob("summary.json")
        solve = json.loads(summary.read_text(encoding="utf-8"))["wall_s"]["solve"]
    processor = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    return processor, wall, wall - solve


def measure(arguments):
    """Return a row for each command and environment, and by how much this one is faster."""
    pythons = {"now": sys.executable}
    if arguments.against is not None:
        pythons = {"before": str(arguments.against), **pythons}
    environments = {name: (python, scenarios_of(python)) for name, python in pythons.items()}
    rows, gains = [], []
    for command in COMMANDS:
        found = {name: [] for name in environments}
        for _ in range(TIMES):
            for name, environment in environments.items():
                found[name].append(spent(*environment, *command))
        found = {name: times for name, times in found.items() if None not in times}
        label = f"`{' '.join(command)}`"
        for name, times in found.items():
            kinds = [
                f"{min(t):.2f}, {median(t):.2f}, {max(t):.2f}" for t in zip(*times, strict=True)
            ]
            rows.append([label, name, *kinds])
        if "before" in found:
            middles = {name: map(median, zip(*found[name], strict=True)) for name in found}
            pairs = zip(middles["before"], middles["now"], strict=True)
            gains.append([label, *(f"{before / now:.2f}" for before, now in pairs)])
    tables = [
        Table(
            name="run",
            title=f"Least, median and greatest of {TIMES} runs",
            header=["command", "environment", "processor s", "wall s", "beside the solve s"],
            rows=rows,
        )
    ]
    if gains:
        header = [
            "command",
            *(f"{kind}, times as fast" for kind in ("processor", "wall", "beside it")),
        ]
        title = "Medians, before over now"
        tables.append(Table(name="run_gain", title=title, header=header, rows=gains))
    return tables
