"""What is said of a user's own model builder that cannot be used."""

import pytest

from pyomo_quad.model import load_builder
from pyomo_quad.scenario import ScenarioError

BROKEN = {
    "def built(scenario): ...": r"own\.py has no function build; it must define build\(scenario\)",
    "build = 3": r"own\.py has no function build",
    "import missing_module": r"does not run: ModuleNotFoundError: No module named 'missing_module'",
    "def build(:": r"does not run: SyntaxError: ",
    "def build(scenario): return scenario": r"returned \w+; it must return a ConcreteModel\.",
    "def build(scenario): return 1 / 0": r"build fails: ZeroDivisionError: division by zero; corr",
    "def build(scenario): raise KeyError": r"build fails: KeyError; correct it\.",
}


@pytest.mark.parametrize("code", BROKEN)
def test_broken_builder_is_one_line(code, tmp_path):
    (tmp_path / "own.py").write_text(code)
    with pytest.raises(ScenarioError, match=BROKEN[code]) as caught:
        load_builder("own.py:build", tmp_path)(object())
    assert str(caught.value).startswith("model = 'own.py:build'")
    assert len(str(caught.value).splitlines()) == 1


def test_missing_file(tmp_path):
    with pytest.raises(ScenarioError, match=r"own\.py; name an existing Python file\."):
        load_builder("own.py:build", tmp_path)
