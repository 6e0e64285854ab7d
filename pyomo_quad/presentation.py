"""Registry of the presenter, the module that draws figures and writes reports.

The presenter is the module `pyomo_quad.report.presenting`. Methods such as `Plan.plot` reach it
through the function `presenter` of this module. Their modules must not import it: the import of
matplotlib takes time, and the presenter's package imports the packages of plans and runs, so that
the imports would be circular.

Therefore `pyomo_quad/__init__.py` registers here a function that imports the presenter.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol


class Picture(Protocol):
    """Interface of a drawn figure, which a notebook displays and `save` writes to a file."""

    @property
    def name(self) -> str:
        """Name of the figure, or of the column of the trajectory table that the figure shows."""

    @property
    def caption(self) -> str:
        """Caption that a report prints under the figure."""

    @property
    def figure(self) -> Any:  # noqa: ANN401  this floor does not import matplotlib
        """The matplotlib Figure, which the user may change or extend."""

    def save(self, path: str | Path) -> Path:
        """Write the figure to a file and return its path.

        Parameters
        ----------
        path : str or Path
            Name of the file, which ends in .png, .svg or .pdf.
        """


class Presenter(Protocol):
    """Interface of the module `report.presenting`, which draws figures and writes reports.

    The presenter presents plans and runs. A run is the result of `run_scenario`: a plan together
    with the baseline flights that it is compared with.
    """

    def picture_of_plan(self, plan: Any, what: str) -> Picture:  # noqa: ANN401
        """Draw one figure of a plan.

        Parameters
        ----------
        plan : Plan
            Planned flight.
        what : str
            Name of a figure of the plan's report, or a column of the plan's trajectory table, which
            is then drawn against time.

        Returns
        -------
        Picture
            The drawn figure with its caption.
        """

    def picture_of_run(self, result: Any, what: str) -> Picture:  # noqa: ANN401
        """Draw one figure of a run: a plan with the baseline flights it is compared with.

        Parameters
        ----------
        result : RunResult
            Result of `run_scenario`.
        what : str
            Name of a figure of the run's report, or a column of the plan's trajectory table, which
            is then drawn against time.

        Returns
        -------
        Picture
            The drawn figure with its caption.
        """

    def report_plan(self, plan: Any, folder: str | Path, figures: str) -> Path:  # noqa: ANN401
        """Write the report of a plan.

        Parameters
        ----------
        plan : Plan
            Planned flight.
        folder : str or Path
            Folder that receives the report.
        figures : str
            Which figures to write: a value of `pyomo_quad.report.Figures`.

        Returns
        -------
        Path
            The report's Markdown file.
        """

    def report_run(self, result: Any, folder: str | Path, figures: str) -> Path:  # noqa: ANN401
        """Write the report of a run: a plan with the baseline flights it is compared with.

        Parameters
        ----------
        result : RunResult
            Result of `run_scenario`.
        folder : str or Path
            Folder that receives the report.
        figures : str
            Which figures to write: a value of `pyomo_quad.report.Figures`.

        Returns
        -------
        Path
            The report's HTML page.
        """


_supply: list[Callable[[], Presenter]] = []


def register_presenter(supply: Callable[[], Presenter]) -> None:
    """Register the function that imports and returns the presenter.

    The presenter is the module `report.presenting`. A later registration replaces an earlier one.

    Parameters
    ----------
    supply : callable
        Function without arguments that returns a `Presenter`. It is called whenever a figure or
        report is requested.
    """
    _supply[:] = [supply]


def presenter() -> Presenter:
    """Return the registered presenter, the module that draws figures and writes reports.

    The first call imports matplotlib.
    """
    (supply,) = _supply
    return supply()
