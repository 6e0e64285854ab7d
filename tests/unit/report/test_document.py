"""The report of a study: every table, summary, figure and text, from one call."""

import json

import pandas as pd
import pytest
from matplotlib.figure import Figure

from pyomo_quad.report import Figures
from pyomo_quad.report.document import Drawing, write_study

TEMPLATE = """{% from "report/sections.md.j2" import figures with context %}
# {{ title }}
{{ figures(drawings) }}
{{ tables | map("code") | join(", ") }}, version {{ version }}
"""


@pytest.fixture
def template(monkeypatch):
    """A template of no study, beside those of the package."""
    from jinja2 import ChoiceLoader, DictLoader

    from pyomo_quad.report.render import environment

    made = environment()
    loader = ChoiceLoader([DictLoader({"study.md.j2": TEMPLATE}), made.loader])
    monkeypatch.setattr(made, "loader", loader)
    return "study.md.j2"


@pytest.mark.parametrize("figures", [Figures.NONE, Figures.ALL])
def test_all_parts_of_a_study_are_written_and_linked(tmp_path, template, figures):
    write_study(
        tmp_path,
        template,
        tables={"speeds.csv": pd.DataFrame({"speed_m_s": [1.0, 2.5]})},
        summary={"best_m_s": 2.5},
        drawings=[
            Drawing(name="speeds", title="Speeds", caption="Them.", draw=lambda: Figure((1, 1)))
        ],
        figures=figures,
        title="*Speeds*",
    )
    text = (tmp_path / "report.md").read_text()
    assert text.startswith("# \\*Speeds\\*\n")
    assert "`speeds.csv`, version" in text
    assert (tmp_path / "speeds.csv").read_text() == "speed_m_s\n1\n2.5\n"
    assert json.loads((tmp_path / "summary.json").read_text()) == {"best_m_s": 2.5}
    drawn = {file.name for file in tmp_path.glob("figures/*")}
    assert drawn == {f"speeds.{ending}" for ending in figures.formats}
    assert ("## Speeds" in text) is bool(drawn)
    assert all(f"(figures/{name})" in text for name in drawn)
