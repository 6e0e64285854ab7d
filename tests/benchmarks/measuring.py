"""Measurements in processes of their own, so that none warms up or weighs down another.

Seconds are processor seconds of one thread: what a clock on the wall shows on an idle machine,
and a busy one as well.
"""

import json
import os
import resource
import subprocess
import sys
import time

seconds = time.process_time

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")


def report(**numbers):
    """Hand numbers, and this process' peak memory, to the process that asked for them."""
    peak_MiB = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps(numbers | {"peak_MiB": peak_MiB}))


def on_one_core():
    """Let this process use one core, so that it divides no work among copies of itself.

    The processor seconds of copies would not be counted.
    """
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[os.getpid() % len(cores)]})


def in_own_process(module, *arguments, repeats=1, key="total_s"):
    """Return what `python -m module --measure arguments` reports, the quickest of some runs."""
    runs = [_run(module, *arguments) for _ in range(repeats)]
    return min(runs, key=lambda numbers: numbers[key])


def _run(module, *arguments):
    command = [sys.executable, "-m", module, "--measure", *map(str, arguments)]
    finished = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | ONE_THREAD,
        preexec_fn=on_one_core,
    )
    if finished.returncode != 0:
        raise SystemExit(f"{' '.join(command)} failed:\n{finished.stderr}")
    return json.loads(finished.stdout.splitlines()[-1])


def iterations_of(solution):
    """Return the iterations of a solve, those after its first end included."""
    return sum(now.iteration > 0 for now in solution.iterations)


def whole_process(*arguments, repeats=1):
    """Return seconds of a Python process from start to end, and the last line it prints."""
    best, command = float("inf"), [sys.executable, *arguments]
    for _ in range(repeats):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        finished = subprocess.run(
            command, capture_output=True, text=True, check=True, env=os.environ | ONE_THREAD
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
        best = min(best, spent)
    return best, finished.stdout.splitlines()[-1]
