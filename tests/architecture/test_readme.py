"""The README is one page, and each number in it is that of a committed report."""

import csv
import json
import re
import tomllib
from pathlib import Path

import pytest

from pyomo_quad import Plan, RunResult, __version__

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
# Numbers that are names, or stand in commands: no report measures them.
NAMES = ("PX4", "ROS 2")


def prose():
    """Return the README without code, link targets and the names that hold digits."""
    text = re.sub(r"^```.*?^```", "", README, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"`[^`]*`|\[[^\]]*\](?:\([^)]*\)|\[[^\]]*\]|:.*$)", "", text, flags=re.MULTILINE)
    for name in NAMES:
        text = text.replace(name, "")
    return " ".join(text.split())


def rows(name):
    file = ROOT / "reports" / name
    with file.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def phrases():
    """Return what the README must say, from reports and package files."""
    told = json.loads((ROOT / "reports/delivery/summary.json").read_text(encoding="utf-8"))
    often, tuned = told["turbulence"], told["headline"]["autopilot"]
    (rival,) = often["savings"]
    (model,) = (row for row in rows("m100/models.csv") if row["model"].startswith("momentum"))
    calm = json.loads((ROOT / "reports/paper_calm/summary.json").read_text(encoding="utf-8"))
    counts = {
        row["outcome"]: int(row["missions"])
        for row in rows("benchmarks/robustness.csv")
        if row["seed"] == "all"
    }
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    oldest, beyond = re.findall(r"3\.(\d+)", project["requires-python"])
    version = __version__
    total = sum(counts.values())
    return [
        f"**{told['energy_J']:.0f} J in {told['duration_s']:.1f} s**",
        f"({tuned['speed']:.1f} m/s, {tuned['acceleration']:.1f} m/s², {tuned['jerk']:.1f} m/s³)",
        f"{often['held']} of {often['flights']} simulated flights",
        f"**{rival['energy_J']['50_percent']:.0f} J** in the same turbulence",
        f"over that autopilot | {rival['saving_percent']['50_percent']:.1f} % |",
        f"held out of the fit | {float(model['mean_absolute_error_percent']):.2f} % |",
        f"in the paper's first mission | {calm['certificate']['gap_percent']:.2f} % |",
        f"solved or proven infeasible, out of {total} | {total - counts['lost']} |",
        f"Python 3.{oldest} to 3.{int(beyond) - 1}",
        f"Once {version} is released",
    ]


@pytest.mark.parametrize("phrase", phrases())
def test_the_readme_says_what_the_reports_say(phrase):
    assert phrase in prose()


def test_no_number_of_the_readme_is_unchecked():
    text = prose()
    for phrase in phrases():
        text = text.replace(phrase, "")
    assert re.findall(r"\S*\d\S*", text) == []


def test_the_readme_is_one_page():
    lines = README.splitlines()
    assert len(lines) <= 110
    assert max(map(len, lines)) <= 110


def test_every_link_of_the_readme_leads_somewhere():
    inline = re.findall(r"\]\(([^)#]+)\)", README)
    named = dict(re.findall(r"^\[([^\]]+)\]: (\S+)$", README, re.MULTILINE))
    assert set(re.findall(r"\]\[([^\]]+)\]", README)) == set(named)
    assert [link for link in (*inline, *named.values()) if not (ROOT / link).exists()] == []


def test_a_hosted_runner_does_what_the_checkout_does():
    workflow = (ROOT / ".github/workflows/ci.yml").read_text(encoding="utf-8")
    assert "- run: .ci/run\n" in workflow
    assert "-m sphinx -W docs" in (ROOT / ".ci/run").read_text(encoding="utf-8")


def test_the_python_of_the_readme_names_what_there_is():
    (code,) = re.findall(r"^```python\n(.*?)^```", README, re.MULTILINE | re.DOTALL)
    assert len(code.splitlines()) <= 11
    names = re.findall(r"result(?:\.plan)?\.(\w+)", code)

    held = {
        *dir(Plan),
        *dir(RunResult),
        *RunResult.__dataclass_fields__,
        *Plan.__dataclass_fields__,
    }
    assert set(names) <= held
