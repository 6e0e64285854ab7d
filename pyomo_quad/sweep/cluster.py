"""Connection of a sweep to the workers of a Dask cluster."""

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from pyomo_quad.sweep.case import worker_version
from pyomo_quad.sweep.workers import WATCH_SECONDS, ClusterError, Workers
from pyomo_quad.version import __version__

if TYPE_CHECKING:
    from distributed import Client

_CONNECT_SECONDS = 10.0
_DASK_LOGGERS = ("distributed", "tornado", "asyncio")


@contextmanager
def cluster_workers(address: str) -> Iterator[Workers]:
    """Context manager: connect to a Dask cluster, and run the cases of a sweep on its workers.

    Dask moves the cases of a lost worker to others. A case that loses several workers is given up.
    If the scheduler is lost, stored results are kept.

    Parameters
    ----------
    address : str
        Address of the Dask scheduler, such as ``tcp://host:8786``.

    Yields
    ------
    Workers
        Workers of the cluster, for the method `Sweep.run`.

    Raises
    ------
    ClusterError
        If `dask.distributed` is not installed here, the scheduler cannot be reached, or a worker
        lacks pyomo_quad or has another version of it.

    Examples
    --------
    >>> from distributed import LocalCluster
    >>> with LocalCluster(n_workers=1, dashboard_address=None) as cluster:
    ...     with cluster_workers(cluster.scheduler_address) as workers:
    ...         print(type(workers).__name__)
    Workers
    """
    client = _connect(address)
    try:
        _check_workers(client, address)
        threads = _Threads(client, address)
        workers = Workers(
            description=f"Dask cluster {address}",
            begin=lambda: client.get_executor(pure=False),
            end=lambda executor: executor.shutdown(wait=False),
            count=threads.count,
        )
        yield workers
        workers.stop()
    finally:
        client.close(timeout=WATCH_SECONDS)


def _silence_dask() -> None:
    """Turn off the log messages of Dask, because this module reports a lost cluster itself.

    Call this function after the import of Dask, which sets the levels of its loggers.
    """
    for name in list(logging.root.manager.loggerDict):
        if name.partition(".")[0] in _DASK_LOGGERS:
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)


class _Threads:
    """Counter of the worker threads of a Dask cluster, each of which solves one case at a time.

    The method `count` raises `ClusterError` if the cluster no longer answers.
    """

    def __init__(self, client: "Client", address: str) -> None:
        self._client = client
        self._address = address
        self._found = 0
        self._counted_at = -WATCH_SECONDS

    def count(self) -> int:
        # Ask the cluster at most once in this time; otherwise return the last number.
        if time.monotonic() - self._counted_at >= WATCH_SECONDS:
            gone = ClusterError(f"Dask cluster {self._address}: no longer answers.")
            if self._client.status != "running":
                raise gone
            try:
                self._found = sum(self._client.nthreads().values())
            except (OSError, TimeoutError):
                raise gone from None
            self._counted_at = time.monotonic()
        return self._found


def _connect(address: str) -> "Client":
    try:
        from distributed import Client  # noqa: PLC0415  an extra that few users need
    except ImportError:
        raise ClusterError(
            "--scheduler needs dask.distributed; install it with: pip install "
            '"pyomo_quad[cluster]".'
        ) from None
    _silence_dask()
    try:
        return Client(address, timeout=_CONNECT_SECONDS, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        reason = " ".join(str(error).split())[:120]
        raise ClusterError(
            f"--scheduler {address}: cannot be reached ({reason}); start it with `dask "
            f"scheduler`, or leave --scheduler out to use this machine."
        ) from None


def _check_workers(client: "Client", address: str) -> None:
    try:
        versions = client.run(worker_version)
    except Exception as error:  # noqa: BLE001  any error of a remote worker makes it unusable
        raise ClusterError(
            f"--scheduler {address}: a worker cannot run pyomo_quad ({type(error).__name__}: "
            f"{error}); install pyomo_quad {__version__} on all workers."
        ) from None
    for worker, version in versions.items():
        if version != __version__:
            raise ClusterError(
                f"--scheduler {address}: worker {worker} has pyomo_quad {version}, this is "
                f"{__version__}; install the same version on all workers."
            )
