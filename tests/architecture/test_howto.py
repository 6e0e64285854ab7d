"""The recipes of docs/howto, followed literally in a copy of the checkout."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
RECIPES = sorted(page for page in (ROOT / "docs/howto").glob("*.md") if page.name != "README.md")
# No recipe changes these.
LEFT_OUT = (".git", "reports", "*.egg-info", "__pycache__", ".*_cache")

_BLOCK = re.compile(r"([^\n]+)\n\n```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_IN = re.compile(r"^In `(?P<file>[^`]+)`, (?P<where>after|before|replace):$")
_CREATE = re.compile(r"^Create `(?P<file>[^`]+)`:$")
_ANSWERS = {"after": "add:", "before": "add:", "replace": "by:"}


def blocks(page):
    """Return instruction, language and content of each block of a recipe."""
    text = page.read_text(encoding="utf-8")
    found = _BLOCK.findall(text)
    assert len(found) == text.count("\n```") // 2, "a block has no line of instruction above it"
    return found


def steps(page):
    """Yield what a recipe asks for: ("create" | "change" | "run", what)."""
    held = iter(blocks(page))
    for instruction, language, content in held:
        if created := _CREATE.match(instruction):
            yield "create", (created["file"], content)
        elif changed := _IN.match(instruction):
            answer, _, new = next(held)
            assert answer == _ANSWERS[changed["where"]]
            yield "change", (changed["file"], changed["where"], content, new)
        else:
            assert (instruction, language) == ("Run:", "sh")
            yield "run", content


def changed(text, where, old, new):
    """Return a text with a block of lines put after or before another, or in its place."""
    assert text.count(old) == 1, f"{old!r} is there {text.count(old)} times"
    return text.replace(old, {"after": old + new, "before": new + old, "replace": new}[where])


@pytest.mark.parametrize("page", RECIPES, ids=lambda page: page.stem)
def test_a_recipe_finds_what_it_changes(page):
    files = {}
    for kind, what in steps(page):
        if kind == "create":
            files[what[0]] = what[1]
        elif kind == "change":
            file, where, old, new = what
            text = files.get(file) or (ROOT / file).read_text(encoding="utf-8")
            files[file] = changed(text, where, old, new)
    assert {kind for kind, _ in steps(page)} >= {"run"}


@pytest.mark.slow
@pytest.mark.parametrize("page", RECIPES, ids=lambda page: page.stem)
def test_a_recipe_works(page, tmp_path):
    copy = tmp_path / "checkout"
    shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(*LEFT_OUT))
    (copy / "reports").symlink_to(ROOT / "reports")
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    environment = os.environ | {"PYTHONPATH": str(copy), "PATH": path, "OMP_NUM_THREADS": "1"}
    for kind, what in steps(page):
        if kind == "create":
            (copy / what[0]).write_text(what[1], encoding="utf-8")
        elif kind == "change":
            file, where, old, new = what
            text = (copy / file).read_text(encoding="utf-8")
            (copy / file).write_text(changed(text, where, old, new), encoding="utf-8")
        else:
            ended = subprocess.run(
                ["/bin/sh", "-ec", what],
                cwd=copy,
                env=environment,
                capture_output=True,
                text=True,
                check=False,
            )
            assert ended.returncode == 0, f"{what}\n{ended.stdout}\n{ended.stderr}"
