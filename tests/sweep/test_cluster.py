"""The rows of a Dask cluster are those of one process, and its losses lose no case."""

import logging
import socket
import subprocess
import sys

import pytest

from pyomo_quad.sweep import ClusterError, cluster_workers
from tests.sweep.cluster import REPOSITORY, cluster
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


LOSING = """
import os, signal, sys
from pathlib import Path
from pyomo_quad.scenario.messages import PyomoQuadError
from pyomo_quad.sweep import cluster_workers
from tests.sweep.sweeping import AfterCases, sweep
address, study, folder, scheduler = sys.argv[1:]
lose = AfterCases(5, lambda: os.kill(int(scheduler), signal.SIGKILL))
try:
    with cluster_workers(address) as workforce:
        sweep(Path(study), Path(folder), workforce, lose)
except PyomoQuadError as error:
    print(error, file=sys.stderr)
"""


@pytest.mark.slow
def test_a_scheduler_that_dies_leaves_one_line_and_no_traceback(study, tmp_path):
    with cluster(tmp_path, seconds="0.02") as dask:
        places = (str(study), str(tmp_path / "out"), str(dask.scheduler.pid))
        done = subprocess.run(
            [sys.executable, "-c", LOSING, dask.address, *places],
            cwd=REPOSITORY,
            capture_output=True,
            text=True,
            timeout=120,
            check=True,
        )
    (line,) = done.stderr.splitlines()
    assert "no longer answers. " in line


def test_dask_says_nothing_itself(monkeypatch):
    monkeypatch.setattr("pyomo_quad.sweep.cluster._CONNECT_SECONDS", 0.1)
    with pytest.raises(ClusterError), cluster_workers("tcp://127.0.0.1:9"):
        pass
    for name in ("distributed", "distributed.client", "tornado.application", "asyncio"):
        assert not logging.getLogger(name).isEnabledFor(logging.CRITICAL)


def test_a_scheduler_that_is_not_there_is_said_in_one_line(monkeypatch):
    monkeypatch.setattr("pyomo_quad.sweep.cluster._CONNECT_SECONDS", 0.5)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        with (
            pytest.raises(ClusterError, match=r"cannot be reached .*leave --scheduler out"),
            cluster_workers(address),
        ):
            pass
