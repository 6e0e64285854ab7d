"""The engine's README does what it says."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from tests.problems.__main__ import names

README = Path(__file__).parents[3] / "pyomo_quad" / "collocation" / "README.md"
TEXT = README.read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)


def run(name, *others):
    """Run the one block that makes a model of this name; return what it defines."""
    (block,) = (block for block in BLOCKS if f"{name} = ConcreteModel()" in block)
    names = {}
    exec(BLOCKS[0].split("m = ConcreteModel")[0] + block, names)
    return [names[other] for other in others]


def test_examples_run_and_give_the_values_in_their_comments():
    first = BLOCKS[0]
    (second,) = (block for block in BLOCKS if "import Mesh, compile" in block)
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
    (quickest,) = run("n", "quickest")
    assert list(quickest.timeline.times) == pytest.approx([0, 1.1547, 1.7321], abs=1e-4)


@pytest.mark.lengthy
def test_the_ascent_steers_by_the_law_of_a_linear_tangent():
    ascent, r = run("r", "ascent", "r")
    assert ascent.objective == pytest.approx(0.2298, abs=1e-4)
    booster, upper, coast = (r.phase[k] for k in ("booster", "upper", "coast"))
    spans = [p.duration.value for p in (booster, upper, coast)]
    assert spans[:2] == pytest.approx([0.4, 0.2671], abs=1e-4)
    # Without drag the tangent of the best angle is linear in time, through the drop of a stage.
    t = np.linspace(0.01, 0.99, 9)
    angles = [
        ascent.value(p.angle, t * span) for p, span in zip((booster, upper), spans, strict=False)
    ]
    times = np.concatenate([t * spans[0], spans[0] + t * spans[1]])
    tangents = np.tan(np.concatenate(angles))
    line = np.polyfit(times, tangents, 1)
    np.testing.assert_allclose(np.polyval(line, times), tangents, rtol=1e-4)
    # And the coast is a throw, to the top of which it takes its speed.
    assert spans[2] == pytest.approx(coast.up[0].value, rel=1e-6)


def test_experiments_share_the_parameter_of_least_squares():
    fit, f, seen = run("f", "fit", "f", "seen")

    def misses(k):
        starts = {"hot": 2, "cold": 0.5}
        return [starts[n] * np.exp(-k[0] * t) - x for n in seen for t, x in seen[n].items()]

    best = least_squares(misses, [1.0], xtol=1e-14, ftol=1e-14, gtol=1e-14).x[0]
    assert fit.value(f.k) == pytest.approx(best, rel=1e-7)
    assert best == pytest.approx(1.0031, abs=1e-4)


def test_the_rod_cools_as_its_steps_in_space_do():
    cooled, rod = run("rod", "cooled", "rod")
    rate = 2 * 20**2 * (1 - np.cos(np.pi / 20))
    assert cooled.value(rod.u, 0.1, index=0.5) == pytest.approx(np.exp(-0.1 * rate), rel=1e-5)
    assert cooled.value(rod.u, 0.1, index=0.5) == pytest.approx(0.3735, abs=1e-4)


def test_it_is_short():
    prose, table = TEXT.split("```text\n")
    assert len(prose.splitlines()) <= 250
    assert len(table.splitlines()) <= 80


def test_the_table_lists_the_problems_that_the_command_prints():
    rows = TEXT.split("```text\n")[1].splitlines()[1:-1]
    assert [row.split()[0] for row in rows] == names()
    # What is claimed stands at 1e-8, as does what it is off by.
    assert all(float(row.split()[4]) <= 2 * float(row.split()[5]) for row in rows)
