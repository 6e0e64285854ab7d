"""Figures drawn side by side: the files of one process alone, and faults that are explained."""

import hashlib
import os

import pytest

from pyomo_quad.report import gallery
from pyomo_quad.report.gallery import Drawing, plan_drawings, save_drawings
from pyomo_quad.report.style import styled_flights
from tests.synthetic_run import synthetic_run


@pytest.fixture(scope="module")
def drawings():
    result = synthetic_run(flights=("optimal", "adaptive/quintic"))
    made = {d.name: d for d in plan_drawings(result.plan, styled_flights(result.flights))}
    return [made[name] for name in ("battery", "wind", "mesh")]


def drawn(drawings, folder):
    folder.mkdir()
    save_drawings(drawings, folder)
    files = sorted((folder / "figures").iterdir())
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def test_two_processes_write_the_files_of_one(drawings, tmp_path, monkeypatch):
    together = {}
    for cores in (1, 2):
        monkeypatch.setattr(gallery, "_cores", lambda _most, cores=cores: cores)
        together[cores] = drawn(drawings, tmp_path / str(cores))
    assert together[1] == together[2]
    assert len(together[1]) == 2 * len(drawings)


def test_each_figure_is_drawn_once(drawings, tmp_path, monkeypatch):
    def draw(drawing):
        with (tmp_path / "calls").open("a", encoding="utf-8") as calls:
            calls.write(f"{drawing.name} {os.getpid()}\n")
        return drawing.draw()

    monkeypatch.setattr(gallery, "_cores", lambda _most: 2)
    counted = [
        Drawing(name=d.name, title="", caption="", draw=lambda d=d: draw(d)) for d in drawings
    ]
    drawn(counted, tmp_path / "figures of two processes")
    calls = (tmp_path / "calls").read_text(encoding="utf-8").splitlines()
    assert sorted(call.split()[0] for call in calls) == sorted(d.name for d in drawings)


def test_a_fault_of_another_process_is_met_again_here(tmp_path, monkeypatch, capfd):
    def fail():
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(gallery, "_cores", lambda _most: 3)
    with pytest.raises(OSError, match="No space left on device"):
        save_drawings([Drawing(name="a", title="", caption="", draw=fail)], tmp_path)
    assert capfd.readouterr().err == ""


def test_more_figures_than_places_in_the_queue(drawings, tmp_path, monkeypatch):
    monkeypatch.setattr(gallery, "_PLACES", 2)
    assert len(drawn(drawings, tmp_path / "many")) == 2 * len(drawings)
