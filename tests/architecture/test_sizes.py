"""Sizes and habits that keep the package readable: no exceptions."""

import ast
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "pyomo_quad"
TREES = {
    str(file.relative_to(PACKAGE)): ast.parse(file.read_text(encoding="utf-8"))
    for file in sorted(PACKAGE.rglob("*.py"))
}
LONGEST_FILE = 300
LONGEST_FUNCTION = 40
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
UNPICKLERS = {"pickle", "dill", "cloudpickle", "shelve", "marshal"}


def nodes(kind):
    """Yield every node of a kind in the package, with its file."""
    for name, tree in TREES.items():
        for node in ast.walk(tree):
            if isinstance(node, kind):
                yield name, node


def body_length(function):
    """Return the lines of a function's body without its docstring."""
    body = function.body
    if ast.get_docstring(function) is not None:
        body = body[1:]
    return body[-1].end_lineno - body[0].lineno + 1 if body else 0


def test_files_are_short():
    lengths = {name: (PACKAGE / name).read_text(encoding="utf-8").count("\n") for name in TREES}
    assert {name: length for name, length in lengths.items() if length > LONGEST_FILE} == {}


def test_functions_are_short():
    lengths = {f"{name}:{f.name}": body_length(f) for name, f in nodes(FUNCTIONS)}
    assert {name: length for name, length in lengths.items() if length > LONGEST_FUNCTION} == {}


def test_modules_and_public_names_say_what_they_do():
    silent = [name for name, tree in TREES.items() if not ast.get_docstring(tree)]
    for name, tree in TREES.items():
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
