"""A real Dask scheduler and two real worker processes for a test."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.sweep import stand_in

REPOSITORY = Path(__file__).parents[2]
_LONGEST_START = 30.0


@dataclass(frozen=True)
class Cluster:
    """Addresses and processes, to be killed by a test."""

    address: str
    scheduler: subprocess.Popen
    workers: tuple[subprocess.Popen, ...]


@contextmanager
def cluster(folder: Path, seconds: str = "0") -> Iterator[Cluster]:
    """Run a scheduler and two workers of one thread, which take so long for a stand-in case."""
    address_file = folder / "scheduler.json"
    with ExitStack() as stack:
        scheduler = stack.enter_context(
            _dask("scheduler", "--host", "127.0.0.1", "--port", "0", *_QUIET, str(address_file))
        )
        workers = tuple(
            stack.enter_context(
                _dask(
                    *("worker", "--nthreads", "1", "--no-nanny", "--local-directory", str(folder)),
                    *(*_QUIET, str(address_file)),
                    seconds=seconds,
                )
            )
            for _ in range(2)
        )
        yield Cluster(_address_with_workers(address_file, len(workers)), scheduler, workers)


_QUIET = ("--no-dashboard", "--scheduler-file")


@contextmanager
def _dask(*arguments: str, seconds: str = "0") -> Iterator[subprocess.Popen]:
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY), stand_in.SECONDS: seconds}
    process = subprocess.Popen(
        [sys.executable, "-m", "dask", *arguments],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def _address_with_workers(address_file: Path, count: int) -> str:
    from distributed import Client

    started = time.monotonic()
    while not address_file.exists():
        assert time.monotonic() - started < _LONGEST_START, "no scheduler came up"
        time.sleep(0.05)
    with Client(scheduler_file=str(address_file), set_as_default=False) as client:
        client.wait_for_workers(count, timeout=_LONGEST_START)
        return str(client.scheduler.address)
