"""Text from scenarios cannot act as Markdown or HTML."""

import re
import unicodedata
from html import unescape

import pytest
from hypothesis import given
from hypothesis import strategies as st
from jinja2 import UndefinedError
from markdown_it import MarkdownIt

from pyomo_quad.report.render import environment, escape_markdown

TEMPLATE = """# {{ text }}

> **{{ text }}** {{ text }}

## {{ text }}

{{ text }} {{ text | code }}

- {{ text }}
- {{ text | code }}

**Table of {{ text }}**

| {{ text }} | {{ text }} |
| --- | ---: |
| {{ text | code }} | {{ text }} |

![{{ text }}](figures/path.png)

*Caption: {{ text }}.* ([SVG](figures/path.svg))
"""

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


def words_of(text):
    """Write a text on one line, as a reader is to see it."""
    return " ".join("".join(map(spelled, letters)) for letters in text.split())


def every_block(text):
    """Print a text in every place where a report prints one."""
    return environment().from_string(TEMPLATE).render(text=text)


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
    assert unescape(re.sub(r"\\(.)", r"\1", escaped)) == words_of(text)


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
    markdown = every_block(text)
    assert unseen not in markdown
    assert markdown.replace("\\\\", "\\").count(spelling) == 15


@pytest.mark.lengthy
@given(st.text().filter(str.strip))
def test_no_text_adds_to_what_a_reader_of_markdown_finds(text):
    def kinds(words):
        parser = MarkdownIt("gfm-like", {"linkify": False})
        tokens = parser.parse(every_block(words))
        parts = [part.type for token in tokens for part in token.children or ()]
        # A text that a code span cannot hold stands as plain text.
        marks = [part for part in parts if part not in {"text", "text_special", "code_inline"}]
        return [token.type for token in tokens], marks

    assert kinds(text) == kinds("text")


def test_what_a_template_lacks_is_a_fault_and_what_its_macros_wrote_is_not_escaped_again():
    with pytest.raises(UndefinedError, match="'text' is undefined"):
        environment().from_string(TEMPLATE).render()
    macro = "{% macro strong(x) %}**{{ x }}**{% endmacro %}{{ strong(text) }} {{ text }}"
    assert environment().from_string(macro).render(text="a*b") == "**a\\*b** a\\*b"
