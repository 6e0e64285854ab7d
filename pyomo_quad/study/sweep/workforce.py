"""What a sweep needs of whoever does the work: processes of this machine, or a Dask cluster."""

from typing import Protocol

from pyomo_quad.study.sweep.task import CaseOutcome, CaseTask

__all__ = ["Workforce"]


class Workforce(Protocol):
    """Takes tasks and gives outcomes back, in whatever order they end."""

    @property
    def room(self) -> int:
        """How many more tasks it wants now."""
        ...

    @property
    def description(self) -> str:
        """Who works, for people."""
        ...

    def submit(self, task: CaseTask) -> None:
        """Take a task.

        Parameters
        ----------
        task : CaseTask
            The case to solve.
        """
        ...

    def wait(self) -> list[CaseOutcome]:
        """Wait until at least one task has ended.

        Returns
        -------
        list of CaseOutcome
            All that ended since the last call.
        """
        ...

    def drain(self) -> list[CaseOutcome]:
        """Start nothing more, and wait for the tasks that are running.

        Returns
        -------
        list of CaseOutcome
            Those that ended well; tasks not started are forgotten.
        """
        ...
