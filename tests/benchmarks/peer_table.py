"""This engine beside its peers on the same problems, at equal accuracy by a judgement of its own.

    python -m tests.benchmarks peers [--minutes M]

Each peer gets an environment of its own in a cache folder, and each solve a process of its own.  A
result is written down as it is known: a run that was stopped goes on where it was.
"""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import BarycentricInterpolator

from tests.benchmarks.measuring import ONE_THREAD
from tests.benchmarks.peers.problems import FREE, PROBLEMS
from tests.benchmarks.report import FOLDER, Table

# Seconds of the processor that a solve may take, and how many on the clock for each of them, so
# that a busy machine ends nobody's.
PATIENCE_S = 60
CLOCK = 5
ENDED = "ended after"
TITLE = "Beside peers"
ABOUT = (
    "The same problems, written once as data, by this engine and by peers that pip installs, each "
    "in an environment of its own. What a peer returns is its controls and its duration; the "
    "benchmark integrates them by SciPy from the start. The error is the largest of: the objective "
    "found so, beside the best known; the miss of the end; how far a limit is broken, all relative "
    "to the larger of one and the value. Peers are given meshes of 5, 10, 20, ... equal elements "
    "of degree 4, this engine tolerances of 1e-3, 1e-4, ...; the seconds are those of the first "
    "that comes within an error of 1e-4, so that no search for it counts against anybody. First "
    "seconds of building and solving, then of the whole process, both of the processor. Dymos has "
    "SciPy's SLSQP, for its usual optimiser is not to be had by pip; rockit holds controls "
    "constant on an element. A waypoint is passed at half of the time: the second leg is flown "
    "backwards from the goal beside the first, so that peers of one phase can solve it too. A "
    f"solve ends after {PATIENCE_S} s of the processor, and no finer mesh is tried then. "
    "A dash is not run, 'unfinished' not run on all meshes. No peer's "
    "settings were tuned, nor this engine's."
)
ROOT = Path(__file__).parents[2]
SCRIPT = Path(__file__).with_name("peers") / "__main__.py"
RESULTS = FOLDER / "peers.jsonl"
CACHE = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "pyomo_quad" / "peers"
OURS = "pyomo_quad"
# Peer -> what pip is told to install, in turn.
PEERS = {
    "casadi": (("casadi", "numpy"),),
    "rockit": (("rockit-meco",),),
    "yapss": (("yapss",),),
    "dymos": (("dymos",),),
    "maptor": (("maptor",),),
    # It asks for a NumPy that Python 3.11 cannot load, and forgets `pkg_resources`.
    "mpopt": (("mpopt", "scipy<1.13", "setuptools<81"), ("--no-deps", "numpy==1.26.4")),
}
RUNGS = {OURS: (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)}
MESHES = (5, 10, 20, 40, 80, 160)
WANTED = 1e-4


@dataclass(frozen=True, kw_only=True)
class Result:
    """One solve: its error by the benchmark's judgement, infinite where there is no answer."""

    peer: str
    problem: str
    rung: float
    error: float
    objective: float | None = None
    solve_s: float | None = None
    process_s: float | None = None
    iterations: int | None = None
    said: str = ""


def python_of(peer):
    """Return the Python of a peer's environment, made where it is missing, or pip's reason."""
    if peer == OURS:
        return Path(sys.executable), ""
    folder = CACHE / peer
    python, done = folder / "bin" / "python", folder / "installed"
    if not done.exists():
        subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
        for wanted in PEERS[peer]:
            pip = [str(python), "-m", "pip", "install", "--quiet", *wanted]
            finished = subprocess.run(pip, capture_output=True, text=True, check=False)
            if finished.returncode != 0:
                errors = [line for line in finished.stderr.splitlines() if line.startswith("ERROR")]
                return None, (errors or ["pip failed"])[-1]
        done.touch()
    return python, ""


def judged(problem, duration, pieces):
    """Return the error of controls, and the objective that they come to.

    Parameters
    ----------
    pieces : list
        Begin and end as shares of the duration, shares of nodes, and controls there: polynomials
        through these, held within the limits of the controls.
    """
    low, high = (np.array([c[k] for c in problem.controls.values()]) for k in (0, 1))
    state = np.array([*(start for start, *_ in problem.states.values()), 0.0], dtype=float)
    floor, ceiling = (np.array([s[k] for s in problem.states.values()]) for k in (2, 3))
    broken = 0.0
    for begin, end, nodes, values in pieces:
        through = _polynomial(nodes, np.array(values))

        def rates(t, x, through=through):
            u = np.clip(through(t / duration), low, high)
            return [*problem.rates(np, x[:-1], u), problem.running(np, x[:-1], u)]

        span = begin * duration, end * duration
        flown = solve_ivp(rates, span, state, method="DOP853", rtol=1e-10, atol=1e-10)
        if not flown.success:
            return float("inf"), None
        state = flown.y[:, -1]
        places = flown.y[:-1].T
        sizes = np.maximum(1.0, np.maximum(np.abs(floor), np.abs(ceiling)))
        broken = max(broken, np.max(np.maximum(floor - places, places - ceiling) / sizes))
        if problem.path is not None:
            outside = np.array([problem.path(np, x, None)[0] for x in places])
            broken = max(broken, -outside.min())
    objective = float(problem.objective(state[:-1], duration, state[-1]))
    misses = [
        abs(x - s[1]) / max(1.0, abs(s[1]))
        for x, s in zip(state, problem.states.values(), strict=False)
        if s[1] is not FREE
    ]
    off = abs(objective - problem.best) / max(1.0, abs(problem.best))
    return float(max(off, broken, *misses, 0.0)), objective


def _polynomial(nodes, values):
    if len(nodes) == 1:
        return lambda _share: values[0]
    return BarycentricInterpolator(nodes, values)


def solve(peer, python, name, rung):
    """Return what a peer makes of a problem."""
    command = [str(python), str(SCRIPT), peer, name, str(rung), str(PATIENCE_S)]
    # This engine is that of this checkout; no peer is to find it.
    path = {"PYTHONPATH": str(ROOT)} if peer == OURS else {}
    environment = os.environ | ONE_THREAD | {"MPLBACKEND": "agg"} | path
    told = {"peer": peer, "problem": name, "rung": rung}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    try:
        finished = subprocess.run(
            command,
            capture_output=True,
            text=True,
            check=False,
            cwd=CACHE,
            env=environment,
            timeout=CLOCK * PATIENCE_S,
        )
    except subprocess.TimeoutExpired:
        return Result(
            **told, error=float("inf"), said=f"{ENDED} {CLOCK * PATIENCE_S} s on the clock"
        )
    if finished.returncode == -signal.SIGXCPU:
        said = f"{ENDED} {PATIENCE_S} s of the processor"
        return Result(**told, error=float("inf"), said=said)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if finished.returncode != 0:
        lines = finished.stderr.strip().splitlines() or ["failed"]
        return Result(**told, error=float("inf"), said=lines[-1][:200])
    found = json.loads(finished.stdout.splitlines()[-1])
    error, objective = judged(PROBLEMS[name], found["duration"], found["pieces"])
    return Result(
        **told,
        error=error,
        objective=objective,
        solve_s=found["solve_s"],
        process_s=after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime,
        iterations=found["iterations"] or None,
    )


def finished_results(results):
    """Return the solves that a results file holds."""
    if not results.exists():
        return []
    lines = results.read_text(encoding="utf-8").splitlines()
    return [Result(**json.loads(line)) for line in lines]


def solve_all(minutes, peers=(OURS, *PEERS), problems=PROBLEMS, results=RESULTS):
    """Solve each problem by each peer on finer and finer meshes, until the error is small enough.

    Returns
    -------
    dict
        Peer -> pip's reason, of peers that could not be installed.
    """
    deadline = time.perf_counter() + 60.0 * (np.inf if minutes is None else minutes)
    for folder in (CACHE, results.parent):
        folder.mkdir(parents=True, exist_ok=True)
    found = {peer: python_of(peer) for peer in peers}
    # A problem goes to each peer before the next, so that what was stopped holds whole rows.
    for name, (peer, (python, reason)) in product(problems, found.items()):
        for rung in () if reason else RUNGS.get(peer, MESHES):
            done = [r for r in finished_results(results) if (r.peer, r.problem) == (peer, name)]
            is_over = any(r.error <= WANTED or r.said.startswith(ENDED) for r in done)
            if is_over or time.perf_counter() > deadline:
                break
            if any(r.rung == rung for r in done):
                continue
            with results.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(solve(peer, python, name, rung))) + "\n")
    return {peer: reason for peer, (_, reason) in found.items() if reason}


def cell(done):
    """Return seconds of the first solve that is accurate enough, or what came of the best."""
    if not done:
        return "-"
    reached = [r for r in done if r.error <= WANTED]
    if reached:
        return f"{reached[0].solve_s:.2f} / {reached[0].process_s:.1f}"
    best = min(done, key=lambda r: r.error)
    has_ended = any(r.said.startswith(ENDED) for r in done)
    is_over = has_ended or len(done) == len(RUNGS.get(best.peer, MESHES))
    told = "not reached" if is_over else "unfinished"
    return f"{told}: {best.error:.0e}" if np.isfinite(best.error) else "no answer"


def measure(arguments):
    """Return the table of seconds, that of what each needed for them, and peers not installed."""
    missing = solve_all(arguments.minutes)
    return tables(finished_results(RESULTS), missing)


def tables(results, missing):
    """Return what solves came to as tables."""
    peers = [peer for peer in (OURS, *PEERS) if peer not in missing]
    rows, details = [], []
    for name in PROBLEMS:
        by_peer = {
            peer: [r for r in results if (r.peer, r.problem) == (peer, name)] for peer in peers
        }
        rows.append([name, *(cell(done) for done in by_peer.values())])
        for peer, done in by_peer.items():
            for r in sorted(done, key=lambda r: r.error)[:1]:
                said = [f"{r.error:.1e}", "-" if r.objective is None else f"{r.objective:.8g}"]
                details.append([name, peer, f"{r.rung:g}", *said, r.iterations or "-", r.said])
    header = ["problem", "peer", "mesh or tolerance", "error", "objective", "iterations", "said"]
    title = f"Seconds to an error of {WANTED:g}: solve / whole process"
    return [
        Table(name="peers", title=title, header=["problem", *peers], rows=rows),
        Table(name="peers_details", title="Most accurate solve", header=header, rows=details),
        Table(
            name="peers_missing",
            title="Peers that could not be installed",
            header=["peer", "pip's reason"],
            rows=[list(told) for told in missing.items()],
        ),
    ]
