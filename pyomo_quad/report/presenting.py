"""Figures and reports for methods such as `Plan.plot` and `RunResult.report`.

The methods reach this module through the function `pyomo_quad.presentation.presenter`, which
imports the module at the first call, because matplotlib takes time to import.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl

from pyomo_quad.report import Figures
from pyomo_quad.report.document import PAGE_NAME, REPORT_NAME, Drawing
from pyomo_quad.report.folder import MARK, output_file, output_folder
from pyomo_quad.report.gallery import column_drawing, drawings_of_run, drawings_of_solve
from pyomo_quad.report.report import write_run_report, write_solve_report
from pyomo_quad.report.style import HOUSE_STYLE, plan_flight, save_figure, styled_flights
from pyomo_quad.report.tables import plan_summary, run_summary, write_summary
from pyomo_quad.scenario.messages import ScenarioError, shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pyomo_quad.flight import Plan
    from pyomo_quad.report.style import StyledFlight
    from pyomo_quad.study.run import RunResult

#: Endings of the files that a single figure is written to.
ENDINGS = (".png", ".svg", ".pdf")


@dataclass(frozen=True, kw_only=True, repr=False)
class DrawnFigure:
    """Drawn figure of a plan or run: a notebook displays it, and `save` writes it to a file.

    Attributes
    ----------
    name : str
        Name by which the figure was requested: name of a figure or of a table column.
    caption : str
        Caption that a report prints under the figure.
    figure : matplotlib Figure
        The figure itself, for changes by the user.
    """

    name: str
    caption: str
    figure: "Figure"

    def save(self, path: str | Path) -> Path:
        """Write the figure to a file that ends in .png, .svg or .pdf, and return its path.

        Raises ScenarioError for another ending. Raises OutputError if the file cannot be written,
        or exists and is not a figure that this package wrote.
        """
        file = Path(path)
        refuse_other_endings(file, "path")
        with output_file(file) as aside:
            save_figure(lambda: self.figure, {file.suffix.removeprefix("."): aside}, MARK)
        return file

    def __repr__(self) -> str:
        return f"<figure {self.name}: {self.caption}>"

    def _repr_png_(self) -> bytes:
        drawn = BytesIO()
        with mpl.rc_context(HOUSE_STYLE):
            self.figure.savefig(drawn, format="png")
        return drawn.getvalue()


def refuse_other_endings(file: Path, name: str) -> None:
    """Raise a ScenarioError if the file name of a figure does not end in .png, .svg or .pdf.

    `name` is the argument or option that gave the file name, for the message.
    """
    if file.suffix not in ENDINGS:
        raise ScenarioError(f"{name} {file}: must end in {', '.join(ENDINGS)}.")


def chosen_drawing(
    offered: Iterable[Drawing], flight: "StyledFlight", what: str, name: str
) -> Drawing:
    """Return the figure that a user names: an offered figure, or a column over time.

    `what` is the name of a drawing in `offered`, or else of a column of the flight's table. `name`
    is the name of the argument or option with the value `what`, for the error message. Raises
    ScenarioError if `what` is neither a drawing nor a column.
    """
    drawings = {drawing.name: drawing for drawing in offered}
    if what in drawings:
        return drawings[what]
    if what in flight.frame:
        return column_drawing(flight, what)
    raise ScenarioError(
        f"{name} = {shown(what)}; must be one of {', '.join(drawings)}, or a column of the table:"
        f" {', '.join(map(str, flight.frame.columns))}."
    )


def picture_of_plan(plan: "Plan", what: str) -> DrawnFigure:
    """Draw one figure of a plan, or one column of its trajectory table against time.

    Raises ScenarioError if no figure and no column has the name `what`.
    """
    return _picture(lambda: drawings_of_solve(plan), plan, what)


def picture_of_run(result: "RunResult", what: str) -> DrawnFigure:
    """Draw one figure of a run's report, or one column of its plan's table against time.

    Raises ScenarioError if no figure and no column has the name `what`.
    """
    return _picture(lambda: drawings_of_run(result), result.plan, what)


def _picture(drawings: Callable[[], Iterable[Drawing]], plan: "Plan", what: str) -> DrawnFigure:
    (flight,) = styled_flights([plan_flight(plan)])
    drawing = chosen_drawing(drawings(), flight, what, "what")
    with mpl.rc_context(HOUSE_STYLE):
        return DrawnFigure(name=drawing.name, caption=drawing.caption, figure=drawing.draw())


def report_plan(plan: "Plan", folder: str | Path, figures: str) -> Path:
    """Write the report of a plan into a folder, and return the report's Markdown file.

    Raises ScenarioError if `figures` is no value of `Figures`. Raises OutputError if the folder
    cannot be written, or holds files that this package did not write.
    """
    chosen = _figures(figures)
    with output_folder(folder) as aside:
        write_solve_report(aside, plan, figures=chosen)
        write_summary(aside, plan_summary(plan, wall_s=_NO_SECONDS))
    return Path(folder) / REPORT_NAME


def report_run(result: "RunResult", folder: str | Path, figures: str) -> Path:
    """Write the report of a run into a folder, and return the report's HTML page.

    Raises ScenarioError if `figures` is no value of `Figures`. Raises OutputError if the folder
    cannot be written, or holds files that this package did not write.
    """
    chosen = _figures(figures)
    with output_folder(folder) as aside:
        write_run_report(aside, result, chosen)
        write_summary(aside, run_summary(result, wall_s=_NO_SECONDS))
    return Path(folder) / PAGE_NAME


# Wall times of import and report for the summary: commands measure them, this module does not.
_NO_SECONDS: Mapping[str, float] = {}


def _figures(figures: str) -> Figures:
    if figures not in list(Figures):
        raise ScenarioError(f"figures = {shown(figures)}; must be one of {', '.join(Figures)}.")
    return Figures(figures)
