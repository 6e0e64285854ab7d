"""Importing the package as a library leaves the process as it is."""

import subprocess
import sys

import pytest

# Pint imports Dask where that is installed, which adds finders of its own.
STATE = """
import importlib, sys
import numpy, pint, pyomo.environ, pyomo.core.base.units_container as container
finders, units, modules = list(sys.meta_path), container.units, dict(sys.modules)
registry = units.pint_registry
kind = type(units)
importlib.import_module("{module}")
assert sys.meta_path == finders
assert container.units is units and type(units) is kind and units.pint_registry is registry
assert all(sys.modules.get(name) is module for name, module in modules.items())
"""
FIRST = """
import sys
finders = list(sys.meta_path)
import {module}, scipy, matplotlib
from pyomo.core.base.units_container import units
new = sorted({{type(finder).__module__ for finder in sys.meta_path if finder not in finders}})
print([name for name in new if name.startswith("pyomo")])
print("scipy.stats" in sys.modules, "matplotlib.pyplot" in sys.modules)
print(type(units.pint_registry), units.pint_registry._diskcache)
"""


def run(code):
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("module", ["pyomo_quad", "pyomo_quad.collocation", "pyomo_quad.cli"])
def test_importing_changes_nothing_of_the_process(module):
    ended = run(STATE.format(module=module))
    assert ended.returncode == 0, ended.stderr


@pytest.mark.lengthy
def test_imported_first_the_engine_leaves_pyomo_to_itself():
    alone, ours = (
        run(FIRST.format(module=module)) for module in ("pyomo.environ", "pyomo_quad.collocation")
    )
    assert alone.returncode == 0, alone.stderr
    assert (ours.returncode, ours.stdout) == (0, alone.stdout), ours.stderr
