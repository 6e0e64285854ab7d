"""Feed damaged scenarios, wind files and overrides to the real command and count the answers."""

import contextlib
import io
import random
from collections import Counter
from pathlib import Path

from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from tests.fuzz.mutations import damaged
from tests.scenario_files import write_scenario, write_wind

SCENARIOS = Path(__file__).parents[2] / "scenarios"
OVERRIDES = (b"mission.duration=12.0", b"mission.goal.position=[1.0, 2.0, 3.0]", b'wind.use="calm"')


def run_campaign(folder: Path, count: int, seed: int) -> Counter[int]:
    """Run the command `count` times; return how often each exit status came.

    Raises
    ------
    AssertionError
        If an input is answered by anything but success in silence, or status 2 and a line for each
        fault.
    """
    chance = random.Random(seed)
    statuses: Counter[int] = Counter()
    for _ in range(count):
        arguments, given = chance.choice(KINDS)(folder, chance)
        output, errors = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
            status = main(["check", "--quiet", *arguments])
        lines = errors.getvalue().splitlines()
        is_told = status == ExitCode.BAD_INPUT and 1 <= len(lines) <= 21
        is_answered = is_told or (status, lines) == (ExitCode.VERIFIED, [])
        assert is_answered, f"exit {status} for {given!r}: {errors.getvalue()}"
        statuses[status] += 1
    return statuses


def _damaged_scenario(folder, chance):
    files = sorted(SCENARIOS.glob("paper_*.toml"))
    file = folder / "damaged.toml"
    content = damaged(chance.choice(files).read_bytes(), chance)
    file.write_bytes(content)
    return [str(file)], content


def _damaged_wind(folder, chance):
    wind = write_wind(folder, range(8))
    content = damaged(wind.read_bytes(), chance)
    wind.write_bytes(content)
    return [str(write_scenario(folder, 'wind.file = "wind.csv"'))], content


def _damaged_override(folder, chance):
    content = damaged(chance.choice(OVERRIDES), chance)
    text = content.decode("utf-8", errors="replace")
    return [str(write_scenario(folder)), f"--set={text}"], content


KINDS = (_damaged_scenario, _damaged_wind, _damaged_override)
