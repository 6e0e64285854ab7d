"""Protocols by which plans and runs find the functions that draw and report them.

The lower floors import nothing that draws. The package tells this module, when it is imported, how
to find the functions that do; a plan or a run asks for them when it is drawn.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol


class Picture(Protocol):
    """Drawn figure that notebooks show."""

    @property
    def name(self) -> str:
        """Name of the figure, or the column of the table that it shows."""

    @property
    def caption(self) -> str:
        """Description of the figure, as a report prints it."""

    @property
    def figure(self) -> Any:  # noqa: ANN401  this floor does not import matplotlib
        """The matplotlib figure, to change or to add to."""

    def save(self, path: str | Path) -> Path:
        """Write the figure to a file that ends in .png, .svg or .pdf, and return its path."""


class Presenter(Protocol):
    """Functions that draw and report plans and runs."""

    def picture_of_plan(self, plan: Any, what: str) -> Picture:  # noqa: ANN401
        """Draw the figure named `what` of a plan, or the column named `what` of its table."""

    def picture_of_run(self, result: Any, what: str) -> Picture:  # noqa: ANN401
        """Draw the figure named `what` of a run, or the column named `what` of its plan's table."""

    def report_plan(self, plan: Any, folder: str | Path, figures: str) -> Path:  # noqa: ANN401
        """Write the report of a plan into a folder and return its text file."""

    def report_run(self, result: Any, folder: str | Path, figures: str) -> Path:  # noqa: ANN401
        """Write the report of a run into a folder and return its page."""


_supply: list[Callable[[], Presenter]] = []


def register_presenter(supply: Callable[[], Presenter]) -> None:
    """Register the function that imports and returns the presenter, once for the process."""
    _supply[:] = [supply]


def presenter() -> Presenter:
    """Return the presenter; the first call imports matplotlib."""
    (supply,) = _supply
    return supply()
