"""`python -m tests.fuzz --count 10000 --seed 1`: a long run of the fuzz campaign."""

import argparse
import tempfile
from pathlib import Path
from time import perf_counter

from tests.fuzz.campaign import run_campaign

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--count", type=int, default=10_000)
parser.add_argument("--seed", type=int, default=1)
chosen = parser.parse_args()
started = perf_counter()
with tempfile.TemporaryDirectory() as folder:
    statuses = run_campaign(Path(folder), chosen.count, chosen.seed)
print(
    f"{chosen.count} inputs, seed {chosen.seed}, {perf_counter() - started:.0f} s: "
    + ", ".join(f"exit {int(status)}: {times}" for status, times in sorted(statuses.items()))
    + "; no traceback."
)
