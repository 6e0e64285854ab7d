"""Who does the work does not show in the rows, and the death of a worker loses no case."""

import pytest

from pyomo_quad.sweep import process_workers
from tests.sweep import stand_in
from tests.sweep.studies import write_study
from tests.sweep.sweeping import AfterCases, Here, press_ctrl_c, rows, sweep


@pytest.fixture
def study(tmp_path):
    return write_study(tmp_path)


@pytest.mark.slow
def test_one_and_two_processes_give_the_rows_of_none(study, tmp_path):
    sweep(study, tmp_path / "none", Here())
    for count in (1, 2):
        folder = tmp_path / str(count)
        with process_workers(count) as workforce:
            summary = sweep(study, folder, workforce)
        assert (summary.finished, summary.missing) == (50, 0)
        assert rows(folder).equals(rows(tmp_path / "none"))


@pytest.mark.slow
def test_a_case_that_kills_its_worker_is_one_lost_row(study, tmp_path, monkeypatch):
    monkeypatch.setenv(stand_in.FATAL_PAYLOAD, "0.2")
    study.write_text(study.read_text().replace("count = 10", "count = 1"))
    with process_workers(2) as workforce:
        summary = sweep(study, tmp_path / "out", workforce)
    assert (summary.finished, summary.lost, summary.missing) == (4, 1, 0)
    frame = rows(tmp_path / "out")
    lost = frame[frame["status"] == "lost"]
    assert list(lost["vehicle.payload"]) == [0.2]
    assert lost["reason"].str.startswith("its worker died, also when it was tried alone").all()


def test_a_case_that_raises_is_a_row_with_its_reason(study, tmp_path):
    study.write_text(study.read_text().replace("first = 4.0", "first = 2.5"))
    summary = sweep(study, tmp_path / "out", Here())
    assert (summary.finished, summary.failed) == (45, 5)
    frame = rows(tmp_path / "out")
    assert set(frame.loc[frame["status"] == "failed", "reason"]) == {
        "ValueError: 2.5 s is too short"
    }


def test_impossible_combination_is_a_row_with_its_reason(study, tmp_path):
    # The rotors carry 1.71 kg; each payload is allowed by the schema.
    study.write_text(study.read_text().replace("last = 0.2", "last = 0.8"))
    summary = sweep(study, tmp_path / "out", Here())
    assert summary.missing == 0
    frame = rows(tmp_path / "out")
    heavy = frame[frame["vehicle.payload"] > 0.5]
    assert len(heavy) == 20
    assert heavy["reason"].str.contains("hover needs .* raise the limit or lower the mass").all()


def test_interrupt_keeps_what_is_finished_and_the_next_run_goes_on(study, tmp_path):
    folder = tmp_path / "out"
    interrupt = AfterCases(12, press_ctrl_c)
    summary = sweep(study, folder, Here(), interrupt)
    assert summary.is_interrupted
    assert summary.missing >= 37
    assert len(rows(folder)) == 50 - summary.missing
    assert not sweep(study, folder, Here()).is_interrupted
    assert len(rows(folder)) == 50
