"""The generated pages of the book: reference of names and commands, gallery."""

import csv
import json
import sys
import textwrap
import tomllib
from inspect import isclass
from pathlib import Path

from typer.testing import CliRunner

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))

from pyomo_quad.cli.commands import app
from tests.architecture.test_public_api import PACKAGES, public_names
from tests.problems.__main__ import cases

#: The first words on each package in the reference.
_PACKAGE_WORDS = {
    "pyomo_quad": "Names that a script imports: load, solve, run, export.",
    "pyomo_quad.collocation": "The engine, for any Pyomo.DAE model.",
    "pyomo_quad.exports": "Plans for autopilots, swarms and simulators.",
    "pyomo_quad.flight": "Plans, flights and their verification.",
    "pyomo_quad.model": "The declared equations.",
    "pyomo_quad.scenario": "Scenarios: fields, units, library.",
    "pyomo_quad.sweep": "Studies over any fields.",
}
# Problems that take a minute and more: the gallery tells how to solve them.
_SLOW_PROBLEMS = ("kinetic_reactor", "oil_shale")


def generated_pages():
    """Yield the name and the text of every generated page."""
    yield from _api_pages()
    yield "commands.md", _commands_page()
    yield "scenarios.md", _scenarios_page()
    yield "textbook.md", _textbook_page()


def _api_pages():
    seen = {}
    for package in PACKAGES:
        text = f"{package}\n{'=' * len(package)}\n\n{_PACKAGE_WORDS[package]}\n\n"
        text += f".. currentmodule:: {package}\n\n"
        for line in public_names():
            home, name = line.split()
            if home == package:
                text += _entry(package, name, seen)
        yield f"api/{package}.rst", text


def _entry(package, name, seen):
    held = getattr(sys.modules[package], name)
    title = f"{name}\n{'-' * len(name)}\n\n"
    if not callable(held):
        return f"{title}.. autodata:: {package}.{name}\n   :no-value:\n\n"
    first = seen.setdefault(id(held), f"{package}.{name}")
    if first != f"{package}.{name}":
        return f"{title}The same as :py:obj:`{first}`.\n\n"
    if isclass(held):
        return f"{title}.. autoclass:: {package}.{name}\n   :members:\n\n"
    return f"{title}.. autofunction:: {package}.{name}\n\n"


def _commands_page():
    """Return the page of all commands, each with the help that it prints."""
    runner = CliRunner(env={"COLUMNS": "100", "TERM": "dumb", "NO_COLOR": "1"})
    names = [
        (info.name or info.callback.__name__).replace("_", "-") for info in app.registered_commands
    ]
    text = "# Commands\n\n"
    text += "Each command prints this page's text itself: `pyomo-quad COMMAND --help`.\n"
    for name in names:
        told = runner.invoke(app, [name, "--help"], prog_name="pyomo-quad")
        if told.exit_code:
            raise RuntimeError(f"pyomo-quad {name} --help: status {told.exit_code}")
        shown = "\n".join(line.rstrip() for line in told.output.strip().splitlines())
        text += f"\n## {name}\n\n```text\n{shown}\n```\n"
    return text


def _scenarios_page():
    text = (
        "# Shipped scenarios\n\n"
        "Each file is in the folder `scenarios/` of the checkout, and in the package: "
        "`pyomo-quad init --from NAME` writes a copy to change. Every picture and number is of "
        "the committed report.\n"
    )
    for file in sorted((ROOT / "scenarios").glob("*.toml")):
        source = file.read_text(encoding="utf-8")
        told = tomllib.loads(source)
        text += f"\n## {file.stem}\n\n{_about(source)}\n\n"
        write = _study_lines if "scenario" in told else _scenario_lines
        text += write(file.stem, told)
    return text


def _about(source):
    """Return the comment that begins a scenario's file, as one paragraph."""
    lines = source.splitlines()
    first = next(n for n, line in enumerate(lines) if line.startswith("# "))
    said = []
    for line in lines[first:]:
        if not line.startswith("#"):
            break
        said.append(line.removeprefix("#").strip())
    return " ".join(said)


def _scenario_lines(name, told):
    report = ROOT / "reports" / name
    if not (report / "summary.json").is_file():
        return f"```sh\npyomo-quad run scenarios/{name}.toml\n```\n"
    summary = json.loads((report / "summary.json").read_text(encoding="utf-8"))
    with (report / "comparison.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    copied = f"../repository/reports/{name}"
    text = f"![{told.get('title', name)}]({copied}/figures/map.svg)\n\n"
    text += "| | energy (J) | duration (s) | saved by the plan (%) |\n|---|---:|---:|---:|\n"
    for row in rows[:4]:
        saved = row["saving_percent"] or "nan"
        told_saving = "" if saved == "nan" else f"{float(saved):.2f}"
        energy, duration = float(row["energy_J"]), float(row["duration_s"])
        text += f"| {row['flight']} | {energy:.2f} | {duration:.2f} | {told_saving} |\n"
    bound = (summary.get("certificate") or {}).get("lower_bound_J")
    text += f"\nHovering as long: {summary['hover_energy_J']:.2f} J."
    text += "" if bound is None else f" No flight below: {bound:.2f} J."
    text += f" [Report]({copied}/report.md), [page]({copied}/report.html), "
    text += f"[scenario](../repository/scenarios/{name}.toml).\n\n"
    return text + f"```sh\npyomo-quad run scenarios/{name}.toml\n```\n"


def _study_lines(name, told):
    copied = f"../repository/reports/{name}/report"
    figures = sorted((ROOT / "reports" / name / "report" / "figures").glob("*.svg"))
    text = f"{told['about']}\n\n"
    if figures:
        text += f"![{told['title']}]({copied}/figures/{figures[0].name})\n\n"
        text += f"[Report]({copied}/report.md), [study](../repository/scenarios/{name}.toml).\n\n"
    return text + f"```sh\npyomo-quad sweep scenarios/{name}.toml\n```\n"


_NOTEBOOK = """\
---
file_format: mystnb
kernelspec:
  name: python3
---

"""


def _textbook_page():
    """Return the notebook that solves every textbook problem and asserts its optimum."""
    text = _NOTEBOOK + textwrap.dedent("""\
        # Textbook problems

        Each problem is declared in `tests/problems/` as a Pyomo.DAE user would write it, and solved
        here, as this page is built, to an estimated relative error of 1e-6. The optimum must agree
        with the closed form or with every digit published. `python -m tests.problems` prints them
        all at 1e-8 too.

        ```{code-cell} python
        :tags: [remove-input]
        from textbook import show
        ```
        """)
    for case in cases():
        text += f"\n## {case.name.replace('_', ' ').capitalize()}\n\n"
        if case.name in _SLOW_PROBLEMS:
            text += f"Published: {case.published}. Source: {' '.join(case.source.split())}. "
            text += f"It takes minutes: `python -m tests.problems {case.name}`.\n"
        else:
            text += f"```{{code-cell}} python\n:tags: [remove-input]\nshow({case.name!r})\n```\n"
    return text
