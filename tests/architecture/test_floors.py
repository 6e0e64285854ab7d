"""The floors: data goes one way, and each heavy library has one home."""

import ast
from functools import cache
from pathlib import PurePath

from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from tests.architecture import test_sizes

FLOORS = {
    "arrays": -1,
    "presentation": 0,
    "processes": 0,
    "scenario": 0,
    "collocation": 0,
    "model": 1,
    "flight": 2,
    "study": 3,
    "report": 4,
    "exports": 5,
    "identification": 5,
    "paper": 5,
    "simulators": 5,
    "polar": 5,
    "sweep": 5,
    "vehicles": 6,
}
TOP = 7
# The same inside the engine; files of one floor may import each other one way.
ENGINE = {
    "errors": 0,
    "enclosure": 1,
    "mesh": 0,
    "packing": 0,
    "reading": 1,
    "program": 2,
    "formulation": 3,
    "costates": 3,
    "guess": 3,
    "limits": 3,
    "dynamics": 3,
    "closed_loop": 3,
    "open_loop": 3,
    "stepping": 3,
    "solution": 3,
    "refining": 4,
    "strategies": 3,
    "starts": 3,
    "suffixes": 4,
    "verdicts": 4,
    "first_solve": 5,
    "solving": 5,
    "diagnosis": 4,
    "problem": 6,
    "joint": 7,
    "pyomo_solver": 8,
}
# Library -> the parts of the package that may import it.
HOMES = {
    "casadi": {"collocation"},
    "cyipopt": {"collocation"},
    "pyomo": {"collocation", "model"},
    # Simulated flights are integrated in `flight`; the engine takes the coefficients of a method.
    "scipy.integrate": {"collocation", "flight"},
    "matplotlib": {"report", "identification", "paper", "polar", "sweep", "vehicles"},
    "mpl_toolkits": {"report"},
    "jinja2": {"report"},
    "markdown_it": {"report"},
    "rosbags": {"exports"},
    "rotorpy": {"flight"},
    "typer": {"cli"},
    "rich": {"cli"},
}


def part_of(module):
    """Return the part of the package that a module belongs to, cli for the top level."""
    steps = module.split(".")
    return steps[1] if len(steps) > 1 and steps[1] in FLOORS else "cli"


def module_of(name):
    steps = ("pyomo_quad", *PurePath(name).with_suffix("").parts)
    return ".".join(step for step in steps if step != "__init__")


def modules_in(node):
    """Yield what an import statement may import."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        assert node.level == 0, "imports are absolute"
        # `from scipy import integrate` imports a module.
        yield from (f"{node.module}.{alias.name}" for alias in node.names)


def is_for_types(node):
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


def imports_of(tree, *, with_types=True):
    """Yield the modules that a file imports, with or without those for type checkers alone."""
    for node in ast.iter_child_nodes(tree):
        if with_types or not is_for_types(node):
            yield from modules_in(node)
            yield from imports_of(node, with_types=with_types)


@cache
def trees():
    return [(module_of(name), tree) for name, tree in test_sizes.trees().items()]


def is_inside(module, library):
    return module == library or module.startswith(f"{library}.")


@cache
def imports_by_module():
    """Return the package's modules, each with those it imports anywhere in its file."""
    found = dict(trees())
    return {
        module: {near for name in imports_of(tree) if (near := nearest(name, found)) is not None}
        for module, tree in found.items()
    }


def nearest(name, modules):
    """Return the module that a name from an import is or stands in, None outside the package."""
    while name not in modules:
        if "." not in name:
            return None
        name = name.rpartition(".")[0]
    return name


def circles(imports):
    """Return the sets of modules that reach each other by imports."""
    modules = sorted(imports)
    edges = csr_array([[int(b in imports[a]) for b in modules] for a in modules])
    count, labels = connected_components(edges, connection="strong")
    found = ([m for m, at in zip(modules, labels, strict=True) if at == k] for k in range(count))
    return [circle for circle in found if len(circle) > 1]


def engine_floor(module):
    steps = module.split(".")
    return ENGINE.get(steps[2]) if steps[1:2] == ["collocation"] and len(steps) > 2 else None


def test_no_floor_imports_a_higher_one():
    wrong = []
    for module, tree in trees():
        here = part_of(module)
        for imported in imports_of(tree):
            if not imported.startswith("pyomo_quad.") or is_inside(imported, "pyomo_quad.version"):
                continue
            there = part_of(imported)
            if there != here and FLOORS.get(there, TOP) >= FLOORS.get(here, TOP):
                wrong.append(f"{module} imports {imported}")
    assert wrong == []


def test_no_module_imports_itself_through_others():
    assert circles(imports_by_module()) == []


def test_the_check_sees_a_circle():
    through = {"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a", "d"}}
    assert circles(through) == [["a", "b", "c"]]
    assert circles({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


def test_the_engine_has_floors_of_its_own():
    imports = imports_by_module()
    inside = {m for m in imports if m.startswith("pyomo_quad.collocation.")}
    assert {m for m in inside if engine_floor(m) is None} == set()
    wrong = [
        f"{module} imports {imported}"
        for module in sorted(inside)
        for imported in sorted(imports[module])
        if imported not in inside or engine_floor(imported) > engine_floor(module)
    ]
    assert wrong == []


def test_heavy_libraries_stay_at_home():
    wrong = [
        f"{module} imports {imported}"
        for module, tree in trees()
        for imported in imports_of(tree, with_types=False)
        for library, homes in HOMES.items()
        if is_inside(imported, library) and part_of(module) not in homes
    ]
    assert wrong == []


def test_the_check_sees_a_wrong_import():
    tree = ast.parse(
        "from typing import TYPE_CHECKING\n"
        "if TYPE_CHECKING:\n    import typer\n"
        "def f():\n    from scipy import integrate\n"
        "import pyomo_quad.report.style\n"
    )
    assert {"scipy.integrate", "pyomo_quad.report.style", "typer"} <= set(imports_of(tree))
    assert "typer" not in set(imports_of(tree, with_types=False))
    assert (part_of("pyomo_quad.report.style"), part_of("pyomo_quad")) == ("report", "cli")
