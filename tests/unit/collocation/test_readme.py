"""The engine's README does what it says."""

import re
from pathlib import Path

import pytest

README = Path(__file__).parents[3] / "pyomo_quad" / "collocation" / "README.md"
TEXT = README.read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)


def test_examples_run_and_give_the_values_in_their_comments():
    first, second = (block for block in BLOCKS if "n.t" not in block)
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


def test_phases_meet_where_the_page_says():
    names = {}
    (block,) = (block for block in BLOCKS if "n.turn" in block)
    exec(BLOCKS[0].split("m = ConcreteModel")[0] + block, names)
    quickest = names["quickest"]
    assert list(quickest.timeline.times) == pytest.approx([0, 1.1547, 1.7321], abs=1e-4)


def test_it_is_short():
    assert len(TEXT.splitlines()) <= 200
