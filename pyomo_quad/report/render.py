"""A report's content as Markdown and as one HTML file that needs nothing else."""

import html
import re
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import degrees, isfinite
from typing import assert_never
from unicodedata import category

from pyomo_quad.flight import PlanStatus
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.tables import Hover, PowerModel, WindCoupling

#: Stands where a table has no number.
NOTHING = "n/a"

POWER_WORDS = {
    PowerModel.MOTOR: "electrical power of the motors, copper loss included",
    PowerModel.EFFICIENCY: "shaft power over the recovered efficiency f_r, eq. (8)",
    PowerModel.SHAFT: "shaft power",
    PowerModel.CONSTANT_EFFICIENCY: "shaft power over a constant efficiency",
    PowerModel.MOTOR_WITH_FRICTION: "electrical power of the motors, with their friction",
}

COUPLING_WORDS = {
    WindCoupling.ACCELERATION: "added to the acceleration as printed in eq. (9), times 1 1/s",
    WindCoupling.DRAG: "through drag on the relative airspeed",
}

STATUS_WORDS = {
    PlanStatus.VERIFIED: "Verified",
    PlanStatus.SOLVED: "Not verified",
    PlanStatus.NOT_CONVERGED: "Failed, not converged",
    PlanStatus.INFEASIBLE: "Failed, infeasible",
    PlanStatus.INTERRUPTED: "Failed, interrupted",
}


def fixed(value: float, digits: int = 2) -> str:
    """Return a number with a fixed count of decimals.

    Parameters
    ----------
    value : float
        Any number.
    digits : int, default 2
        Decimals.

    Returns
    -------
    str
        `NOTHING` for what is not finite; never minus zero.
    """
    if not isfinite(value):
        return NOTHING
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def rough(value: float) -> str:
    """Return a small number with two significant digits.

    Parameters
    ----------
    value : float
        Any number, such as an error.

    Returns
    -------
    str
        `NOTHING` for what is not finite.
    """
    return f"{value:.2g}" if isfinite(value) else NOTHING


def seconds(value: float) -> str:
    """Return a duration with its unit.

    Parameters
    ----------
    value : float
        Seconds.

    Returns
    -------
    str
        Without zeros that say nothing.
    """
    return f"{value:.6g} s"


def yes_no(value: object) -> str:
    """Return a truth value in a word.

    Parameters
    ----------
    value : object
        Taken as a boolean.

    Returns
    -------
    str
        "yes" or "no".
    """
    return "yes" if value else "no"


def hover_place(hover: Hover) -> str:
    """Return a place and a heading.

    Parameters
    ----------
    hover : Hover
        Start or goal.

    Returns
    -------
    str
        In metres and degrees.
    """
    place = ", ".join(f"{axis:.6g}" for axis in hover.position)
    return f"({place}) m, yaw {degrees(hover.yaw):.4g}°"


def title_of(scenario: Scenario) -> str:
    """Return what a report about a scenario is called.

    Parameters
    ----------
    scenario : Scenario
        Any scenario.

    Returns
    -------
    str
        Its title, or its name when it has none.
    """
    return scenario.title or scenario.name


FIGURE_FOLDER = "figures"

# Characters that are printed as nothing although Python calls them printable: fillers, joiners and
# selectors (Unicode's Default_Ignorable_Code_Point without its format characters).
_BLANK = re.compile(
    "[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180f\u2800\u3164\ufe00-\ufe0f\uffa0"
    "\U000e0000-\U000e0fff]"
)


def visible(text: str) -> str:
    """Spell out what a reader would not see, as Python escapes.

    Parameters
    ----------
    text : str
        Any text.

    Returns
    -------
    str
        Blanks and line breaks are kept; control characters, marks of direction, characters of no
        width and halves of surrogate pairs are spelled out.
    """
    return "".join(
        letter
        if letter in "\t\n\r" or category(letter) == "Zs" or _is_seen(letter)
        else letter.encode("unicode_escape").decode("ascii")
        for letter in text
    )


def _is_seen(letter: str) -> bool:
    return letter.isprintable() and not _BLANK.match(letter)


@dataclass(frozen=True)
class Code:
    """A name from a program: of a flight, a file, a field, a command."""

    text: str


@dataclass(frozen=True)
class Strong:
    """Words that carry the sentence."""

    text: str


Piece = str | Code | Strong


@dataclass(frozen=True)
class Heading:
    """A heading below the title."""

    text: str


@dataclass(frozen=True)
class Paragraph:
    """Running text."""

    pieces: Sequence[Piece]


@dataclass(frozen=True)
class Bullets:
    """A list of short texts."""

    items: Sequence[Sequence[Piece]]


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The answer, set apart from all else."""

    is_good: bool
    pieces: Sequence[Piece]


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table whose first column names the rows.

    ``numeric`` holds the positions of the columns that are aligned to the right.
    """

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[Piece]]
    numeric: frozenset[int] = frozenset()


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A figure, by the name of its files without suffix."""

    name: str
    title: str
    caption: str


Block = Heading | Paragraph | Bullets | Verdict | Table | Picture


@dataclass(frozen=True, kw_only=True)
class Document:
    """A title and what stands below it."""

    title: str
    blocks: Sequence[Block]


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


STYLE_SHEET = """
:root { color-scheme: light; --ink: #1b1b1b; --muted: #555; --line: #d5d5d5; --good: #00664b;
  --bad: #9b2c00; }
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; }
body { margin: 0 auto; max-width: 58rem; padding: 1rem; background: #fff; color: var(--ink);
  font: 1rem/1.55 system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: .4rem 0 1rem; overflow-wrap: anywhere; }
h2 { font-size: 1.2rem; line-height: 1.3; margin: 2.4rem 0 .6rem; padding-top: .6rem;
  border-top: 1px solid var(--line); }
p, li, figcaption { overflow-wrap: break-word; max-width: 46rem; }
a { color: #00558a; }
a:focus-visible, .scroll:focus-visible { outline: 3px solid #e69f00; outline-offset: 2px; }
code { font: .92em ui-monospace, "DejaVu Sans Mono", monospace; overflow-wrap: anywhere; }
.verdict { border-left: .4rem solid var(--bad); background: #fdf3ee; padding: .8rem 1rem;
  font-size: 1.1rem; }
.verdict p { margin: 0; max-width: none; }
.verdict strong { color: var(--bad); }
.verdict.good { border-color: var(--good); background: #eef7f4; }
.verdict.good strong { color: var(--good); }
nav ul { display: flex; flex-wrap: wrap; gap: 0 1rem; list-style: none; margin: 1rem 0;
  padding: 0; }
nav a { display: inline-block; padding: .35rem 0; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .92em; }
caption { text-align: left; font-weight: 600; padding: .3rem 0; }
th, td { border-bottom: 1px solid var(--line); padding: .35rem .9rem .35rem 0; text-align: left;
  vertical-align: top; }
th.number { min-width: 4.6rem; }
thead th { border-bottom: 2px solid var(--muted); vertical-align: bottom; }
tbody th { font-weight: 400; white-space: nowrap; position: sticky; left: 0; background: #fff; }
th.number, td.number { text-align: right; }
td.number { white-space: nowrap; }
figure { margin: 1rem 0; }
figure img { display: block; width: 100%; min-width: 40rem; height: auto; }
figcaption, .note { color: var(--muted); font-size: .9em; }
.view { width: 100%; height: min(70vh, 34rem); min-height: 20rem;
  overflow: hidden; }
.skip { position: absolute; left: -999rem; }
.skip:focus { position: static; }
footer { margin: 2rem 0 1rem; color: var(--muted); font-size: .9rem; }
@media print {
  @page { size: A4; margin: 15mm; }
  body { max-width: none; padding: 0; font-size: 9.5pt; }
  h1 { font-size: 16pt; }
  h2 { font-size: 12pt; margin-top: 1.4rem; break-after: avoid; }
  table { font-size: 8pt; }
  th, td { padding: .15rem .5rem .15rem 0; }
  th.number { min-width: 0; }
  figure, table, .verdict { break-inside: avoid; }
  figure img { min-width: 0; max-height: 225mm; object-fit: contain; object-position: left; }
  .scroll { overflow: visible; }
  .verdict { border: 1.5pt solid; background: none; font-size: 10.5pt; }
  nav, .skip, .screen { display: none; }
  a { color: inherit; text-decoration: none; }
}
"""


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
    body = "\n".join(_html_block(block, document, pictures, views) for block in document.blocks)
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


def _html_block(
    block: Block, document: Document, pictures: Mapping[str, bytes], views: Mapping[str, str]
) -> str:
    match block:
        case Heading(text=text):
            return f'<h2 id="{_anchor(text)}">{_escape(text)}</h2>'
        case Paragraph(pieces=pieces):
            return f"<p>{_html_text(pieces)}</p>"
        case Verdict(is_good=is_good, pieces=pieces):
            kind = "verdict good" if is_good else "verdict"
            return f'<div class="{kind}"><p>{_html_text(pieces)}</p></div>\n{_navigation(document)}'
        case Bullets(items=items):
            return f"<ul>{''.join(f'<li>{_html_text(item)}</li>' for item in items)}</ul>"
        case Table():
            return _html_table(block)
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


def _html_table(table: Table) -> str:
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
        f"<td{_alignment(table, column)}>{_html_piece(cell)}</td>"
        for column, cell in enumerate(others, start=1)
    )
    return f'<th scope="row">{_html_piece(first)}</th>{cells}'


def _alignment(table: Table, column: int) -> str:
    return ' class="number"' if column in table.numeric else ""


def _scrolled(label: str) -> str:
    # What is wider than a phone scrolls by itself, also with the keyboard.
    return f'<div class="scroll" tabindex="0" role="group" aria-label="{_escape(label)}">'


def _html_text(pieces: Sequence[Piece]) -> str:
    return "".join(_html_piece(piece) for piece in pieces)


def _html_piece(piece: Piece) -> str:
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
