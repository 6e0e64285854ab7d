"""Measure all benchmarks, or those named, and write their report.

python -m tests.benchmarks [NAME ...] [--against PYTHON] [--beside CHECKOUT] [--minutes M]
                           [--first K] [--count N] [--render]
"""

import argparse
from importlib import import_module
from pathlib import Path

from tests.benchmarks.report import FOLDER, NAMES, REPORT, render, store

MODULES = {
    "run": "run_speed",
    "engine": "engine_speed",
    "resolve": "resolve_speed",
    "counts": "counts",
    "missions": "mission_speed",
    "robustness": "robustness",
    "places": "random_places",
    "strangers": "strangers",
    "jobs": "jobs",
    "peers": "peer_table",
    "sweep": "sweep_speed",
    "mpc": "replanning",
    "charge": "charge",
    "fields": "wind_fields",
    "pairs": "pairs",
    "holds": "holds",
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"Of {', '.join(NAMES)}.")
    parser.add_argument(
        "--against", type=Path, help="run: the Python of an environment to compare with."
    )
    parser.add_argument(
        "--minutes",
        type=float,
        help="robustness, places, strangers, mpc, jobs, peers, fields, pairs, holds: begin nothing"
        " after it.",
    )
    parser.add_argument(
        "--count", type=int, help="strangers, pairs, holds: the first so many missions only."
    )
    parser.add_argument(
        "--first", type=int, help="holds: the number of the mission to begin with, from 0."
    )
    parser.add_argument("--beside", type=Path, help="jobs: a checkout of an older commit.")
    parser.add_argument("--render", action="store_true", help="Measure nothing.")
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - set(NAMES):
        parser.error(f"no benchmark is named {', '.join(sorted(unknown))}; {', '.join(NAMES)} are.")
    for name in () if arguments.render else arguments.names or NAMES:
        benchmark = import_module(f"tests.benchmarks.{MODULES[name]}")
        tables = benchmark.measure(arguments)
        store(name, benchmark, tables)
        print("\n\n".join(f"{table.title}\n\n{table.markdown()}" for table in tables), flush=True)
    (FOLDER / REPORT).write_text(render(), encoding="utf-8")


if __name__ == "__main__":
    main()
