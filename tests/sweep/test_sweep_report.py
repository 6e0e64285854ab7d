"""The report of a sweep is made from its store alone, and is the same each time."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from pyomo_quad.cli.commands import main
from pyomo_quad.report import Figures
from pyomo_quad.sweep import (
    ResultStore,
    design_sweep,
    load_study,
    results_frame,
    write_sweep_report,
)
from pyomo_quad.sweep.charts import draw_tornado, draw_wind_rose
from pyomo_quad.sweep.quantities import output_quantity
from pyomo_quad.sweep.statistics import Curve, Sensitivity, Spread
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


@pytest.mark.lengthy
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
    drawn = sorted(path.stem for path in (report / "figures").glob("*.svg"))
    assert drawn == figures
    text = (report / "report.md").read_text()
    assert all(f"figures/{name}.svg" in text for name in figures)


@pytest.mark.lengthy
def test_tables_hold_every_row_in_three_formats(tmp_path):
    sweep(write_study(tmp_path), tmp_path / "out", Here())
    assert main(["sweep-report", str(tmp_path / "out"), "--figures", "none"]) == 0
    report, expected = tmp_path / "out" / "report", rows(tmp_path / "out")
    pd.testing.assert_frame_equal(pd.read_parquet(report / "results.parquet"), expected)
    read = pd.read_csv(report / "results.csv", keep_default_na=False)
    pd.testing.assert_frame_equal(read, expected, check_dtype=False)
    assert (report / "results.md").read_text().count("| finished |") == 50


@pytest.mark.lengthy
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
    assert main(["sweep-report", str(tmp_path / "out"), "--figures", "none"]) == 0
    text = (tmp_path / "out" / "report" / "report.md").read_text()
    assert "5 of 6 cases finished" in text
    assert "2.5 s is too short" in text
    best = next(line for line in text.splitlines() if line.startswith("| all |"))
    assert best.split("|")[2].strip() == "4.25"


def test_an_empty_folder_and_an_empty_store_are_said_in_one_line(tmp_path, capsys):
    assert main(["sweep-report", str(tmp_path)]) == 1
    assert "holds no sweep.sqlite; give the folder of a sweep" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("durations", "place"),
    [
        ("4.0, 4.25, 5.0", "between 4 and 5 s, both dearer"),
        ("4.5, 5.0, 6.0", "at the edge: the shortest tried, a shorter one may be cheaper"),
        ("3.0, 3.5, 4.0", "at the edge: the longest tried, a longer one may be cheaper"),
        ("2.5, 4.5, 6.0", "at the edge of what finished: 2.5 s failed"),
    ],
)
def test_report_says_when_the_best_duration_is_only_the_edge_of_what_was_tried(
    tmp_path, durations, place
):
    # As above, the least energy of the stand-in is at 4.25 s.
    axes = f'[[axis]]\npath = "mission.duration"\nvalues = [{durations}]\n'
    sweep(write_study(tmp_path, axes), tmp_path / "out", Here())
    assert main(["sweep-report", str(tmp_path / "out"), "--figures", "none"]) == 0
    text = (tmp_path / "out" / "report" / "report.md").read_text()
    best = next(line for line in text.splitlines() if line.startswith("| all |"))
    assert best.split("|")[-2].strip() == place


@pytest.mark.parametrize(
    ("task", "column", "miss_m", "said"),
    [
        ("fly_plan", "terminal_miss_m", 0.051, "2 of 10 flights miss the goal by more than"),
        ("fly_plan", "terminal_miss_m", 0.049, "Terminal miss: all 10 flights end within"),
        ("optimise", "step_terminal_miss_m", 0.051, "2 of 10 flights miss the goal"),
        ("optimise", "terminal_miss_m", 1e-5, None),
    ],
)
def test_report_counts_the_flights_that_did_not_arrive(tmp_path, task, column, miss_m, said):
    design = design_sweep(load_study(write_study(tmp_path, DURATION_AXIS)))
    times = [float(step[0]) for step in design.dimensions[0].steps]
    frame = pd.DataFrame({"case": range(10), "mission.duration": times, "energy_J": times})
    frame = frame.assign(status="finished", reason="")
    frame[column] = [0.01] * 8 + [miss_m] * 2
    (tmp_path / "report").mkdir()
    write_sweep_report(tmp_path / "report", replace(design, task=task), frame, Figures.NONE)
    text = (tmp_path / "report" / "report.md").read_text()
    assert ("flights" in text) == (said is not None)
    if said is not None:
        assert said in text
        assert ("(cases 8, 9)" in text) == (miss_m > 0.05)


def test_a_rose_starts_at_its_least_value_and_marks_the_worst_direction():
    angles = np.radians(np.arange(0.0, 360.0, 30.0))
    curves = [
        Curve(
            fixed={"wind.speed": speed},
            rows=pd.DataFrame(
                {"wind.direction": angles, "energy_J": 740.0 + speed * (1 - np.cos(angles - np.pi))}
            ),
        )
        for speed in (0.0, 8.0)
    ]
    (axes,) = draw_wind_rose(curves, "wind.direction", output_quantity("energy_J")).axes
    assert axes.get_ylim()[0] == pytest.approx(740.0)
    stars = [line.get_xydata()[0] for line in axes.lines if line.get_marker() == "*"]
    assert len(stars) == 1  # calm air has no worst direction
    assert stars[0] == pytest.approx([0.0, 756.0])


@pytest.mark.parametrize(("base", "parts"), [(25.0, 2), (10.0, 1), (float("nan"), 1)])
def test_the_colours_of_a_tornado_meet_at_the_base_case(base, parts):
    ends = {"least_at": 0.0, "greatest_at": 1.0, "base": base}
    found = [
        Sensitivity(field="vehicle.payload", least=10.0, greatest=30.0, **ends),
        Sensitivity(field="wind.speed", least=10.0, greatest=26.0, **ends),
    ]
    spread = Spread(least=5.0, greatest=60.0, least_case=3, greatest_case=7, linear_share=0.01)
    (axes,) = draw_tornado(found, spread, output_quantity("energy_J")).axes
    bars = [patch for patch in axes.patches if patch.get_width() > 0.0]
    assert min(bar.get_x() for bar in bars) == 5.0
    assert max(bar.get_x() + bar.get_width() for bar in bars) == 60.0
    for row, one in enumerate(found, start=1):
        drawn = [bar for bar in bars if abs(bar.get_y() + bar.get_height() / 2 - row) < 0.1]
        assert len(drawn) == parts
        assert sum(bar.get_width() for bar in drawn) == pytest.approx(one.swing)
        colors = {bar.get_x() >= base: bar.get_facecolor() for bar in drawn}
        assert len(colors) == len(set(colors.values())) == parts


def test_a_field_that_is_a_list_can_vary(tmp_path):
    goals = (
        '[[axis]]\npath = "mission.goal.position"\nvalues = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]\n'
    )
    sweep(write_study(tmp_path, goals + DURATION_AXIS), tmp_path / "out", Here())
    assert main(["sweep-report", str(tmp_path / "out"), "--figures", "none"]) == 0
    text = (tmp_path / "out" / "report" / "report.md").read_text()
    assert "20 of 20 cases finished" in text
