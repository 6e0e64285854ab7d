"""A document as one HTML file that needs nothing else, not even a network."""

import html
from base64 import b64encode
from collections.abc import Mapping, Sequence
from typing import assert_never

from pyomo_quad.report.document import (
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
from pyomo_quad.report.page_style import STYLE_SHEET

__all__ = ["render_html"]

# The browser itself keeps the page from loading or sending anything.
_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; "
    "img-src data: blob:; base-uri 'none'; form-action 'none'"
)


def render_html(
    document: Document, pictures: Mapping[str, bytes], views: Mapping[str, str], script: str
) -> str:
    """Return a document as an HTML page.

    Parameters
    ----------
    document : Document
        The content.
    pictures : mapping of str to bytes
        SVG of each picture of the document, by name.
    views : mapping of str to str
        HTML of what stands above a picture on a screen, by the picture's name.
    script : str
        JavaScript that runs when all else is there.

    Returns
    -------
    str
        The file's text.
    """
    title = _escape(document.title)
    body = "\n".join(_block(block, document, pictures, views) for block in document.blocks)
    scripts = f"<script>{script}</script>\n" if script else ""
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<title>{title}</title>\n<link rel="icon" href="data:,">\n'
        f"<style>{STYLE_SHEET}</style>\n</head>\n"
        '<body>\n<a class="skip" href="#content">Skip to the content</a>\n'
        f'<main id="content">\n<h1>{title}</h1>\n{body}\n</main>\n{scripts}</body>\n</html>\n'
    )


def _escape(text: str) -> str:
    """Return text that HTML prints as it stands, with what would not be seen spelled out."""
    return html.escape(visible(text))


def _block(
    block: Block, document: Document, pictures: Mapping[str, bytes], views: Mapping[str, str]
) -> str:
    match block:
        case Heading(text=text):
            return f'<h2 id="{_anchor(text)}">{_escape(text)}</h2>'
        case Paragraph(pieces=pieces):
            return f"<p>{_text(pieces)}</p>"
        case Verdict(is_good=is_good, pieces=pieces):
            kind = "verdict good" if is_good else "verdict"
            return f'<div class="{kind}"><p>{_text(pieces)}</p></div>\n{_navigation(document)}'
        case Bullets(items=items):
            return f"<ul>{''.join(f'<li>{_text(item)}</li>' for item in items)}</ul>"
        case Table():
            return _table(block)
        case Picture(name=name):
            return views.get(name, "") + _figure(block, pictures[name])
        case _:
            assert_never(block)


def _navigation(document: Document) -> str:
    headings = [block.text for block in document.blocks if isinstance(block, Heading)]
    links = "".join(f'<li><a href="#{_anchor(text)}">{_escape(text)}</a></li>' for text in headings)
    return f'<nav aria-label="Contents"><ul>{links}</ul></nav>'


def _figure(picture: Picture, svg: bytes) -> str:
    data = b64encode(svg).decode("ascii")
    return (
        f"<figure>{_scrolled(picture.title)}"
        f'<img alt="{_escape(picture.title)}. {_escape(picture.caption)}" '
        f'src="data:image/svg+xml;base64,{data}"></div>'
        f"<figcaption>{_escape(picture.caption)}</figcaption></figure>"
    )


def _table(table: Table) -> str:
    header = "".join(
        f'<th scope="col"{_alignment(table, column)}>{_escape(name)}</th>'
        for column, name in enumerate(table.header)
    )
    rows = "".join(f"<tr>{_row(table, row)}</tr>" for row in table.rows)
    return (
        f"{_scrolled(table.caption)}<table><caption>{_escape(table.caption)}</caption>"
        f"<thead><tr>{header}</tr></thead><tbody>{rows}</tbody></table></div>"
    )


def _row(table: Table, row: Sequence[Piece]) -> str:
    first, *others = row
    cells = "".join(
        f"<td{_alignment(table, column)}>{_piece(cell)}</td>"
        for column, cell in enumerate(others, start=1)
    )
    return f'<th scope="row">{_piece(first)}</th>{cells}'


def _alignment(table: Table, column: int) -> str:
    return ' class="number"' if column in table.numeric else ""


def _scrolled(label: str) -> str:
    # What is wider than a phone scrolls by itself, also with the keyboard.
    return f'<div class="scroll" tabindex="0" role="group" aria-label="{_escape(label)}">'


def _text(pieces: Sequence[Piece]) -> str:
    return "".join(_piece(piece) for piece in pieces)


def _piece(piece: Piece) -> str:
    match piece:
        case Code(text=text):
            return f"<code>{_escape(text)}</code>"
        case Strong(text=text):
            return f"<strong>{_escape(text)}</strong>"
        case str():
            return _escape(piece)
        case _:
            assert_never(piece)


def _anchor(text: str) -> str:
    return "".join(c if c.isascii() and c.isalnum() else "-" for c in text.lower())
