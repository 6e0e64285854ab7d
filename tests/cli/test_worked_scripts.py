"""The worked scripts run as they stand, and say what they promise."""

import json
import runpy
import shutil
from pathlib import Path

import pandas as pd
import pytest

from pyomo_quad.scenario.accuracy import FIGURES, Accuracy
from tests.command import SCENARIOS


@pytest.mark.lengthy
def test_a_mission_of_ones_own(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(SCENARIOS / "worked_mission.py"))
    said = capsys.readouterr().out
    assert "<Plan scenario: worked_mission, status: verified" in said
    rows = pd.read_csv("worked_mission_px4.csv")
    # North, east, down: the plan's x is east. A plan of accuracy `standard` is a simulated flight.
    end = rows[["x", "y", "z"]].iloc[-1].tolist()
    assert end == pytest.approx([0.0, 20.0, -5.0], abs=FIGURES[Accuracy.STANDARD].miss)


@pytest.mark.slow
def test_a_comparison(tmp_path, capsys):
    for name in ("worked_comparison.py", "paper_wind.toml"):
        shutil.copy(SCENARIOS / name, tmp_path)
    runpy.run_path(str(tmp_path / "worked_comparison.py"))
    said = capsys.readouterr().out
    assert "<RunResult scenario: paper_wind, status: verified, optimal: " in said
    assert "bound" in said


@pytest.mark.slow
def test_a_vehicle_from_its_flights(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(SCENARIOS / "worked_vehicle.py"))
    said = capsys.readouterr().out
    assert "cross-validated by flight: 1.8" in said
    assert "Written to polar." in said
    flown, hovering = (float(word) for word in said.splitlines()[-1].split() if word.isdigit())
    # Against the wind it climbs 10 m: no flight so long takes less than steady ones draw at least.
    least_W = json.loads(Path("polar", "summary.json").read_text())["least_power_W"]
    assert 16.0 * least_W < hovering < flown
