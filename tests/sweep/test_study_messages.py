"""What a study file may not say, and what a store refuses; all before anything is solved."""

import sqlite3

import pytest

from pyomo_quad.scenario.messages import ScenarioError
from pyomo_quad.sweep import (
    ResultStore,
    StoreError,
    StudyError,
    design_sweep,
    load_study,
    results_frame,
)
from pyomo_quad.sweep.store import STORE_NAME
from tests.sweep.studies import DURATION_AXIS, PAYLOAD_AXIS, write_study
from tests.sweep.sweeping import Here, rows, sweep


def axis(path: str, given: str) -> str:
    return f'[[axis]]\npath = "{path}"\n{given}\n'


def design_of(folder, axes, head=""):
    return design_sweep(load_study(write_study(folder, axes, head)))


@pytest.mark.parametrize(
    ("axes", "complaint"),
    [
        (axis("mission.duratoin", "values = [1.0]"), "unknown key mission.duratoin; did you mean "),
        (
            axis("mission.duration", "values = [5.0, -1.0]"),
            r"mission.duration = -1.* must be > 0",
        ),
        (axis("vehicle.payload", "linear = { first = -0.1, last = 0.1, count = 3 }"), "payload"),
        (axis("battery.cells_series", "values = [3.5]"), r"cells_series = 3.5"),
        (axis("power.model", 'values = ["steam"]'), "steam"),
        (axis("mission.goal.position[7]", "values = [1.0]"), r"position\[7\]"),
        (axis("wind..speed", "values = [1.0]"), "is not the path of a scenario field"),
        (DURATION_AXIS + DURATION_AXIS, "sets what another axis sets already"),
        (axis("mission.duration", "values = [5.0, 5.0]"), r"repeats 5.*; give it once"),
        (
            axis("mission.duration", "steps = [5.0]"),
            r"unknown key axis\[0\].steps; known keys here: path",
        ),
        (
            axis("mission.duration", "linear = { start = 4.0, last = 5.0, count = 2 }"),
            r"unknown key axis\[0\].linear.start; did you mean axis\[0\].linear.first\?",
        ),
        (
            axis("mission.duration", "linear = { first = 4.0, stop = 5.0, count = 2 }"),
            r"unknown key axis\[0\].linear.stop; did you mean axis\[0\].linear.last\?",
        ),
        (
            axis("mission.duration", "normal = { mean = 4.0, sigma = 5.0 }"),
            r"did you mean axis\[0\].normal.standard_deviation\?",
        ),
        (
            axis("mission.duration", "uniform = { low = 5.0, high = 6.0 }"),
            r"is random; add a table \[sampling\]",
        ),
        (
            axis("mission.duration", 'values = [5.0, 6.0]\ngroup = "g"')
            + axis("vehicle.payload", 'values = [0.1]\ngroup = "g"'),
            'axes of group "g" have 2 and 1 values; give each the same number',
        ),
    ],
)
def test_axes_are_refused_in_one_line(tmp_path, axes, complaint):
    with pytest.raises(ScenarioError, match=complaint) as caught:
        design_of(tmp_path, axes)
    assert "\n" not in str(caught.value)


def test_a_model_builder_of_the_scenario_is_refused(tmp_path):
    with pytest.raises(StudyError, match="model builder of its own, which a sweep does not run"):
        design_of(tmp_path, DURATION_AXIS, 'fixed.model = "mine.py:build"')


def test_message_about_an_axis_names_the_study_and_not_the_command_line(tmp_path):
    with pytest.raises(ScenarioError) as caught:
        design_of(tmp_path, axis("mission.duration", "values = [5.0, -1.0]"))
    assert str(caught.value).startswith(str(tmp_path / "study.toml"))


def test_more_cases_than_the_limit_need_a_yes(tmp_path, monkeypatch):
    many = axis("mission.duration", "linear = { first = 4.0, last = 9.0, count = 1001 }")
    with pytest.raises(StudyError, match=r"make 1001 cases, more than 1000; .* give --yes"):
        design_of(tmp_path, many)
    monkeypatch.setattr("pyomo_quad.sweep.study_file.CASE_LIMIT", 10)
    loaded = load_study(write_study(tmp_path, many.replace("1001", "11")))
    with pytest.raises(StudyError, match="make 11 cases, more than 10; "):
        design_sweep(loaded)
    assert design_sweep(loaded, is_large_allowed=True).case_count == 11


def test_grouped_axes_advance_together(tmp_path):
    grouped = axis("mission.duration", 'values = [5, 6]\ngroup = "g"') + axis(
        "vehicle.payload", 'values = [0.1, 0.2]\ngroup = "g"'
    )
    design = design_of(tmp_path, grouped)
    assert design.dimensions[0].steps == ((5.0, 0.1), (6.0, 0.2))


@pytest.mark.parametrize(
    ("head", "complaint"),
    [
        (
            'report_on = ["energy"]',
            'report_on: no output is called "energy"; did you mean energy_J',
        ),
        ('outputs = ["enrgy_J"]', 'outputs: no output is called "enrgy_J"; did you mean energy_J'),
        ('outputs = ["x"]', "the outputs are energy_J, hover_energy_J, "),
        ('report_on = ["quintic_energy_J"]', "no output is called"),
        ('task = "fly_plan"\nreport_on = ["error_estimate"]', "no output is called"),
        ('report_on = ["energy_J", "energy_J"]', r"report_on\[1\] repeats .*; give it once"),
        ('baselines = ["quintic", "quintic"]', r"baselines\[1\] repeats .*; give it once"),
        ('task = "fly_plan"\nbaselines = ["quintic"]', "remove baselines, or give task = "),
    ],
)
def test_columns_are_refused_before_anything_is_solved(tmp_path, head, complaint):
    with pytest.raises(StudyError, match=complaint) as caught:
        load_study(write_study(tmp_path, head=head))
    assert "\n" not in str(caught.value)


def test_columns_of_baselines_can_be_asked_for(tmp_path):
    head = 'baselines = ["quintic"]\nreport_on = ["quintic_energy_J"]'
    assert design_of(tmp_path, DURATION_AXIS, head).report_on == ("quintic_energy_J",)


@pytest.mark.lengthy
def test_a_wider_study_extends_its_store(tmp_path):
    sweep(write_study(tmp_path), tmp_path / "out", Here())
    wider = DURATION_AXIS.replace("last = 13.0, count = 10", "last = 15.0, count = 12")
    summary = sweep(write_study(tmp_path, wider + PAYLOAD_AXIS), tmp_path / "out", Here())
    assert (summary.total, summary.already_finished, summary.finished) == (60, 50, 10)
    assert list(rows(tmp_path / "out")["case"]) == list(range(60))


@pytest.mark.lengthy
def test_a_changed_study_says_what_changed_and_asks_for_fresh(tmp_path):
    sweep(write_study(tmp_path), tmp_path / "out", Here())
    narrower = write_study(tmp_path, DURATION_AXIS)
    with pytest.raises(StoreError, match=r"axis vehicle.payload: removed.*--fresh"):
        sweep(narrower, tmp_path / "out", Here())
    other_base = write_study(tmp_path, head="fixed.vehicle.mass = 1.4")
    with pytest.raises(
        StoreError, match=r"holds 50 cases .*scenario.vehicle.mass: 1.3 -> 1.4.*--fresh"
    ):
        sweep(other_base, tmp_path / "out", Here())
    design = design_sweep(load_study(other_base))
    with ResultStore.writing(tmp_path / "out", design, is_fresh=True) as store:
        assert results_frame(store).empty


@pytest.mark.lengthy
def test_a_store_of_another_version_is_refused(tmp_path):
    study, folder = write_study(tmp_path), tmp_path / "out"
    sweep(study, folder, Here())
    database = sqlite3.connect(folder / STORE_NAME)
    with database:
        database.execute("UPDATE sweep SET value = '0.0.1' WHERE name = 'version'")
    with pytest.raises(StoreError, match=r"made by pyomo_quad 0\.0\.1, this is .*--fresh"):
        sweep(study, folder, Here())
    assert len(rows(folder)) == 50  # reading is still allowed
    with database:
        database.execute("PRAGMA user_version = 99")
    database.close()
    with pytest.raises(StoreError, match=r"has store format 99, .* uses format 1"):
        rows(folder)


def test_a_file_that_is_no_store_is_refused_and_left_alone(tmp_path):
    study, folder = write_study(tmp_path), tmp_path / "out"
    folder.mkdir()
    (folder / STORE_NAME).write_text("my notes, not a database " * 100)
    with pytest.raises(StoreError, match="is not a result store; move it away"):
        sweep(study, folder, Here())
    assert (folder / STORE_NAME).read_text().startswith("my notes")
    with pytest.raises(StoreError, match=r"holds no sweep\.sqlite; give the folder of a sweep"):
        rows(tmp_path)


def test_two_sweeps_do_not_write_to_one_folder(tmp_path):
    study, folder = write_study(tmp_path), tmp_path / "out"
    design = design_sweep(load_study(study))
    with (
        ResultStore.writing(folder, design),
        pytest.raises(StoreError, match="another sweep is writing here"),
    ):
        sweep(study, folder, Here())
