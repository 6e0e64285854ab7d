"""A document as Markdown."""

import re
from collections.abc import Sequence
from typing import assert_never

from pyomo_quad.report.document import (
    FIGURE_FOLDER,
    Block,
    Bullets,
    Code,
    Document,
    Heading,
    Paragraph,
    Picture,
    Piece,
    Strong,
    Table,
    Verdict,
    visible,
)

__all__ = ["escape_markdown", "render_markdown"]

_ENTITIES = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;"})
_SPECIAL = re.compile(r"([\\`*_\[\]#|~$])")
# What would start a list or draw a line.
_LINE_START = re.compile(r"^([-+](?=\s|$)|-{3,}$|\d+(?=[.)](?:\s|$)))")


def escape_markdown(text: str) -> str:
    """Return text that Markdown prints as it stands.

    Parameters
    ----------
    text : str
        Any text; line breaks become spaces.

    Returns
    -------
    str
        With the characters escaped that Markdown or HTML would act on, and those spelled out that
        would not be seen.
    """
    one_line = visible(" ".join(text.split()))
    escaped = _SPECIAL.sub(r"\\\1", one_line.translate(_ENTITIES))
    # No address becomes a link that the author of this report did not make.
    unlinked = escaped.replace("://", ":&#47;&#47;").replace("www.", "www&#46;")
    return _LINE_START.sub(lambda found: _entities(found[0]), unlinked)


def render_markdown(document: Document) -> str:
    """Return a document as Markdown.

    Parameters
    ----------
    document : Document
        The content.

    Returns
    -------
    str
        The file's text; pictures are linked as PNG in the folder of figures.
    """
    parts = [f"# {escape_markdown(document.title)}", *map(_block, document.blocks)]
    return "\n\n".join(parts) + "\n"


def _entities(text: str) -> str:
    return "".join(f"&#{ord(character)};" for character in text)


def _block(block: Block) -> str:
    match block:
        case Heading(text=text):
            return f"## {escape_markdown(text)}"
        case Paragraph(pieces=pieces):
            return _text(pieces)
        case Verdict(pieces=pieces):
            return f"> {_text(pieces)}"
        case Bullets(items=items):
            return "\n".join(f"- {_text(item)}" for item in items)
        case Table():
            return _table(block)
        case Picture(name=name, title=title, caption=caption):
            address = f"{FIGURE_FOLDER}/{name}"
            return (
                f"![{escape_markdown(title)}]({address}.png)\n\n"
                f"*{escape_markdown(caption)}* ([SVG]({address}.svg))"
            )
        case _:
            assert_never(block)


def _table(table: Table) -> str:
    rules = ["---:" if column in table.numeric else "---" for column in range(len(table.header))]
    lines = [[escape_markdown(name) for name in table.header], rules]
    lines += [[_piece(cell) for cell in row] for row in table.rows]
    rows = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    return f"**{escape_markdown(table.caption)}**\n\n{rows}"


def _text(pieces: Sequence[Piece]) -> str:
    return "".join(_piece(piece) for piece in pieces)


def _piece(piece: Piece) -> str:
    match piece:
        case Code(text=text):
            return _code(text)
        case Strong(text=text):
            return f"**{escape_markdown(text)}**"
        case str():
            return _keep_edges(piece)
        case _:
            assert_never(piece)


def _keep_edges(text: str) -> str:
    before = " " if text[:1].isspace() else ""
    after = " " if text[-1:].isspace() and text.strip() else ""
    return f"{before}{escape_markdown(text)}{after}"


def _code(text: str) -> str:
    # Inside a code span nothing can be escaped: a text that would end it stands outside one.
    if set(visible(text)) & set("`|\\\n\r") or text != text.strip() or not text:
        return escape_markdown(text)
    return f"`{text}`"
