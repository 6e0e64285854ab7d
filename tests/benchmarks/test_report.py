"""The benchmarks' report holds what was stored, and the book quotes it."""

import csv
import json
import re
from pathlib import Path
from types import SimpleNamespace

from tests.benchmarks.report import FOLDER, NAMES, REPORT, Table, render, store

RESULTS = " ".join(Path("docs/evidence/results.md").read_text(encoding="utf-8").split())


def stored(name):
    with (FOLDER / f"{name}.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_a_part_that_is_measured_again_leaves_the_others(tmp_path):
    def keep(name, found):
        table = Table(name=f"{name}_speed", title="Cells", header=["what", "s"], rows=[found])
        store(name, SimpleNamespace(TITLE=f"Of {name}", ABOUT="A line."), [table], tmp_path)

    keep("sweep", ["a | b", 1.25])
    keep("engine", ["first", 2])
    keep("engine", ["second", 3])
    text = render(tmp_path)
    assert "| a \\| b | 1.25 |" in text
    assert "| second | 3 |" in text
    assert "first" not in text
    assert text.index("## Of engine") < text.index("## Of sweep")
    versions = json.loads((tmp_path / "engine.json").read_text(encoding="utf-8"))["versions"]
    assert f"casadi {versions['casadi']}" in text


def test_the_committed_report_is_what_the_stored_results_give():
    assert (FOLDER / REPORT).read_text(encoding="utf-8") == render()
    assert {file.stem for file in FOLDER.glob("*.json")} <= set(NAMES)


def test_the_book_quotes_the_gain_of_the_engine():
    for name, said in (("stock", r"\*\*([\d.]+) to ([\d.]+) times\*\*"),
                       ("by hand", r"and ([\d.]+) to ([\d.]+) times")):  # fmt: skip
        gains = [float(row[f"{name}, times as long"]) for row in stored("engine_gain")]
        least, greatest = re.search(said, RESULTS).groups()
        assert [float(least), float(greatest)] == [min(gains), max(gains)]


def test_the_book_quotes_the_gain_of_a_run():
    gains = {row["command"]: float(row["wall, times as fast"]) for row in stored("run_gain")}
    alike = [gains[f"`run {name}`"] for name in ("paper_wind.toml --set=baseline.mpc.knowledge=[]",
                                                 "paper_calm.toml")]  # fmt: skip
    said = re.search(r"\*\*([\d.]+) and ([\d.]+) times\*\* as fast as\s+before", RESULTS).groups()
    assert [float(number) for number in said] == [round(gain, 1) for gain in alike]


def test_the_book_quotes_the_outcomes_of_random_missions():
    rows = [row for row in stored("robustness") if row["seed"] == "all"] or stored("robustness")
    counts = {row["outcome"]: int(row["missions"]) for row in rows}
    verified, infeasible = counts["verified"], counts["infeasible, proven"]
    said = (
        f"Of {sum(counts.values())} random missions {verified} were verified, {infeasible} proven"
    )
    assert said in RESULTS
    assert ("**none lost**" in RESULTS) == (counts["lost"] == 0)
