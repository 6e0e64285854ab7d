"""Conversion of a report from Markdown into a self-contained HTML file."""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from itertools import pairwise
from pathlib import Path
from re import compile as pattern

from markdown_it import MarkdownIt
from markdown_it.renderer import RendererHTML
from markdown_it.token import Token
from markdown_it.utils import EnvType

from pyomo_quad.report.render import environment, written

_PNG_START = b"\x89PNG"


def render_html(
    markdown: str,
    *,
    is_good: bool,
    pictures: Mapping[str, bytes],
    views: Mapping[str, str],
    data: str,
) -> str:
    """Convert a report from Markdown into an HTML page without external resources.

    If `is_good`, the box with the main result is green. `pictures` maps names of figures to SVG or
    PNG data. `views` maps names of figures to the HTML that the page shows above the figure: the
    interactive player of the flights. `data` is the JSON of the flights for the player, or empty.
    """
    parser = MarkdownIt("commonmark", {"html": False}, renderer_cls=_PageRenderer).enable("table")
    tokens = parser.parse(markdown)
    settings = {"is_good": is_good, "pictures": pictures, "views": views}
    body = parser.renderer.render(tokens, parser.options, settings)
    body += _end_of_section(tokens)
    return (
        environment()
        .get_template("report/page.html.j2")
        .render(
            title=written(_label(tokens[1])),
            body=written(body),
            data=written(data),
            program=written(_PROGRAM.read_text(encoding="utf-8")),
        )
    )


_PROGRAM = Path(__file__).with_name("page.js")


def _label(inline: Token) -> str:
    """Return the text of a line of Markdown without formatting, escaped for HTML."""
    return escape("".join(child.content for child in inline.children or ()))


def _role(tokens: Sequence[Token], at: int) -> str:
    """Return the role in the HTML report of the paragraph whose opening token is ``tokens[at]``.

    A paragraph with a figure is a "picture", the one after it a "figcaption". A paragraph before a
    table is a "caption". Any other paragraph is a "p".
    """
    if [child.type for child in tokens[at + 1].children or ()] == ["image"]:
        return "picture"
    if at >= 3 and tokens[at - 3].type == "paragraph_open" and _role(tokens, at - 3) == "picture":
        return "figcaption"
    return "caption" if tokens[at + 3 : at + 4] and tokens[at + 3].type == "table_open" else "p"


def _scrolled(label: str) -> str:
    # A table or figure that is wider than the screen scrolls by itself, also with the keyboard.
    return f'<div class="scroll" tabindex="0" role="group" aria-label="{label}">'


# Places where a long name may break in a narrow column: after dots, underscores and brackets; in a
# code span, such as the name of a flight, after a slash too.
_JOINT = pattern(r"(?<=\w[._\]])(?=\w)(?<!\d.)")
_JOINT_OF_CODE = pattern(r"(?<=\w[._/\]])(?=\w)(?<!\d.)")


class _PageRenderer(RendererHTML):
    """Markdown-to-HTML renderer that puts captions into figures and tables.

    Each method has the name of the markdown-it token type that it renders.
    """

    def paragraph_open(self, tokens: Sequence[Token], idx: int, _: object, env: EnvType) -> str:
        role, inline = _role(tokens, idx), tokens[idx + 1]
        children = inline.children or []
        if role == "picture":
            return f"{env['views'].get(_name(children[0]), '')}<figure>{_scrolled(_label(inline))}"
        if role == "caption":
            return f"{_scrolled(_label(inline))}<table><caption>"
        if role == "figcaption":
            # Delete links to files of the report, which fail when the page is sent by itself.
            end = [child.type for child in children].index("em_close")
            del children[end + 1 :]
        return f"<{role}>"

    def paragraph_close(self, tokens: Sequence[Token], idx: int, *_: object) -> str:
        role = _role(tokens, idx - 2)
        return {"picture": "</div>", "figcaption": "</figcaption></figure>\n"}.get(
            role, f"</{role}>\n"
        )

    def text(self, tokens: Sequence[Token], idx: int, *_: object) -> str:
        return _JOINT.sub("<wbr>", escape(tokens[idx].content))

    def code_inline(self, tokens: Sequence[Token], idx: int, *_: object) -> str:
        return f"<code>{_JOINT_OF_CODE.sub('<wbr>', escape(tokens[idx].content))}</code>"

    def image(self, tokens: Sequence[Token], idx: int, _: object, env: EnvType) -> str:
        picture = env["pictures"][_name(tokens[idx])]
        kind = "png" if picture.startswith(_PNG_START) else "svg+xml"
        data = b64encode(picture).decode("ascii")
        return f'<img alt="{_label(tokens[idx])}" src="data:image/{kind};base64,{data}">'

    def heading_open(self, tokens: Sequence[Token], idx: int, _: object, env: EnvType) -> str:
        if tokens[idx].tag != "h2":
            return f"<{tokens[idx].tag}>"
        # Each section becomes an element that the reader can fold.
        title = tokens[idx + 1].content
        closed = _end_of_section(tokens[:idx])
        is_open = title in _UNFOLDED or _has_view(tokens, idx, env["views"])
        # The only section of a page is not folded.
        is_open = is_open or sum(map(_is_h2, tokens)) == 1
        shown = " open" if is_open else ""
        return f'{closed}<details class="part" id="{_anchor(title)}"{shown}><summary><h2>'

    def heading_close(self, tokens: Sequence[Token], idx: int, *_: object) -> str:
        tag = tokens[idx].tag
        return "</h2></summary>\n" if tag == "h2" else f"</{tag}>\n"

    def blockquote_open(self, _: Sequence[Token], __: int, ___: object, env: EnvType) -> str:
        # A block quote becomes the coloured box with the report's main result.
        return f'<div class="verdict{" good" if env["is_good"] else ""}">'

    def blockquote_close(self, tokens: Sequence[Token], idx: int, *_: object) -> str:
        if any(token.type == "blockquote_close" for token in tokens[idx + 1 :]):
            return "</div>\n"  # the table of contents appears once, below the last box
        links = "".join(
            f'<li><a href="#{_anchor(inline.content)}">{_label(inline)}</a></li>'
            for heading, inline in pairwise(tokens)
            if heading.type == "heading_open" and heading.tag == "h2"
        )
        return (
            '</div>\n<nav aria-label="Contents"><details open><summary>Contents</summary>'
            f'<ul>{links}</ul></details></nav>\n<div class="top">\n'
        )

    def table_open(self, *_: object) -> str:
        return ""  # opened by its caption

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


# Sections that a reader must not miss are not folded.
_UNFOLDED = ("What went wrong", "Warnings")


def _is_h2(token: Token) -> bool:
    return token.type == "heading_open" and token.tag == "h2"


def _end_of_section(before: Sequence[Token]) -> str:
    """Return the HTML tag that closes the section before a new heading; "" if no section is open.

    `before` are the markdown-it tokens before the heading.
    """
    if any(map(_is_h2, before)):
        return "</details>\n"
    has_top = any(token.type == "blockquote_close" for token in before)
    return "</div>\n" if has_top else ""


def _has_view(tokens: Sequence[Token], at: int, views: Mapping[str, str]) -> bool:
    """Return whether a report section has a figure with an interactive view (a flight player).

    `at` is the index of the section's first token. The keys of `views` are names of figures.
    """
    end = next((k for k in range(at + 1, len(tokens)) if _is_h2(tokens[k])), len(tokens))
    children = (child for token in tokens[at:end] for child in token.children or ())
    return any(child.type == "image" and _name(child) in views for child in children)


def _name(image: Token) -> str:
    return Path(str(image.attrs["src"])).stem


def _alignment(cell: Token) -> str:
    return ' class="number"' if cell.attrs.get("style") == "text-align:right" else ""


def _anchor(text: str) -> str:
    return "".join(c if c.isascii() and c.isalnum() else "-" for c in text.lower())
