"""One peer on one problem, in a process of its own.

    python tests/benchmarks/peers/__main__.py PEER PROBLEM RUNG SECONDS

RUNG is a number of elements or, of what refines by itself, a tolerance; SECONDS of the processor
end it.  Prints as JSON the processor seconds of building and solving, the duration, and the
controls piece by piece: begin and end as shares of the horizon, shares of its nodes, and the values
there, between which each control is a polynomial.
"""

import json
import resource
import sys
import time
from importlib import import_module
from pathlib import Path
from types import ModuleType

if __name__ == "__main__":
    # A peer installs a package `tests` of its own, which would hide a folder without `__init__`.
    ours = sys.modules["tests"] = ModuleType("tests")
    ours.__path__ = [str(Path(__file__).parents[2])]
    name, problem, rung, seconds = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), resource.RLIM_INFINITY))
    PROBLEMS = import_module("tests.benchmarks.peers.problems").PROBLEMS
    peer = import_module(f"tests.benchmarks.peers.by_{name}")
    started = time.process_time()
    duration, pieces, iterations = peer.solve(PROBLEMS[problem], type(peer.RUNGS[0])(rung))
    told = {"solve_s": time.process_time() - started, "duration": duration}
    print(json.dumps(told | {"pieces": pieces, "iterations": iterations}))
