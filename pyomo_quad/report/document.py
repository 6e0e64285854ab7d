"""Writing of a report: tables, summary, figures and text together.

Matplotlib is imported only when a figure is drawn.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pyomo_quad.report import Figures
from pyomo_quad.report.render import FIGURE_FOLDER, render_markdown
from pyomo_quad.report.tables import Table, write_summary, write_table
from pyomo_quad.study.processes import side_by_side
from pyomo_quad.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REPORT_NAME = "report.md"
PAGE_NAME = "report.html"


@dataclass(frozen=True)
class Drawing:
    """Figure of a report: name, title, caption, and the function that draws it.

    ``needs`` names the columns that the figure shows, ``formats`` the endings of its files.
    """

    name: str
    title: str
    caption: str
    draw: Callable[[], "Figure"]
    needs: tuple[str, ...] = ()
    formats: tuple[str, ...] = Figures.SVG.formats

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the figure's files; the report shows the first."""
        return tuple(f"{self.name}.{ending}" for ending in self.formats)


def wanted_drawings(drawings: Iterable[Drawing], figures: Figures) -> tuple[Drawing, ...]:
    """Return the drawings in the requested formats, none for `Figures.NONE`."""
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
    """Write the report of a study: tables, summary, figures and text.

    Parameters
    ----------
    folder : Path
        An existing folder without reports.
    template : str
        The template of the text, a path below the package. Besides ``values`` it receives
        ``tables`` (the names of the files), ``drawings`` (those requested, in the requested
        formats) and ``version``.
    tables : mapping of str to DataFrame or mapping, optional
        Tables to write as CSV, by the file's name.
    summary : mapping, optional
        Values to write as `summary.json`.
    drawings : iterable of Drawing, optional
        The figures, in the order of the report; not iterated if no figures are wanted.
    figures : Figures, optional
        Whether figures are drawn, and in which formats.
    name : str, optional
        File of the text.
    **values
        Values of the template.

    Returns
    -------
    tuple of Drawing
        The figures that were drawn.
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
    """Write the text of a report, the file ``name``, and its figures as one HTML file.

    ``is_good``, ``views`` and ``data`` are those of `page.render_html`.
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
    """Fill in a template below the package and write the Markdown to a file."""
    file.write_text(render_markdown(template, **values), encoding="utf-8")


@contextmanager
def drawn_meanwhile(drawings: Iterable[Drawing], folder: Path) -> Iterator[None]:
    """Draw figures into a report's `FIGURE_FOLDER` on other cores while the block runs."""
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
    with side_by_side(tasks, use_blas=False) as finish:
        yield
        finish()
