"""The rows of a Dask cluster are those of one process, and its losses lose no case."""

import socket

import pytest

from pyomo_quad.sweep import ClusterError, cluster_workers
from tests.sweep.cluster import cluster
from tests.sweep.studies import write_study
from tests.sweep.sweeping import AfterCases, Here, rows, sweep

pytest.importorskip("distributed")


@pytest.fixture
def study(tmp_path):
    return write_study(tmp_path)


@pytest.fixture
def expected(study, tmp_path):
    sweep(study, tmp_path / "expected", Here())
    return rows(tmp_path / "expected")


@pytest.mark.slow
def test_rows_are_those_of_one_process_though_a_worker_is_lost(study, tmp_path, expected):
    with (
        cluster(tmp_path, seconds="0.02") as dask,
        cluster_workers(dask.address) as workforce,
    ):
        summary = sweep(study, tmp_path / "whole", workforce)
        assert (summary.finished, summary.missing) == (50, 0)
        assert rows(tmp_path / "whole").equals(expected)

        lose_one = AfterCases(15, dask.workers[0].kill)
        summary = sweep(study, tmp_path / "maimed", workforce, lose_one)
        assert dask.workers[0].wait() != 0
        assert (summary.finished, summary.failed, summary.missing) == (50, 0, 0)
        assert rows(tmp_path / "maimed").equals(expected)


@pytest.mark.slow
def test_a_scheduler_that_dies_stops_the_sweep_and_keeps_its_rows(study, tmp_path, expected):
    folder = tmp_path / "out"
    with (
        cluster(tmp_path, seconds="0.02") as dask,
        cluster_workers(dask.address) as workforce,
        pytest.raises(
            ClusterError,
            match=r"no longer answers. \d+ of 50 cases are kept in .*; run the same command again",
        ),
    ):
        sweep(study, folder, workforce, AfterCases(15, dask.scheduler.kill))
    kept = rows(folder)
    assert 15 <= len(kept) < 50
    summary = sweep(study, folder, Here())
    assert summary.already_finished == len(kept)
    assert rows(folder).equals(expected)


def test_a_scheduler_that_is_not_there_is_said_in_one_line(monkeypatch):
    monkeypatch.setattr("pyomo_quad.sweep.runner._CONNECT_SECONDS", 0.5)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        with (
            pytest.raises(ClusterError, match=r"cannot be reached .*leave --scheduler out"),
            cluster_workers(address),
        ):
            pass
