"""References from code to the theory, and back: each one points at something that exists."""

import ast
import importlib
import io
import re
import tokenize
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "pyomo_quad"
THEORY = ROOT / "docs" / "theory"
MODULES = sorted(PACKAGE.rglob("*.py"))
# Folders below docs/ that the build of the book makes.
BUILT = {"_build", "generated", "jupyter_execute", "repository"}
DOCUMENTS = [
    *(page for page in sorted((ROOT / "docs").rglob("*.md")) if BUILT.isdisjoint(page.parts)),
    ROOT / "CONTRIBUTING.md",
    ROOT / "README.md",
    PACKAGE / "collocation" / "README.md",
]
PAGES = [page for page in sorted(THEORY.glob("*.md")) if page.name != "README.md"]

_SEE = re.compile(r"\b[Ss]ee\s+(?!it\b|them\b)")
# Behind these it is an imperative, not the verb of a sentence.
_BEFORE_AN_ORDER = re.compile(r"(?:^|[.;,:(#]|noqa: [A-Z]+\d+)\s*$")
_PAGE = re.compile(r"docs/[\w/]+\.md(?:,\s+eqs?\.\s+(?P<equations>\(\d+\)(?:[^.;\n]*\(\d+\))?))?")
_NAME = re.compile(r"`([A-Za-z_][\w.]*)`")
_TAG = re.compile(r"\\tag\{(\d+)\}")
_IMPLEMENTED = re.compile(r"[Ii]mplemented\s+by\s+`(pyomo_quad\.[\w.]+)`")
_TOGETHER = re.compile(r"Equations \((\d+)\) to \((\d+)\): implemented by")
_DOTTED = re.compile(r"`(pyomo_quad(?:\.\w+)+)`")
_LINK = re.compile(r"\]\((?!https?:|#)([^)#\s]+)")


def module_name(file):
    steps = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(step for step in steps if step != "__init__")


def remarks(file):
    """Yield line and text of each docstring and of each comment; joined where lines follow."""
    text = file.read_text(encoding="utf-8")
    for node in ast.walk(ast.parse(text)):
        # Strings that stand alone describe the attribute before them.
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            yield node.lineno, node.value.value
    last, held = 0, []
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            if held and token.start[0] != last + 1:
                yield last, " ".join(held)
                held = []
            held.append(token.string)
            last = token.start[0]
    if held:
        yield last, " ".join(held)


def reachable(owner, steps):
    """Say whether attributes lead from an object to another; declared fields count."""
    for step in steps:
        fields = getattr(owner, "__annotations__", {}) if isinstance(owner, type) else {}
        if step in fields and not hasattr(owner, step):
            owner = object
            continue
        if not hasattr(owner, step):
            return False
        owner = getattr(owner, step)
    return True


@cache
def is_importable(name):
    """Say whether a dotted name is a module, or leads to an object in one."""
    steps = name.split(".")
    for count in range(len(steps), 0, -1):
        try:
            module = importlib.import_module(".".join(steps[:count]))
        except ModuleNotFoundError:
            continue
        return reachable(module, steps[count:])
    return False


def is_known(name, file):
    """Say whether a name is one of a module, of a class there, or of a package around it."""
    module = importlib.import_module(module_name(file))
    steps = name.split(".")
    classes = [c for c in vars(module).values() if isinstance(c, type)]
    if any(reachable(owner, steps) for owner in [module, *classes]):
        return True
    parents = module_name(file).split(".")
    return any(is_importable(".".join([*parents[:k], name])) for k in range(len(parents) + 1))


def equations_of(page):
    return [int(number) for number in _TAG.findall(page.read_text(encoding="utf-8"))]


def faults_of(text, file):
    """Yield what is wrong with the references of a remark."""
    for paragraph in re.split(r"\n\s*\n", text):
        flat = " ".join(paragraph.split())
        for see in _SEE.finditer(flat):
            if not _BEFORE_AN_ORDER.search(flat[: see.start()]):
                continue
            what = flat[see.end() :]
            if what.startswith("docs/"):
                continue
            name = _NAME.match(what)
            if name is None:
                yield f"see {what[:30]!r} names neither a page nor an object"
            elif not is_known(name[1], file):
                yield f"`{name[1]}` does not exist"
        for reference in _PAGE.finditer(flat):
            page = ROOT / reference[0].split(",")[0]
            if not page.is_file():
                yield f"{page} does not exist"
                continue
            numbers = re.findall(r"\d+", reference["equations"] or "")
            for number in set(map(int, numbers)) - set(equations_of(page)):
                yield f"{page.name} has no equation ({number})"


@pytest.mark.parametrize("file", MODULES, ids=module_name)
def test_every_see_of_a_module_points_at_something(file):
    found = [f"{line}: {fault}" for line, text in remarks(file) for fault in faults_of(text, file)]
    assert not found


@pytest.mark.parametrize(
    "text",
    [
        "See `no_such_name`.",
        "Least, see above.",
        "Law: see docs/theory/nothing.md.",
        "Law: see docs/theory/bound.md, eq. (99).",
        "Law: see docs/theory/bound.md, eqs. (1) to (99).",
    ],
)
def test_a_reference_to_nothing_is_found(text):
    assert list(faults_of(text, PACKAGE / "study" / "legs.py"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_each_equation_names_a_function_that_exists(page):
    text = page.read_text(encoding="utf-8")
    numbers = equations_of(page)
    assert numbers == list(range(1, len(numbers) + 1))
    assert numbers
    together = {
        number
        for first, last in _TOGETHER.findall(text)
        for number in range(int(first), int(last) + 1)
    }
    after = _TAG.split(text)[2::2]
    named = {}
    for number, rest in zip(numbers, after, strict=True):
        named[number] = _IMPLEMENTED.findall(rest)
        assert named[number] or number in together, f"({number}) names no function"
    unknown = [n for names in named.values() for n in names if not is_importable(n)]
    assert not unknown


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_each_module_that_a_page_names_refers_to_the_page(page):
    names = set(_IMPLEMENTED.findall(page.read_text(encoding="utf-8")))
    silent = set()
    for name in names:
        steps = name.split(".")
        files = [ROOT.joinpath(*steps[:k]).with_suffix(".py") for k in range(len(steps), 1, -1)]
        file = next(file for file in files if file.is_file())
        if f"docs/theory/{page.name}" not in file.read_text(encoding="utf-8"):
            silent.add(module_name(file))
    assert not silent


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_each_page_ends_with_its_sources_and_is_in_the_index(page):
    headings = re.findall(r"^## (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    assert headings[-1] == "Sources"
    assert f"({page.name})" in (THEORY / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda page: f"{page.parent.name}-{page.stem}")
def test_names_and_links_of_a_document_lead_somewhere(document):
    text = document.read_text(encoding="utf-8")
    assert [name for name in _DOTTED.findall(text) if not is_importable(name)] == []
    # Sphinx follows the links to pages that it generates.
    links = [link for link in _LINK.findall(text) if "generated/" not in link]
    assert [link for link in links if not (document.parent / link).exists()] == []


def test_the_source_distribution_holds_the_documents():
    assert "recursive-include docs *.md" in (ROOT / "MANIFEST.in").read_text(encoding="utf-8")
