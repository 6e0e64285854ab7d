"""What a sweep costs: ``python -m tests.benchmarks sweep``."""

import os
import resource
import subprocess
import sys
import tempfile
import time
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import fmean

from pyomo_quad.flight import solve_scenario
from pyomo_quad.sweep import (
    ResultStore,
    SilentListener,
    Sweep,
    Workers,
    cluster_workers,
    design_sweep,
    load_study,
    process_workers,
)
from pyomo_quad.sweep.case import CaseOutcome
from pyomo_quad.sweep.design import Case, expand
from pyomo_quad.sweep.runner import FLIGHT_SOLVER
from tests.benchmarks.report import Table
from tests.sweep.cluster import cluster
from tests.sweep.stand_in import SOLVER
from tests.sweep.studies import write_study
from tests.sweep.sweeping import Here

TITLE = "Sweeps"
ABOUT = (
    "A sweep keeps one compiled problem per worker and starts each case from a finished neighbour. "
    "Times are processor seconds where a machine shared with other work would spoil the wall clock."
)
REPOSITORY = Path(__file__).parents[2]
AXES = """
[[axis]]
path = "mission.duration"
linear = {{ first = 8.0, last = 14.0, count = {durations} }}

[[axis]]
path = "wind.speed"
linear = {{ first = 0.0, last = 1.5, count = {speeds} }}
"""
REAL = {"durations": 8, "speeds": 3}
MANY = {"durations": 100, "speeds": 100}
DASK = {"durations": 40, "speeds": 25}
INDEPENDENT = 3
WORKERS_OF_A_CLUSTER = 100
WINDOW = 1000


class Clock(SilentListener):
    """Notes processor seconds of this process at the end of each case."""

    def __init__(self) -> None:
        self.marks: list[float] = []

    def start(self, total: int, already_ended: int) -> None:
        self.marks = [time.process_time()]

    def case_ended(self, case: Case, outcome: CaseOutcome, done: int) -> None:
        self.marks.append(time.process_time())


@contextmanager
def spent(kind: int) -> Iterator[dict[str, float]]:
    """Measure wall and processor seconds, of this process or of children that have ended."""
    before, began = resource.getrusage(kind), time.perf_counter()
    found: dict[str, float] = {}
    yield found
    after = resource.getrusage(kind)
    found["wall"] = time.perf_counter() - began
    found["processor"] = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    found["megabytes"] = after.ru_maxrss / 1024


def run(study: Path, folder: Path, workers: Workers, solver: str) -> Clock:
    loaded = load_study(study)
    design = design_sweep(loaded, is_large_allowed=True)
    clock = Clock()
    with ResultStore.writing(folder, design) as store:
        summary = Sweep(design, loaded.base, store, clock, solver).run(workers)
    assert summary.finished == design.case_count
    return clock


def independent(study: Path) -> tuple[dict[str, float], dict[str, float]]:
    """Solve some cases each from nothing: as a command of its own, and in this process."""
    loaded = load_study(study)
    cases = expand(design_sweep(loaded))
    chosen = cases[:: len(cases) // INDEPENDENT]
    with spent(resource.RUSAGE_CHILDREN) as commands:
        for case in chosen:
            settings = [f"--set={path}={value}" for path, value in case.overrides.items()]
            out = study.parent / f"alone_{case.position}"
            command = [sys.executable, "-m", "pyomo_quad", "solve", str(study.parent / "base.toml")]
            subprocess.run(
                [*command, *settings, "--quiet", "--out", str(out)], check=True, cwd=REPOSITORY
            )
    with spent(resource.RUSAGE_SELF) as here:
        for case in chosen:
            solve_scenario(loaded.base.with_values(case.overrides))
    return ({key: value / len(chosen) for key, value in held.items()} for held in (commands, here))


def solved_by(study: Path, count: int) -> dict[str, float]:
    with spent(resource.RUSAGE_CHILDREN) as found, process_workers(count) as workers:
        run(study, study.parent / f"workers_{count}", workers, FLIGHT_SOLVER)
    return found


def rows_of_real_cases(folder: Path) -> Iterator[tuple[str, str]]:
    study = write_study(folder, AXES.format(**REAL))
    total = REAL["durations"] * REAL["speeds"]
    commands, here = independent(study)
    one, two = (solved_by(study, count) for count in (1, 2))
    with ResultStore.reading(folder / "workers_1") as store:
        warm = fmean(sorted(row.seconds for row in store.rows().values())[:-1])
    yield (
        "independent `solve` commands, processor seconds per case",
        f"{commands['processor']:.2f}",
    )
    yield (
        "independent solves in one process, processor seconds per case",
        f"{here['processor']:.2f}",
    )
    for count, found in ((1, one), (2, two)):
        workers = f"{count} worker{'s' if count > 1 else ''}"
        yield f"sweep of {total}, {workers}: cases per second", f"{total / found['wall']:.2f}"
        yield f"sweep of {total}, {workers}: processor s/case", f"{found['processor'] / total:.2f}"
    each = one["processor"] / total
    yield (
        "gain of the sweep over independent commands",
        f"{commands['processor'] / each:.1f} times",
    )
    yield "gain of the sweep over independent solves", f"{here['processor'] / each:.1f} times"
    yield "memory of a worker at its greatest", f"{one['megabytes']:.0f} MB"
    yield from rows_of_the_cluster(folder, warm)


def rows_of_many_cases(folder: Path) -> Iterator[tuple[str, str]]:
    study = write_study(folder, AXES.format(**MANY))
    marks = run(study, folder / "many", Here(), SOLVER).marks
    for name, low in (("first", 0), ("last", len(marks) - 1 - WINDOW)):
        milliseconds = 1e3 * (marks[low + WINDOW] - marks[low]) / WINDOW
        label = f"sweep of {len(marks) - 1} stand-in cases, its {name} {WINDOW}"
        yield f"{label}: processor ms/case", f"{milliseconds:.2f}"


def rows_of_the_cluster(folder: Path, seconds_per_case: float) -> Iterator[tuple[str, str]]:
    study = write_study(folder, AXES.format(**DASK))
    total = DASK["durations"] * DASK["speeds"]
    with cluster(folder) as dask, cluster_workers(dask.address) as workers:
        began = time.perf_counter()
        marks = run(study, folder / "dask", workers, SOLVER).marks
        wall = (time.perf_counter() - began) / total
        scheduler = processor_seconds(dask.scheduler.pid) / total
    parent = (marks[-1] - marks[0]) / total
    busiest = max(parent, scheduler)
    reached = min(WORKERS_OF_A_CLUSTER / seconds_per_case, 1.0 / busiest)
    yield f"Dask, {total} stand-in cases: wall ms/case", f"{1e3 * wall:.1f}"
    yield "Dask: processor ms/case of this program", f"{1e3 * parent:.1f}"
    yield "Dask: processor ms/case of the scheduler", f"{1e3 * scheduler:.1f}"
    label = f"{WORKERS_OF_A_CLUSTER} workers at {seconds_per_case:.2f} s/case, by that overhead"
    yield f"{label}: cases per second", f"{reached:.0f}"


def processor_seconds(process: int) -> float:
    fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(_arguments: Namespace) -> list[Table]:
    rows: list[tuple[str, str]] = []
    for measured in (rows_of_many_cases, rows_of_real_cases):
        with tempfile.TemporaryDirectory() as folder:
            rows += measured(Path(folder))
    return [Table(name="sweep", title="Cost of a case", header=["what", "found"], rows=rows)]
