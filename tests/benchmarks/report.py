"""The benchmarks' report, made anew from the results that each benchmark left.

A result is a JSON file with what was measured, when and on what, and a CSV file for each table.
"""

import csv
import json
import os
import platform
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

FOLDER = Path(__file__).parents[2] / "reports" / "benchmarks"
REPORT = "report.md"
NAMES = (
    "run", "jobs", "engine", "peers", "resolve", "counts", "missions", "strangers", "robustness",
    "places", "sweep", "mpc", "charge", "fields", "pairs", "holds",
)  # fmt: skip
PACKAGES = ("pyomo_quad", "pyomo", "casadi", "cyipopt-wheels", "numpy", "scipy")
HEADING = """# Benchmarks

Written by `python -m tests.benchmarks`, which measures all, or by `python -m tests.benchmarks
NAME...`, which measures some and leaves the others as they were.
[tests/benchmarks](../../tests/benchmarks/README.md) tells of each, and of what was tried to make a
solve faster.
"""


@dataclass(frozen=True, kw_only=True)
class Table:
    name: str
    title: str
    header: list[str]
    rows: list[list]

    def markdown(self):
        cells = [[str(cell).replace("|", "\\|") for cell in row] for row in self.rows]
        lines = [self.header, ["---"] * len(self.header), *cells]
        return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def conditions():
    """Return when and on what this process measures."""
    names = [
        line.partition(":")[2].strip()
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        if line.startswith("model name")
    ]
    found = {"Python": platform.python_version()} | {name: version(name) for name in PACKAGES}
    return {
        "measured": datetime.now(UTC).date().isoformat(),
        "machine": f"{os.cpu_count()} cores of {names[0] if names else platform.machine()}",
        "load": round(os.getloadavg()[0], 1),
        "versions": found,
    }


def store(name, benchmark, tables, folder=FOLDER):
    """Keep what a benchmark, a module with `TITLE` and `ABOUT`, found."""
    folder.mkdir(parents=True, exist_ok=True)
    for table in tables:
        with (folder / f"{table.name}.csv").open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([table.header, *table.rows])
    result = conditions() | {
        "title": benchmark.TITLE,
        "about": benchmark.ABOUT,
        "tables": {table.name: table.title for table in tables},
    }
    text = json.dumps(result, indent=2) + "\n"
    (folder / f"{name}.json").write_text(text, encoding="utf-8")


def render(folder=FOLDER):
    """Return the report of the results that are there."""
    stored = [folder / f"{name}.json" for name in NAMES]
    return HEADING + "".join(_section(file) for file in stored if file.exists())


def _section(file):
    result = json.loads(file.read_text(encoding="utf-8"))
    versions = ", ".join(f"{name} {number}" for name, number in result["versions"].items())
    parts = [f"## {result['title']}", f"`python -m tests.benchmarks {file.stem}`", result["about"]]
    for name, title in result["tables"].items():
        with (file.parent / f"{name}.csv").open(encoding="utf-8", newline="") as lines:
            header, *rows = csv.reader(lines)
        body = Table(name=name, title=title, header=header, rows=rows).markdown()
        parts += [f"**{title}**", body if rows else "None."]
    load = "" if result["load"] is None else f", load {result['load']} at the end"
    parts.append(f"Measured {result['measured']} on {result['machine']}{load}; {versions}.")
    return "\n" + "\n\n".join(parts) + "\n"
