"""The `pyomo-quad` command, in a process of its own or in this one."""

import json
import os
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

from pyomo_quad.cli import main

SCENARIOS = Path(__file__).parents[1] / "scenarios"
PAPER_CALM = str(SCENARIOS / "paper_calm.toml")
COMMAND = (sys.executable, "-m", "pyomo_quad")
# Two cores are shared by everything that runs: threads of BLAS would only get in the way.
ENVIRONMENT = os.environ | {"OMP_NUM_THREADS": "1"}

# A short hop on a mesh that needs no refinement: for tests of what is around the solve.
QUICK = (
    "--set=mission.goal.position=[1.0, 0.0, 0.5]",
    "--set=mission.duration=4.0",
    "--set=solver.elements=20",
)
IMPOSSIBLE = ("--set=mission.goal.position=[0.0, 0.0, 8.0]", "--set=mission.duration=0.3")


@dataclass(frozen=True, kw_only=True)
class Run:
    """A finished run of the command: its status, what it said, and where its report is."""

    status: int
    out: str
    err: str
    folder: Path

    @property
    def summary(self):
        return json.loads((self.folder / "summary.json").read_text(encoding="utf-8"))

    @property
    def complaints(self):
        """What it said on standard error but for the progress that slow machines get to see."""
        return [line for line in self.err.splitlines() if not line.startswith("iteration ")]

    def read(self, name):
        return (self.folder / name).read_text(encoding="utf-8")


def start(*arguments, **options):
    """Start the command without waiting for it."""
    return subprocess.Popen(
        [*COMMAND, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=ENVIRONMENT,
        **options,
    )


def run(*arguments, out=Path("reports"), cwd=None):
    """Run the command with `--out` when a folder for it is given as `out`."""
    process = start(*arguments, cwd=cwd)
    said, complained = process.communicate(timeout=300)
    return Run(status=process.returncode, out=said, err=complained, folder=Path(out))


def solve(out, *arguments, scenario=PAPER_CALM):
    """Run `pyomo-quad solve` into a folder."""
    return run("solve", str(scenario), "--out", str(out), *arguments, out=out)


def run_here(*arguments, out):
    """Run the command in this process, which has imported the engine already."""
    with redirect_stdout(StringIO()) as said, redirect_stderr(StringIO()) as complained:
        status = main([*arguments, "--out", str(out)])
    return Run(status=status, out=said.getvalue(), err=complained.getvalue(), folder=Path(out))
