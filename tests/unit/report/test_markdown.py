"""Text from scenarios cannot act as Markdown or HTML."""

import re
import unicodedata
from html import unescape

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pyomo_quad.report.render import (
    Bullets,
    Code,
    Document,
    Heading,
    Paragraph,
    Picture,
    Strong,
    Table,
    Verdict,
    escape_markdown,
    render_html,
    render_markdown,
)

# Printable to Python, yet nothing is drawn: what Unicode ignores by default and does not call a
# format character, and the blank of Braille.
IGNORABLE = {
    chr(code)
    for first, last in (
        (0x34F, 0x34F),
        (0x115F, 0x1160),
        (0x17B4, 0x17B5),
        (0x180B, 0x180F),
        (0x2800, 0x2800),
        (0x3164, 0x3164),
        (0xFE00, 0xFE0F),
        (0xFFA0, 0xFFA0),
        (0xE0100, 0xE01EF),
    )
    for code in range(first, last + 1)
}


def spelled(letter):
    """Write what no reader sees as Python does, all else as it is."""
    unseen = unicodedata.category(letter)[0] == "C" or letter in IGNORABLE
    return ascii(letter)[1:-1] if unseen else letter


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
    words = " ".join("".join(map(spelled, letters)) for letters in text.split())
    assert unescape(re.sub(r"\\(.)", r"\1", escaped)) == words


@pytest.mark.parametrize(
    "unseen",
    [
        *"\u200e\u200f\u061c\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069",
        *"\u200b\u200c\u200d\u2060\u2061\u2064\ufeff\u00ad\u180e\U000e0041",
        *"\u034f\u115f\u3164\uffa0\ufe0f\U000e0100\x00\x1b\x7f\x9b\ud800",
    ],
    ids=ascii,
)
def test_what_would_not_be_seen_is_spelled_out(unseen):
    text = f"a{unseen}b"
    spelling = "a" + ascii(unseen)[1:-1] + "b"
    table = Table(caption=text, header=(text, text), rows=((text, Code(text)),))
    pieces = (text, Strong(text), Code(text))
    blocks = (
        Verdict(is_good=True, pieces=pieces),
        Heading(text),
        Paragraph(pieces),
        Bullets((pieces,)),
        table,
        Picture(name="path", title=text, caption=text),
    )
    document = Document(title=text, blocks=blocks)
    markdown = render_markdown(document)
    page = render_html(document, {"path": b"<svg/>"}, {}, "")
    assert unseen not in markdown + page
    assert markdown.replace("\\\\", "\\").count(spelling) == 18
    assert page.count(spelling) >= 18


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
