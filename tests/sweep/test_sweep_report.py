"""The report of a sweep is made from its store alone, and is the same each time."""

import pandas as pd
import pytest

from pyomo_quad.cli.app import main
from pyomo_quad.report.sweep import write_sweep_report
from pyomo_quad.study.sweep import ResultStore, results_frame
from tests.sweep.studies import DURATION_AXIS, PAYLOAD_AXIS, write_study
from tests.sweep.sweeping import Here, rows, sweep

WIND_AXES = """
[[axis]]
path = "wind.speed"
values = [0.0, 2.0, 4.0]

[[axis]]
path = "wind.direction"
linear = { first = 0.0, last = 5.5, count = 8 }
"""
RANDOM_AXES = """
[sampling]
count = 40
seed = 1

[[axis]]
path = "vehicle.payload"
uniform = { low = 0.0, high = 0.2 }

[[axis]]
path = "wind.speed"
normal = { mean = 4.0, standard_deviation = 0.5 }
"""


@pytest.mark.parametrize(
    ("axes", "figures"),
    [
        (
            DURATION_AXIS + PAYLOAD_AXIS,
            ["along_vehicle_payload", "map_energy_J", "pareto", "tornado_energy_J"],
        ),
        (
            WIND_AXES,
            ["along_wind_speed", "map_energy_J", "tornado_energy_J", "wind_rose_energy_J"],
        ),
        (RANDOM_AXES, ["distribution", "scatter", "tornado_energy_J"]),
    ],
)
def test_each_design_gets_the_figures_that_fit_it(tmp_path, axes, figures):
    sweep(write_study(tmp_path, axes), tmp_path / "out", Here())
    assert main(["sweep-report", str(tmp_path / "out")]) == 0
    report = tmp_path / "out" / "report"
    drawn = sorted(path.stem for path in (report / "figures").glob("*.png"))
    assert drawn == figures
    text = (report / "report.md").read_text()
    assert all(f"figures/{name}.png" in text for name in figures)


def test_tables_hold_every_row_in_three_formats(tmp_path, monkeypatch):
    monkeypatch.setattr("pyomo_quad.report.sweep.sweep_report.save_drawings", lambda *_: None)
    sweep(write_study(tmp_path), tmp_path / "out", Here())
    assert main(["sweep-report", str(tmp_path / "out")]) == 0
    report, expected = tmp_path / "out" / "report", rows(tmp_path / "out")
    pd.testing.assert_frame_equal(pd.read_parquet(report / "results.parquet"), expected)
    read = pd.read_csv(report / "results.csv", keep_default_na=False)
    pd.testing.assert_frame_equal(read, expected, check_dtype=False)
    assert (report / "results.md").read_text().count("| finished |") == 50


def test_report_is_equal_byte_for_byte_when_made_again(tmp_path):
    sweep(write_study(tmp_path, DURATION_AXIS), tmp_path / "out", Here())
    with ResultStore.reading(tmp_path / "out") as store:
        design, frame = store.design, results_frame(store)
    contents = []
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        write_sweep_report(tmp_path / name, design, frame)
        files = sorted(path for path in (tmp_path / name).rglob("*") if path.is_file())
        contents.append([path.read_bytes() for path in files])
    assert contents[0] == contents[1]


def test_report_names_the_best_duration_and_the_failures(tmp_path):
    # The stand-in's energy is P T + 4000 / T^2, least at T = (8000 / P)^(1/3), P = 70 x 1.3^1.5.
    axes = '[[axis]]\npath = "mission.duration"\nvalues = [2.5, 3.0, 4.0, 4.25, 5.0, 10.0]\n'
    sweep(write_study(tmp_path, axes), tmp_path / "out", Here())
    assert main(["sweep-report", str(tmp_path / "out")]) == 0
    text = (tmp_path / "out" / "report" / "report.md").read_text()
    assert "5 of 6 cases finished" in text
    assert "2.5 s is too short" in text
    best = next(line for line in text.splitlines() if line.startswith("| all |"))
    assert best.split("|")[2].strip() == "4.25"


def test_an_empty_folder_and_an_empty_store_are_said_in_one_line(tmp_path, capsys):
    assert main(["sweep-report", str(tmp_path)]) == 1
    assert "holds no sweep.sqlite; give the folder of a sweep" in capsys.readouterr().err
