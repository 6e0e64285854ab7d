"""Registry of the presenter, the module that draws figures and writes reports.

The presenter is the module `pyomo_quad.report.presenting`. Methods such as `Plan.plot` call
`presenter` of this module and do not import the presenter directly. A direct import would be
circular, and would load matplotlib, which takes time.

`pyomo_quad/__init__.py` registers a function that imports the presenter.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol


class Picture(Protocol):
    """Interface of a drawn figure, which a notebook displays and `save` writes to a file."""

    @property
    def name(self) -> str:
        """Name by which the figure was requested: name of a figure or of a table column."""

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

        `what` names a figure of the plan's report, or a column of its trajectory table, which is
        drawn against time.
        """

    def picture_of_run(self, result: Any, what: str) -> Picture:  # noqa: ANN401
        """Draw one figure of a run: a plan with the baseline flights it is compared with.

        `what` names a figure of the run's report, or a column of the plan's trajectory table, which
        is drawn against time.
        """

    def report_plan(self, plan: Any, folder: str | Path, figures: str) -> Path:  # noqa: ANN401
        """Write the report of a plan, and return its Markdown file.

        `figures` is a value of `pyomo_quad.report.Figures`.
        """

    def report_run(self, result: Any, folder: str | Path, figures: str) -> Path:  # noqa: ANN401
        """Write the report of a run, and return its HTML page.

        `figures` is a value of `pyomo_quad.report.Figures`.
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
