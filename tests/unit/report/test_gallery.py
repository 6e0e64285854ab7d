"""Figures drawn side by side: the files of one process alone, and faults that are explained."""

import hashlib
import os
import re
from itertools import combinations
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from pyomo_quad import processes
from pyomo_quad.report import Figures, gallery
from pyomo_quad.report.document import Drawing, drawn_meanwhile
from pyomo_quad.report.gallery import plan_drawings
from pyomo_quad.report.labels import Label, write_labels
from pyomo_quad.report.report import write_run_report, write_solve_report
from pyomo_quad.report.style import flight_styles, styled_flights
from tests.synthetic_run import synthetic_run


@pytest.fixture(scope="module")
def drawings():
    result = synthetic_run(flights=("optimal", "adaptive/quintic"))
    made = {d.name: d for d in plan_drawings(result.plan, styled_flights(result.flights))}
    return [made[name] for name in ("wind", "mesh")]


def blank(name):
    """A figure that takes no time: for tests of what is around the drawing."""
    return Drawing(
        name=name, title=name, caption=f"{name}.", draw=lambda: Figure(figsize=(1.0, 1.0))
    )


def drawn(drawings, folder):
    folder.mkdir()
    with drawn_meanwhile(drawings, folder):
        pass
    files = sorted((folder / "figures").iterdir())
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


@pytest.mark.lengthy
def test_two_processes_write_the_files_of_one(drawings, tmp_path, monkeypatch):
    together = {}
    for cores in (1, 2):
        monkeypatch.setattr(processes, "cores", lambda _most, cores=cores, **_: cores)
        together[cores] = drawn(drawings, tmp_path / str(cores))
    assert together[1] == together[2]
    assert len(together[1]) == len(drawings)


def test_each_figure_is_drawn_once(tmp_path, monkeypatch):
    def draw(name):
        with (tmp_path / "calls").open("a", encoding="utf-8") as calls:
            calls.write(f"{name} {os.getpid()}\n")
        return blank(name).draw()

    monkeypatch.setattr(processes, "cores", lambda _most, **_: 2)
    counted = [
        Drawing(name=name, title="", caption="", draw=lambda name=name: draw(name))
        for name in "abcdef"
    ]
    drawn(counted, tmp_path / "figures of two processes")
    calls = (tmp_path / "calls").read_text(encoding="utf-8").splitlines()
    assert sorted(call.split()[0] for call in calls) == list("abcdef")


@pytest.fixture
def _few_figures(monkeypatch):
    few = tuple(blank(name) for name in (gallery.PATH_NAME, "wind", "mesh"))
    monkeypatch.setattr(gallery, "plan_drawings", lambda *_: few)
    monkeypatch.setattr(gallery, "comparison_drawings", lambda *_: ())


LINK = re.compile(r"\]\((figures/[^)]*)\)")
KINDS = {
    Figures.SVG: {".svg"},
    Figures.PNG: {".png"},
    Figures.ALL: {".png", ".svg"},
    Figures.NONE: set(),
}


@pytest.mark.usefixtures("_few_figures")
@pytest.mark.parametrize("figures", Figures)
def test_documents_show_the_figures_that_there_are(figures, tmp_path):
    result = synthetic_run(flights=("optimal", "adaptive/quintic"))
    write_run_report(tmp_path, result, figures)
    files = {f"figures/{file.name}" for file in tmp_path.glob("figures/*")}
    assert {Path(file).suffix for file in files} == KINDS[figures]
    text = (tmp_path / "report.md").read_text(encoding="utf-8")
    assert set(LINK.findall(text)) == files
    assert ("figures/" in text) == bool(files)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count("<img ") == len({Path(file).stem for file in files})
    shown = {"svg": "svg+xml", "png": "png", None: None}[next(iter(figures.formats), None)]
    assert set(re.findall(r'<img [^>]* src="data:image/([^;]*);base64', page)) == (
        {shown} if shown else set()
    )
    assert ('id="flight-data"' in page) == (figures is not Figures.NONE)


@pytest.mark.parametrize("figures", [Figures.PNG, Figures.NONE])
@pytest.mark.usefixtures("_few_figures")
def test_a_solve_shows_the_figures_that_there_are(figures, tmp_path):
    write_solve_report(tmp_path, synthetic_run(flights=("optimal",)).plan, figures=figures)
    files = {f"figures/{file.name}" for file in tmp_path.glob("figures/*")}
    text = (tmp_path / "report.md").read_text(encoding="utf-8")
    assert set(LINK.findall(text)) == files
    assert bool(files) == (figures is Figures.PNG)


def test_labels_at_one_place_do_not_cover_each_other():
    """Start and first waypoint lie close together, as in an inspection round a building."""
    figure = Figure(figsize=(7.2, 3.1))
    axes = figure.add_subplot()
    axes.plot([0.0, 10.0, 20.0], [0.0, 5.0, 0.0])
    axes.set(xlim=(-1.0, 21.0), ylim=(-5.0, 6.0))
    named = [
        Label(text="start and goal", x=0.0, y=0.0),
        Label(text="8: 24.6 s", x=1.0, y=0.0),
        Label(text="church", x=10.0, y=0.0, is_centred=True),
    ]
    write_labels(axes, named)
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in axes.texts]
    assert [text.get_text() for text in axes.texts] == [label.text for label in named]
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
    assert all(axes.bbox.x0 <= box.x0 and box.x1 <= axes.bbox.x1 for box in boxes)


def test_five_speeds_of_an_autopilot_have_styles_of_their_own():
    names = ("optimal", *(f"adaptive/cruise {speed} m/s" for speed in (2, 4, 6, 10)))
    styles = flight_styles(names)
    assert len({style.color for style in styles.values()}) == len(names)
