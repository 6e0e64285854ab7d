# ruff: noqa: INP001
"""Print the README's set-up-and-run commands, one a line, exactly as they stand there."""

import re
import sys
from pathlib import Path

EXPECTED = 2

readme = Path(__file__).parent.parent / "README.md"
blocks = re.findall(
    r"^```[a-z]*\n(.*?)^```", readme.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
)
lines = [line for block in blocks for line in block.splitlines()]
commands = [line for line in lines if line.startswith("python3 -m venv .venv && ")]
if len(commands) != EXPECTED:
    sys.exit(
        f"README.md: {len(commands)} commands start with 'python3 -m venv'; must be {EXPECTED}."
    )
sys.stdout.write("".join(f"{command}\n" for command in commands))
