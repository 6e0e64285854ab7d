"""Writing of a report's files: tables, summary, figures and text.

The figures are drawn in parallel while tables and text are written. Matplotlib is imported only
when a figure is drawn.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pyomo_quad.processes import side_by_side
from pyomo_quad.report import Figures
from pyomo_quad.report.render import FIGURE_FOLDER, render_markdown
from pyomo_quad.report.tables import Table, write_summary, write_table
from pyomo_quad.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REPORT_NAME = "report.md"
PAGE_NAME = "report.html"


@dataclass(frozen=True)
class Drawing:
    """Figure of a report before it is drawn: name, title, caption and drawing function.

    Attributes
    ----------
    name : str
        Name of the figure's file, without ending.
    title, caption : str
        Heading above the figure, and text below it.
    draw : callable
        Function without arguments that returns the matplotlib Figure.
    needs : tuple of str
        Columns of the flight's table that the figure requires. `write_study` draws all figures that
        it gets. Its caller must leave out a figure if the table lacks one of these columns.
    formats : tuple of str
        File endings of the figure.
    """

    name: str
    title: str
    caption: str
    draw: Callable[[], "Figure"]
    needs: tuple[str, ...] = ()
    formats: tuple[str, ...] = Figures.SVG.formats

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the figure's files, one for each format; the report displays the first one."""
        return tuple(f"{self.name}.{ending}" for ending in self.formats)


def wanted_drawings(drawings: Iterable[Drawing], figures: Figures) -> tuple[Drawing, ...]:
    """Return the figures of a report, with the file formats in which they are to be written.

    `figures` is the user's choice of formats, which becomes `Drawing.formats` of each figure. The
    result is empty for `Figures.NONE`.
    """
    if figures is Figures.NONE:
        return ()
    return tuple(replace(drawing, formats=figures.formats) for drawing in drawings)


def write_study(
    folder: Path,
    template: str,
    *,
    tables: "Mapping[str, Table] | None" = None,
    summary: Mapping[str, Any] | None = None,
    drawings: Iterable[Drawing] = (),
    figures: Figures = Figures.SVG,
    name: str = REPORT_NAME,
    **values: object,
) -> tuple[Drawing, ...]:
    """Write a report: CSV tables, `summary.json`, figures and the text from a template.

    `folder` must exist, and `name` is the file name of the text. `template` is a path below the
    package's folder, and ``values`` are its variables. The keys of `tables` are file names. The
    result lists the figures that were drawn.
    """
    wanted, tables = wanted_drawings(drawings, figures), tables or {}
    with drawn_meanwhile(wanted, folder):
        for file, table in tables.items():
            write_table(table, folder / file)
        if summary is not None:
            write_summary(folder, summary)
        write_text(
            folder / name,
            template,
            tables=tuple(tables),
            drawings=wanted,
            version=__version__,
            **values,
        )
    return wanted


def write_page(
    folder: Path,
    name: str,
    drawn: Iterable[Drawing],
    *,
    is_good: bool,
    views: Mapping[str, str],
    data: str,
) -> None:
    """Write a report as one self-contained HTML file, `report.html`, from its text and figures.

    `name` is the file of the report's Markdown text. The other arguments are those of
    `render_html`.
    """
    from pyomo_quad.report.page import render_html  # noqa: PLC0415  a solve writes no page

    figures = folder / FIGURE_FOLDER
    page = render_html(
        (folder / name).read_text(encoding="utf-8"),
        is_good=is_good,
        pictures={one.name: (figures / one.files[0]).read_bytes() for one in drawn},
        views=views,
        data=data,
    )
    (folder / PAGE_NAME).write_text(page, encoding="utf-8")


def write_text(file: Path, template: str, **values: object) -> None:
    """Fill in a Markdown template and write the text to a file.

    Parameters
    ----------
    file : Path
        File to write.
    template : str
        Template, as a path below the package's folder.
    **values
        Variables of the template.
    """
    file.write_text(render_markdown(template, **values), encoding="utf-8")


@contextmanager
def drawn_meanwhile(drawings: Iterable[Drawing], folder: Path) -> Iterator[None]:
    """Context manager: draw and save figures on other cores while the ``with`` block runs.

    At the end of the block, this process draws the figures that are left. The figures go to the
    subfolder `FIGURE_FOLDER` of `folder`.
    """
    wanted = tuple(drawings)
    if not wanted:
        yield
        return
    from pyomo_quad.report.style import save_figure  # noqa: PLC0415  matplotlib takes a second

    target = folder / FIGURE_FOLDER
    target.mkdir(exist_ok=True)

    def save(drawing: Drawing) -> None:
        paths = [target / file for file in drawing.files]
        save_figure(drawing.draw, dict(zip(drawing.formats, paths, strict=True)))

    tasks = [partial(save, drawing) for drawing in wanted]
    # If the block raises an error, some figures may be missing.
    with side_by_side(tasks, use_blas=False) as finish:
        yield
        finish()
