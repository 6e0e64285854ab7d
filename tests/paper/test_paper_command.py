"""`pyomo-quad paper` through the command line."""

import json
import subprocess
import sys

import pandas as pd
import pytest

from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.paper.report import TOLERANCES
from pyomo_quad.paper.tables import TABLES

COMMAND = (sys.executable, "-m", "pyomo_quad", "paper")


def test_a_folder_with_strange_files_is_refused_before_anything_is_solved(tmp_path, capsys):
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    assert main(["paper", "--out", str(tmp_path)]) == ExitCode.FAULT
    assert "notes.txt" in capsys.readouterr().err
    assert [entry.name for entry in tmp_path.iterdir()] == ["notes.txt"]


def test_a_misspelt_option_is_bad_input(capsys):
    assert main(["paper", "--quik"]) == ExitCode.BAD_INPUT
    assert "--quik" in capsys.readouterr().err


@pytest.mark.slow
def test_a_quick_report_is_whole_and_near_the_committed_one(tmp_path):
    folder = tmp_path / "paper"
    done = subprocess.run(
        [*COMMAND, "--quick", "--out", str(folder)], check=False, capture_output=True, text=True
    )
    assert done.returncode == ExitCode.VERIFIED, done.stderr
    assert (folder / "report.md").stat().st_size > 10_000
    assert json.loads((folder / "timings.json").read_text(encoding="utf-8"))
    for name in TABLES:
        assert not pd.read_csv(folder / f"{name}.csv").empty
    optima = with_statuses(folder, "reports/paper")
    for tolerance in TOLERANCES:
        new, old = (
            pd.read_csv(f"{place}/{tolerance.table}.csv") for place in (folder, "reports/paper")
        )
        keys = [name for name in _IDENTITIES if name in new]
        both = new.merge(old, on=keys, suffixes=("", "_old"))
        assert len(both) == len(new)
        # A solve that proved no optimum is shown, and not held.
        if tolerance.columns == ("optimum_J",):
            both = both.merge(optima, on=["experiment", "power_model"])
        if "status" in both:
            both = both[(both[["status", "status_old"]] != "not_converged").all(axis=1)]
        for column in tolerance.columns:
            found, committed = both[column].to_numpy(), both[f"{column}_old"].to_numpy()
            assert found == pytest.approx(committed, rel=tolerance.relative), tolerance.table


def with_statuses(*folders):
    """The statuses of the experiments' optima in two reports."""
    named = [
        pd.read_csv(f"{folder}/experiments.csv")[["experiment", "power_model", "status"]]
        for folder in folders
    ]
    return named[0].merge(named[1], on=["experiment", "power_model"], suffixes=("", "_old"))


_IDENTITIES = (
    "experiment",
    "power_model",
    "coupling",
    "frequency_unit",
    "flight",
    "battery",
    "cells_series",
    "reading",
    "rotor_acceleration_max_rad_per_s2",
)
