"""Pages of the book that are made from the repository, and the adaptations of those in it.

Reports, the lists of fields and the pages beside the code are copied as they are into
`docs/repository/`; reference and gallery are written into `docs/generated/`. Git ignores both.
"""

import os
import re
import shutil
from functools import partial
from pathlib import Path

from book_pages import generated_pages
from docutils import nodes
from latex2mathml.converter import convert

ROOT = Path(__file__).parent.parent
COPIES = "repository"
GENERATED = "generated"
# Pages and what they show or offer; a figure is copied in the format that pages show.
_COPIED = ("*.md", "*.csv", "*.json", "*.svg", "*.toml", "report.html")
_TREES = (
    "reports",
    "scenarios",
    "pyomo_quad/collocation",
    "pyomo_quad/vehicles/measured",
    "tests/benchmarks",
)
_PAGES = ("CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")
_LINK = re.compile(r"(!?\[[^\]]*\])\((?!https?:|mailto:|#)([^)\s#]+)(#[^)\s]*)?\)")
_PNG_LINK = re.compile(r" \(\[PNG\]\([^)]*\)\)")
_TABLED_PAGE = re.compile(r"\]\(([a-z_]+)\.md\)")
_TAG = re.compile(r"\\tag\{([^}]*)\}")


def generate(docs):
    """Copy the pages beside the book and write the generated ones into a folder of sources.

    A page that is as it was keeps its time, so that Sphinx does not run it again.
    """
    copies = docs / COPIES
    shutil.rmtree(copies, ignore_errors=True)
    for tree in _TREES:
        for pattern in _COPIED:
            for file in (ROOT / tree).rglob(pattern):
                _copy(file, copies)
    for page in _PAGES:
        _copy(ROOT / page, copies)
    pages = docs / GENERATED
    for name, text in generated_pages():
        file = pages / name
        if not file.is_file() or file.read_text(encoding="utf-8") != text:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")


def _copy(file, copies):
    target = copies / file.relative_to(ROOT)
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy2(file, target)


def adapt_source(app, docname, source):
    """Point links out of the book to the copies in it, and list the pages of a folder's README."""
    docs = Path(app.srcdir)
    page = Path(docname)
    is_copy = page.parts[0] == COPIES
    home = ROOT.joinpath(*page.parts[1:]) if is_copy else docs / page
    text = source[0]
    if is_copy:
        # A page that no table of contents lists is reached by links.
        text = f"---\norphan: true\n---\n\n{_PNG_LINK.sub('', text)}"
    text = _LINK.sub(partial(_link, docs, docs / page, home), text)
    if page.name == "README" and page.parts[0] in {"theory", "howto", "decisions"}:
        pages = "\n".join(dict.fromkeys(_TABLED_PAGE.findall(text)))
        text += f"\n```{{toctree}}\n:hidden:\n\n{pages}\n```\n"
    source[0] = text


def _link(docs, page, home, found):
    """Return a Markdown link with the target that it has in the book."""
    words, target, anchor = found.groups()
    there = Path(os.path.normpath(home.parent / target))
    if there.is_relative_to(docs) or not there.is_relative_to(ROOT):
        return found.group() if home == page else _to(words, there, page, anchor)
    copied = docs / COPIES / there.relative_to(ROOT)
    if copied.is_file():
        return _to(words, copied, page, anchor)
    if there.is_file():
        return _to(words, there, page, None)  # offered for download
    return words.strip("[]!")


def _to(words, there, page, anchor):
    return f"{words}({Path(os.path.relpath(there, page.parent)).as_posix()}{anchor or ''})"


def visit_math(translator, node):
    """Write an inline formula as MathML, which browsers show without a script."""
    translator.body.append(_mathml(node.astext(), "inline"))
    raise nodes.SkipNode


def visit_math_block(translator, node):
    """Write a displayed formula as MathML, with its number at the right."""
    latex = node.astext()
    number = _TAG.search(latex)
    said = f'<span class="eqno">({number.group(1)})</span>' if number else ""
    shown = _mathml(_TAG.sub("", latex).strip(), "block")
    translator.body.append(f'<div class="math"><div>{shown}</div>{said}</div>\n')
    raise nodes.SkipNode


def _mathml(latex, display):
    return convert(latex, display=display)
