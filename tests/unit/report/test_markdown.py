"""Text from scenarios cannot act as Markdown or HTML."""

import re
from html import unescape

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pyomo_quad.report.document import (
    Bullets,
    Code,
    Document,
    Heading,
    Paragraph,
    Strong,
    Table,
    Verdict,
)
from pyomo_quad.report.markdown import escape_markdown, render_markdown


@pytest.mark.parametrize(
    "hostile",
    [
        "<script>alert(1)</script>",
        "<img src=x onerror=alert(1)>",
        "[click](javascript:alert(1))",
        "![x](https://example.com/pixel.png)",
        "a | b",
        "`code`",
        "**bold** _it_ ~~gone~~",
        "$x$",
        "&lt;b&gt;",
        "https://example.com www.example.com",
        "- item",
        "1. item",
        "---",
    ],
)
def test_hostile_text_is_printed_as_it_stands(hostile):
    escaped = escape_markdown(hostile)
    assert not re.search(r"<|>|(?<!\\)[\[\]`*_|~$]|://|www\.", escaped)
    assert not re.match(r"([-+]|\d+[.)])(\s|$)|-{3,}$", escaped)
    assert unescape(re.sub(r"\\(.)", r"\1", escaped)) == hostile


@given(st.text())
def test_any_text_stays_on_one_line_and_reads_back(text):
    escaped = escape_markdown(text)
    assert "\n" not in escaped
    assert unescape(re.sub(r"\\(.)", r"\1", escaped)) == " ".join(text.split())


def test_document_renders_every_kind_of_block():
    document = Document(
        title="A_b",
        blocks=(
            Verdict(is_good=True, pieces=(Strong("Verified."), " 7 J")),
            Heading("Next"),
            Paragraph(("see ", Code("plan.csv"))),
            Bullets((("one",), (Code("a`b"),))),
            Table(
                caption="Flights",
                header=("Flight", "Energy (J)"),
                rows=((Code("adaptive/quintic"), "-1.5"),),
                numeric=frozenset({1}),
            ),
        ),
    )
    assert render_markdown(document) == (
        "# A\\_b\n\n> **Verified.** 7 J\n\n## Next\n\nsee `plan.csv`\n\n- one\n- a\\`b\n\n"
        "**Flights**\n\n| Flight | Energy (J) |\n| --- | ---: |\n| `adaptive/quintic` | -1.5 |\n"
    )
