"""Seconds of jobs by this commit and by an older one, side by side in turns.

    python -m tests.benchmarks jobs --beside /path/to/an/older/checkout [--minutes M]

Each is a process of its own.  A run is written down as it ends, and not done again for the same
commits: a benchmark that was stopped goes on where it was.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median

import numpy as np

from tests.benchmarks import robustness
from tests.benchmarks.measuring import ONE_THREAD, on_one_core
from tests.benchmarks.mission_speed import MISSIONS
from tests.benchmarks.report import FOLDER, Table

TITLE = "Jobs, by an older commit and by this one"
ABOUT = (
    "The same job by two checkouts, in processes of their own, one right after the other; a dash "
    "stands for a job that was not run, inf for one that failed or was ended, as a run of more "
    "than 150 s on the clock is. Processor seconds of one thread from a scenario to its verified "
    "plan, without imports, the median of the runs; of a run, the clock on the wall from the "
    "start of the process to its end. `usable` ends with the first usable plan (of a package that "
    "knows of none, with the end of the solve) and asks for standard like `standard`, and "
    "`proof` for proof; an older checkout that knows no accuracies is asked for its tolerance"
    " by default, 1e-6. The random missions are the first of seed 2026 of the benchmark "
    "`robustness`, their seconds those of the median mission. Of the second table, flights are "
    "SciPy's integrations, and the rest is mostly building, compiling and the errors of meshes. "
    "Other programs used the machine as well."
)
ROOT = Path(__file__).parents[2]
SCRIPT = Path(__file__).with_name("job.py")
STRANGER = Path(__file__).with_name("stranger") / "delivery.toml"
RESULTS = FOLDER / "jobs.jsonl"
RANDOM_MISSIONS = 12
TURNS = 3
# Functions whose seconds are those of all that they do.
_WHOLE = ("plan", "usable", "ducted_fan")
# Runs longer than this are not repeated [s].
LONG_S = 60.0
# A run that takes longer on the clock is ended [s].
PATIENCE_S = 150.0


@dataclass(frozen=True, kw_only=True)
class Job:
    """What is run: a function of `job.py`, or a command on the clock.

    `scenario` is a path or the name of a shipped scenario; `wanted` are the seconds aimed at, and
    `bound` says in words what the seconds go to, for a job that misses its aim.  A run that takes
    longer than `patience_s` on the clock is given up.
    """

    wanted: float
    bound: str = ""
    function: str = "plan"
    scenario: str = ""
    told: dict = None
    patience_s: float = PATIENCE_S


def _mission(label):
    name, changes = MISSIONS[label]
    return {"scenario": name, "told": {"changes": changes, "accuracy": "standard"}}


JOBS = {
    "a stranger's delivery, usable": Job(
        wanted=15, function="usable", scenario=str(STRANGER), told={"accuracy": "standard"}
    ),
    "a stranger's delivery, standard": Job(
        wanted=40, scenario=str(STRANGER), told={"accuracy": "standard"}
    ),
    "`delivery.toml`, standard": Job(
        wanted=8,
        bound="105 iterations of 63 ms, three routes and three meshes; a third between the solves",
        scenario="delivery",
        told={"accuracy": "standard"},
    ),
    "`inspection.toml`, eight places in the best order": Job(
        wanted=10,
        bound="39 solves for order and plan; two fifths are spent between them (building problems)",
        scenario="inspection",
        told={"accuracy": "standard"},
    ),
    "four keep-outs, free duration, all routes": Job(
        wanted=4, **_mission("four keep-outs, all ways round them, free duration")
    ),
    "six waypoints, free duration": Job(
        wanted=3,
        bound="75 iterations of 30 ms: Ipopt and callbacks take a third each, compilation the rest",
        **_mission("six waypoints, free duration"),
    ),
    "free duration of the paper's mission, proof": Job(
        wanted=1.2,
        bound="88 iterations of 38 ms in eight solves, nine tenths of it in Ipopt",
        scenario="paper_free",
        told={"accuracy": "proof"},
    ),
    "one kilometre, free duration": Job(
        wanted=3,
        bound="38 iterations of 138 ms on three meshes; simulated flights, a seventh",
        **_mission("1 km, momentum, free duration"),
    ),
    "ducted fan at 1e-6": Job(
        wanted=1.5,
        bound="139 iterations of 22 ms on ten meshes",
        function="ducted_fan",
        told={},
    ),
    f"random missions of seed 2026, the first {RANDOM_MISSIONS}, median": Job(
        wanted=2,
        bound="Ipopt, nine tenths: 2,414 iterations of 45 ms for the twelve missions",
        patience_s=4 * PATIENCE_S,
        function="random_missions",
        scenario="paper_calm",
        told={
            "missions": [list(told) for told in robustness.missions(RANDOM_MISSIONS, 2026)],
        },
    ),
    "`run paper_calm`, wall clock": Job(
        wanted=2.5,
        bound="an autopilot is tuned, which the older commit lacked (`docs/decisions/speed.md`)",
        function="run",
        scenario="paper_calm",
    ),
    "re-planning of `delivery.toml`, 95 % of the solves": Job(
        wanted=0.06,
        bound="four to five iterations a solve, of 30 ms on the mesh of the plan",
        function="replanning",
        scenario="delivery",
        told={"accuracy": "standard"},
    ),
}


@dataclass(frozen=True, kw_only=True)
class Run:
    """A run of a job by a commit; the seconds are infinite where it failed."""

    job: str
    commit: str
    turn: int
    s: float
    ended: str
    energy_J: float | None = None
    peak_MiB: float | None = None
    ipopt_s: float | None = None
    callbacks_s: float | None = None
    flights_s: float | None = None
    solves: int | None = None
    iterations: int | None = None


def commit_of(checkout):
    """Return the commit of a checkout, marked where its package was changed since."""
    git = ["git", "-C", str(checkout)]
    head = subprocess.check_output([*git, "rev-parse", "--short=12", "HEAD"], text=True).strip()
    changed = subprocess.run([*git, "diff", "--quiet", "HEAD", "--", "pyomo_quad"], check=False)
    return head + "+" * (changed.returncode != 0)


def run(job, checkout):
    """Return what a job by a checkout came to."""
    environment = os.environ | ONE_THREAD | {"PYTHONPATH": str(checkout)}
    scenario = Path(job.scenario)
    if not scenario.is_absolute():
        scenario = checkout / "scenarios" / f"{job.scenario}.toml"
    command = [sys.executable, str(SCRIPT), job.function, str(checkout), str(scenario)]
    command.append(json.dumps(job.told))
    if job.function == "run":
        command = [sys.executable, "-m", "pyomo_quad", "run", str(scenario), "--quiet"]
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        try:
            finished = subprocess.run(
                command,
                cwd=folder,
                env=environment,
                capture_output=True,
                text=True,
                check=False,
                timeout=job.patience_s,
                preexec_fn=None if job.function == "run" else on_one_core,
            )
        except subprocess.TimeoutExpired:
            return {"s": float("inf"), "ended": f"ended after {job.patience_s:g} s"}
        wall = time.perf_counter() - began
    if finished.returncode != 0:
        return {"s": float("inf"), "ended": (finished.stderr.strip() or "failed").splitlines()[-1]}
    if job.function == "run":
        return {"s": wall, "ended": "verified"}
    return json.loads(finished.stdout.splitlines()[-1])


def finished_runs(results):
    """Return the runs that a results file holds."""
    if not results.exists():
        return []
    return [Run(**json.loads(line)) for line in results.read_text(encoding="utf-8").splitlines()]


def run_all(checkouts, minutes, jobs=JOBS, results=RESULTS):
    """Run every job by every checkout, in turns, and write each run down as it ends."""
    deadline = time.perf_counter() + 60.0 * (np.inf if minutes is None else minutes)
    results.parent.mkdir(parents=True, exist_ok=True)
    commits = {commit_of(checkout): checkout for checkout in checkouts}
    for turn in range(TURNS):
        for name, job in jobs.items():
            for commit, checkout in commits.items():
                known = [r for r in finished_runs(results) if (r.job, r.commit) == (name, commit)]
                is_long = any(r.s > LONG_S for r in known)
                if any(r.turn == turn for r in known) or (known and is_long):
                    continue
                if time.perf_counter() > deadline:
                    return list(commits)
                found = Run(job=name, commit=commit, turn=turn, **run(job, checkout))
                with results.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(found)) + "\n")
    return list(commits)


def measure(arguments):
    """Return the table of jobs, and what the seconds of this commit went to."""
    checkouts = [ROOT] if arguments.beside is None else [arguments.beside.resolve(), ROOT]
    commits, runs = run_all(checkouts, arguments.minutes), finished_runs(RESULTS)
    return [table(commits, runs), profile(commits[-1], runs)]


def table(commits, runs, jobs=JOBS):
    """Return a row for each job: its seconds by each commit, those wanted, and how it ended."""
    rows = []
    for name, job in jobs.items():
        cells, ends = [], []
        for commit in commits:
            done = [r for r in runs if (r.job, r.commit) == (name, commit)]
            spent = median(r.s for r in done) if done else None
            cells.append("-" if spent is None else f"{spent:.3g}" if spent < 1 else f"{spent:.1f}")
            ends += [
                f"{r.ended}" + (f", {r.energy_J:.2f} J" if r.energy_J else "") for r in done[:1]
            ]
        is_met = "-"
        if cells[-1] != "-":
            is_met = "yes" if float(cells[-1]) <= job.wanted else "no"
        bound = job.bound if is_met == "no" else ""
        rows.append([name, *cells, job.wanted, is_met, "; ".join(ends), bound])
    header = ["job", *(f"{commit} s" for commit in commits), "wanted s", "reached"]
    return Table(name="jobs", title="Jobs", header=[*header, "ended", "what bounds it"], rows=rows)


def profile(commit, runs, jobs=JOBS):
    """Return what the seconds of each job went to, the first run of a commit."""
    rows = []
    for name in (name for name, job in jobs.items() if job.function in _WHOLE):
        done = [r for r in runs if (r.job, r.commit) == (name, commit) and r.solves]
        if not done:
            continue
        found = done[0]
        steps = found.ipopt_s - found.callbacks_s
        rest = found.s - found.ipopt_s - found.flights_s
        parts = (steps, found.callbacks_s, found.flights_s, max(rest, 0.0))
        per_step = 1e3 * found.ipopt_s / max(found.iterations, 1)
        shares = [f"{100.0 * part / found.s:.0f}" for part in parts]
        rows.append([name, *shares, found.solves, found.iterations, f"{per_step:.0f}"])
    header = ["job", "Ipopt and MUMPS %", "callbacks %", "flights %", "rest %", "solves"]
    title = "What the seconds went to"
    return Table(
        name="jobs_profile",
        title=title,
        header=[*header, "iterations", "ms an iteration"],
        rows=rows,
    )
