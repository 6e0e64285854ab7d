"""The engine's README does what it says."""

import re
from pathlib import Path

import pytest

README = Path(__file__).parents[3] / "pyomo_quad" / "collocation" / "README.md"
TEXT = README.read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)


def test_examples_run_and_give_the_values_in_their_comments():
    first, second = BLOCKS
    names = {}
    exec(first, names)
    m, solution = names["m"], names["solution"]
    assert solution.objective == pytest.approx(6.0)
    assert list(solution.value(m.u, [0.0, 0.5, 1.0])) == pytest.approx([6, 0, -6], abs=1e-8)
    assert solution.costate(m.v, 0.0) == pytest.approx(-6)
    # The second block changes a parameter that the first model does not have.
    exec(second.replace('parameters={"limit": 2.0}, ', ""), names)
    assert names["again"].objective == pytest.approx(6.0)
    assert names["flow"].state_names == ("x", "v")


def test_it_is_one_page():
    assert len(TEXT.splitlines()) <= 100
