"""Templates filled in as Markdown, and the same Markdown as one self-contained HTML file."""

import re
from base64 import b64encode
from collections.abc import Mapping, Sequence
from functools import cache
from html import escape
from itertools import pairwise
from math import degrees, isfinite
from pathlib import Path
from unicodedata import category

import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markdown_it import MarkdownIt
from markdown_it.renderer import RendererHTML
from markdown_it.token import Token
from markdown_it.utils import EnvType
from markupsafe import Markup

from pyomo_quad.flight import PlanStatus
from pyomo_quad.scenario import PowerModel, WindCoupling

#: Stands where a table has no number.
NOTHING = "n/a"

POWER_WORDS = {
    PowerModel.MOTOR: "electrical power of the motors, copper loss included",
    PowerModel.EFFICIENCY: "shaft power over the recovered efficiency f_r, eq. (8)",
    PowerModel.SHAFT: "shaft power",
    PowerModel.CONSTANT_EFFICIENCY: "shaft power over a constant efficiency",
    PowerModel.MOTOR_WITH_FRICTION: "electrical power of the motors, with their friction",
    PowerModel.MOMENTUM: "momentum theory, blade drag and climb in moving air",
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
    """Return a number with a fixed count of decimals: never minus zero, `NOTHING` if not finite."""
    if not isfinite(value):
        return NOTHING
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def rough(value: float, digits: int = 2) -> str:
    """Return a number with so many significant digits, `NOTHING` if it is not finite."""
    return f"{value:.{digits}g}" if isfinite(value) else NOTHING


def yes_no(value: object) -> str:
    """Return a truth value in a word."""
    return "yes" if value else "no"


FIGURE_FOLDER = "figures"
_PNG_START = b"\x89PNG"

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


def _entities(text: str) -> str:
    return "".join(f"&#{ord(character)};" for character in text)


def _written(text: str) -> Markup:
    """Mark text as written for the reader's program, to be escaped no more."""
    return Markup(text)  # noqa: S704  every caller has escaped what is not its own


def _code(text: str) -> Markup:
    """Return a name from a program: of a flight, a file, a field, a command."""
    # Inside a code span nothing can be escaped: a text that would end it stands outside one.
    if set(visible(text)) & set("`|\\\n\r") or text != text.strip() or not text:
        return _written(escape_markdown(text))
    return _written(f"`{text}`")


def _finalize(value: object) -> Markup:
    """Escape what a template prints, unless a template or a filter made it."""
    return value if isinstance(value, Markup) else _written(escape_markdown(str(value)))


@cache
def environment() -> Environment:
    """Return Jinja's settings: every value escaped for Markdown, none missing."""
    made = Environment(
        loader=FileSystemLoader(Path(__file__).parents[1]),
        # With it, what a macro or a block returns is known as written by a template.
        autoescape=True,
        finalize=_finalize,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.filters |= {
        "code": _code,
        "degrees": degrees,
        "fixed": fixed,
        "one_line": lambda text: _written(" ".join(text.split())),
        "rough": rough,
        "seconds": lambda value: f"{value:.6g} s",
        "yes_no": yes_no,
    }
    made.tests["known"] = pd.notna
    made.globals |= {
        "COUPLING_WORDS": COUPLING_WORDS,
        "FIGURE_FOLDER": FIGURE_FOLDER,
        "POWER_WORDS": POWER_WORDS,
        "STATUS_WORDS": STATUS_WORDS,
    }
    return made


def render_markdown(template: str, **values: object) -> str:
    """Return a template filled in, as Markdown with one blank line between blocks.

    Parameters
    ----------
    template : str
        Path of a template below the package.
    **values : object
        What the template speaks of; it prints every text so that Markdown does not act on it.

    Returns
    -------
    str
        The file's text.
    """
    text = environment().get_template(template).render(values)
    return re.sub(r"\n{3,}", "\n\n", text).strip() + "\n"


def render_html(
    markdown: str,
    *,
    is_good: bool,
    pictures: Mapping[str, bytes],
    views: Mapping[str, str],
    data: str,
) -> str:
    """Return a report as an HTML page that loads nothing.

    Parameters
    ----------
    markdown : str
        The report, as `render_markdown` returns it.
    is_good : bool
        Whether its verdict is to look so.
    pictures : mapping of str to bytes
        SVG or PNG of each picture of the report, by name.
    views : mapping of str to str
        HTML of what stands above a picture on a screen, by the picture's name.
    data : str
        JSON of what the page's program plays, empty without.

    Returns
    -------
    str
        The file's text.
    """
    parser = MarkdownIt("commonmark", {"html": False}, renderer_cls=_PageRenderer).enable("table")
    tokens = parser.parse(markdown)
    settings = {"is_good": is_good, "pictures": pictures, "views": views}
    body = parser.renderer.render(tokens, parser.options, settings)
    return (
        environment()
        .get_template("report/page.html.j2")
        .render(
            title=_written(_label(tokens[1])),
            body=_written(body),
            data=_written(data),
            program=_written(_PROGRAM.read_text(encoding="utf-8")),
        )
    )


_PROGRAM = Path(__file__).with_name("page.js")


def _label(inline: Token) -> str:
    """Return the words of a line of Markdown, as HTML without tags."""
    return escape("".join(child.content for child in inline.children or ()))


def _role(tokens: Sequence[Token], at: int) -> str:
    """Say what the paragraph that starts here is for: a picture, its caption, or a table's."""
    if [child.type for child in tokens[at + 1].children or ()] == ["image"]:
        return "picture"
    if at >= 3 and tokens[at - 3].type == "paragraph_open" and _role(tokens, at - 3) == "picture":
        return "figcaption"
    return "caption" if tokens[at + 3 : at + 4] and tokens[at + 3].type == "table_open" else "p"


def _scrolled(label: str) -> str:
    # What is wider than a phone scrolls by itself, also with the keyboard.
    return f'<div class="scroll" tabindex="0" role="group" aria-label="{label}">'


class _PageRenderer(RendererHTML):
    """Writes captions into their tables and figures, and sets the verdict apart.

    The methods are markdown-it's rules: one for each kind of token, named after it.
    """

    def paragraph_open(self, tokens: Sequence[Token], idx: int, _: object, env: EnvType) -> str:
        role, inline = _role(tokens, idx), tokens[idx + 1]
        children = inline.children or []
        if role == "picture":
            return f"{env['views'].get(_name(children[0]), '')}<figure>{_scrolled(_label(inline))}"
        if role == "caption":
            return f"{_scrolled(_label(inline))}<table><caption>"
        if role == "figcaption":
            # The link to the file beside the report would lead nowhere once the page is sent.
            end = [child.type for child in children].index("em_close")
            del children[end + 1 :]
        return f"<{role}>"

    def paragraph_close(self, tokens: Sequence[Token], idx: int, *_: object) -> str:
        role = _role(tokens, idx - 2)
        return {"picture": "</div>", "figcaption": "</figcaption></figure>\n"}.get(
            role, f"</{role}>\n"
        )

    def image(self, tokens: Sequence[Token], idx: int, _: object, env: EnvType) -> str:
        picture = env["pictures"][_name(tokens[idx])]
        kind = "png" if picture.startswith(_PNG_START) else "svg+xml"
        data = b64encode(picture).decode("ascii")
        return f'<img alt="{_label(tokens[idx])}" src="data:image/{kind};base64,{data}">'

    def heading_open(self, tokens: Sequence[Token], idx: int, *_: object) -> str:
        tag = tokens[idx].tag
        return f'<{tag} id="{_anchor(tokens[idx + 1].content)}">' if tag == "h2" else f"<{tag}>"

    def blockquote_open(self, _: Sequence[Token], __: int, ___: object, env: EnvType) -> str:
        return f'<div class="verdict{" good" if env["is_good"] else ""}">'

    def blockquote_close(self, tokens: Sequence[Token], *_: object) -> str:
        links = "".join(
            f'<li><a href="#{_anchor(inline.content)}">{_label(inline)}</a></li>'
            for heading, inline in pairwise(tokens)
            if heading.type == "heading_open" and heading.tag == "h2"
        )
        return f'</div>\n<nav aria-label="Contents"><ul>{links}</ul></nav>\n'

    def table_open(self, *_: object) -> str:
        return ""  # by its caption

    def table_close(self, *_: object) -> str:
        return "</table></div>\n"

    def th_open(self, tokens: Sequence[Token], idx: int, *_: object) -> str:
        return f'<th scope="col"{_alignment(tokens[idx])}>'

    def td_open(self, tokens: Sequence[Token], idx: int, *_: object) -> str:
        # The first column names the rows.
        if tokens[idx - 1].type == "tr_open":
            return '<th scope="row">'
        return f"<td{_alignment(tokens[idx])}>"

    def td_close(self, tokens: Sequence[Token], idx: int, *_: object) -> str:
        return "</th>" if tokens[idx - 3].type == "tr_open" else "</td>"


def _name(image: Token) -> str:
    return Path(str(image.attrs["src"])).stem


def _alignment(cell: Token) -> str:
    return ' class="number"' if cell.attrs.get("style") == "text-align:right" else ""


def _anchor(text: str) -> str:
    return "".join(c if c.isascii() and c.isalnum() else "-" for c in text.lower())
