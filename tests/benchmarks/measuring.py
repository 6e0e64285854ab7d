"""Measurements in processes of their own, so that none warms up or weighs down another."""

import json
import os
import resource
import subprocess
import sys

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")


def report(**numbers):
    """Hand numbers, and this process' peak memory, to the process that asked for them."""
    peak_MiB = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps(numbers | {"peak_MiB": peak_MiB}))


def in_own_process(module, *arguments, repeats=1, key="total_s"):
    """Return what `python -m module --measure arguments` reports, the quickest of some runs."""
    runs = [_run(module, *arguments) for _ in range(repeats)]
    return min(runs, key=lambda numbers: numbers[key])


def _run(module, *arguments):
    command = [sys.executable, "-m", module, "--measure", *map(str, arguments)]
    finished = subprocess.run(
        command, capture_output=True, text=True, check=False, env=os.environ | ONE_THREAD
    )
    if finished.returncode != 0:
        raise SystemExit(f"{' '.join(command)} failed:\n{finished.stderr}")
    return json.loads(finished.stdout.splitlines()[-1])


def table(header, rows):
    """Return a Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def machine():
    """Return what the numbers were measured on."""
    load = os.getloadavg()[0]
    return (
        f"{os.cpu_count()} cores, Python {sys.version_info.major}.{sys.version_info.minor}, "
        f"one thread each, load {load:.1f} at the end"
    )
