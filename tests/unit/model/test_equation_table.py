"""Each numbered equation of the paper names the functions that declare it, and they do."""

import inspect
from importlib import import_module

import pytest

from pyomo_quad.model import build_model
from pyomo_quad.model.typeset import EQUATION_TABLE, typeset_equations
from tests.declared_model import scenario


def test_every_numbered_equation_of_the_paper_is_listed():
    assert tuple(EQUATION_TABLE) == tuple(range(1, 13))


@pytest.mark.parametrize("number", EQUATION_TABLE)
def test_the_functions_named_exist(number):
    for name in EQUATION_TABLE[number]:
        module, _, function = name.rpartition(".")
        declared = getattr(import_module(module), function)
        assert inspect.isfunction(declared)
        # A name imported from elsewhere would send the reader to the wrong file.
        assert declared.__module__ == module


@pytest.mark.parametrize("number", EQUATION_TABLE)
def test_the_declarations_of_those_modules_cite_the_equation(number):
    model = build_model(scenario(power={"model": "efficiency"}))
    cited = " ".join(e.description for e in typeset_equations(model))
    sources = "".join(
        inspect.getsource(import_module(name.rpartition(".")[0])) for name in EQUATION_TABLE[number]
    )
    assert f"eq. ({number})" in sources
    assert f"eq. ({number})" in cited
