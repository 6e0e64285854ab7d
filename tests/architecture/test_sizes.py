"""Sizes and habits that keep the package readable: no exceptions."""

import ast
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "pyomo_quad"
# Lines of code: what is left without blank lines, comments and docstrings.
LONGEST_FILE = 500
LONGEST_FUNCTION = 50
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
UNPICKLERS = {"pickle", "dill", "cloudpickle", "shelve", "marshal"}


@cache
def trees():
    return {
        str(file.relative_to(PACKAGE)): ast.parse(file.read_text(encoding="utf-8"))
        for file in sorted(PACKAGE.rglob("*.py"))
    }


@cache
def walked():
    """Return all nodes of each file of the package: walking them takes as long as parsing."""
    return {name: list(ast.walk(tree)) for name, tree in trees().items()}


def nodes(kind):
    """Yield every node of a kind in the package, with its file."""
    return ((n, node) for n, held in walked().items() for node in held if isinstance(node, kind))


def code_lines(text, nodes):
    """Return the numbers of the lines of a source that hold code."""
    lines = {
        number
        for number, line in enumerate(text.split("\n"), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    }
    for node in nodes:
        if isinstance(node, (ast.Constant, ast.JoinedStr)) and node.lineno < node.end_lineno:
            lines.update(range(node.lineno, node.end_lineno + 1))
    for node in nodes:
        if isinstance(node, (ast.Module, ast.ClassDef, *FUNCTIONS)) and ast.get_docstring(node):
            lines.difference_update(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    return lines


@cache
def code():
    """Return the lines of each file of the package that hold code."""
    return {
        name: code_lines((PACKAGE / name).read_text(encoding="utf-8"), held)
        for name, held in walked().items()
    }


def body_length(name, function):
    """Return the lines of code of a function's body."""
    return len(code()[name] & set(range(function.body[0].lineno, function.end_lineno + 1)))


def test_code_is_counted_without_docstrings_comments_and_blank_lines():
    text = '"""Module."""\n\n# why\ndef f():\n    """One.\n\n    Two."""\n    return """a\nb"""\n'
    assert code_lines(text, list(ast.walk(ast.parse(text)))) == {4, 8, 9}


def test_files_are_short():
    lengths = {name: len(lines) for name, lines in code().items()}
    assert {name: length for name, length in lengths.items() if length > LONGEST_FILE} == {}


def test_functions_are_short():
    lengths = {f"{name}:{f.name}": body_length(name, f) for name, f in nodes(FUNCTIONS)}
    assert {name: length for name, length in lengths.items() if length > LONGEST_FUNCTION} == {}


def test_modules_and_public_names_say_what_they_do():
    silent = [name for name, tree in trees().items() if not ast.get_docstring(tree)]
    for name, tree in trees().items():
        for node in tree.body:
            is_public = isinstance(node, (*FUNCTIONS, ast.ClassDef)) and node.name[0] != "_"
            if is_public and not ast.get_docstring(node):
                silent.append(f"{name}:{node.name}")
    assert silent == []


def test_nothing_asserts():
    assert [f"{name}:{node.lineno}" for name, node in nodes(ast.Assert)] == []


def test_only_the_command_prints_and_nothing_runs_text():
    calls = [(n, c) for n, c in nodes(ast.Call) if isinstance(c.func, ast.Name)]
    assert [n for n, c in calls if c.func.id == "print" and not n.startswith("cli")] == []
    assert [n for n, c in calls if c.func.id in {"eval", "exec"}] == []


def test_nothing_is_unpickled():
    imported = [(n, alias.name) for n, node in nodes(ast.Import) for alias in node.names]
    imported += [(n, node.module) for n, node in nodes(ast.ImportFrom)]
    assert [name for name, module in imported if module.split(".")[0] in UNPICKLERS] == []
