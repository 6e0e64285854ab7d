"""Workers of an existing Dask cluster.

Dask itself gives the cases of a lost worker to another one, and gives a case up that was lost
several times.  When the scheduler goes, nothing can be saved but what is committed: the sweep
stops cleanly and says so.
"""

import logging
import queue
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from pyomo_quad.study.sweep.errors import ClusterError
from pyomo_quad.study.sweep.task import CaseOutcome, CaseTask, perform, worker_version
from pyomo_quad.version import __version__

if TYPE_CHECKING:
    from distributed import Client, Future

__all__ = ["ClusterWorkforce"]

_CONNECT_SECONDS = 10.0
# How often a silent cluster is asked whether it still lives, and how many workers it has.
_WATCH_SECONDS = 2.0
# One task waits behind each running one, so that no worker idles while its result travels.
_TASKS_PER_THREAD = 2


class ClusterWorkforce:
    """The workers behind a Dask scheduler, which may come and go.

    Parameters
    ----------
    client : Client
        Connected.
    address : str
        The scheduler's address, for messages.
    """

    def __init__(self, client: "Client", address: str) -> None:
        self._client = client
        self._address = address
        self._run_id = uuid.uuid4().hex[:8]
        self._running: dict[str, tuple[Future, CaseTask]] = {}
        self._ended: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._threads = 0
        self._counted_at = -_WATCH_SECONDS

    @classmethod
    @contextmanager
    def of(cls, address: str) -> Iterator["ClusterWorkforce"]:
        """Stay connected to a cluster for the length of a block.

        Parameters
        ----------
        address : str
            Of the scheduler, such as ``tcp://10.0.0.1:8786``.

        Yields
        ------
        ClusterWorkforce
            Connected; its workers have this version of the package.

        Raises
        ------
        ClusterError
            If it cannot be reached, or its workers cannot do this work.
        """
        # What Dask logs when it is lost is said here in one line.
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        client = _connect(address)
        try:
            _check_workers(client, address)
            yield cls(client, address)
        finally:
            client.close(timeout=_WATCH_SECONDS)

    @property
    def room(self) -> int:
        """How many more tasks it wants now."""
        if time.monotonic() - self._counted_at > _WATCH_SECONDS:
            self._count_threads()
        # Without any worker, one task waits for the first to come.
        return max(1, _TASKS_PER_THREAD * self._threads) - len(self._running)

    @property
    def description(self) -> str:
        """Who works, for people."""
        return f"Dask cluster {self._address}"

    def submit(self, task: CaseTask) -> None:
        """Take a task.

        Parameters
        ----------
        task : CaseTask
            The case to solve.
        """
        name = f"pyomo-quad-{self._run_id}-{task.key}"
        future = self._client.submit(perform, task, key=name, pure=False)
        self._running[name] = (future, task)
        future.add_done_callback(lambda ended: self._ended.put(ended.key))

    def wait(self) -> list[CaseOutcome]:
        """Wait until at least one task has ended.

        Returns
        -------
        list of CaseOutcome
            All that ended since the last call.
        """
        names: list[str] = []
        while not names:
            try:
                names.append(self._ended.get(timeout=_WATCH_SECONDS))
            except queue.Empty:
                self._count_threads()
        while not self._ended.empty():
            names.append(self._ended.get())
        return [self._collect(name) for name in names]

    def drain(self) -> list[CaseOutcome]:
        """Start nothing more, and give up the tasks that are running.

        Returns
        -------
        list of CaseOutcome
            Those that have ended already.
        """
        ended = [name for name, (future, _) in self._running.items() if future.done()]
        outcomes = [self._collect(name) for name in ended]
        self._client.cancel([future for future, _ in self._running.values()])
        self._running.clear()
        return outcomes

    def _collect(self, name: str) -> CaseOutcome:
        future, task = self._running[name]
        if future.status == "error":
            del self._running[name]
            return CaseOutcome.failure(task, f"given up by the cluster: {future.exception()}")
        if future.status != "finished":
            raise self._lost()
        try:
            outcome: CaseOutcome = future.result(timeout=_CONNECT_SECONDS)
        except (OSError, TimeoutError):
            raise self._lost() from None
        del self._running[name]
        return outcome

    def _count_threads(self) -> None:
        if self._client.status != "running":
            raise self._lost()
        try:
            self._threads = sum(self._client.nthreads().values())
        except (OSError, TimeoutError):
            raise self._lost() from None
        self._counted_at = time.monotonic()

    def _lost(self) -> ClusterError:
        return ClusterError(f"{self._address}: the scheduler no longer answers.")


def _connect(address: str) -> "Client":
    try:
        from distributed import Client  # noqa: PLC0415  an extra that few users need
    except ImportError:
        raise ClusterError(
            "--scheduler needs dask.distributed; install it with: pip install "
            '"pyomo_quad[cluster]".'
        ) from None
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
    except Exception as error:  # noqa: BLE001  whatever a foreign worker raises, it cannot serve
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
