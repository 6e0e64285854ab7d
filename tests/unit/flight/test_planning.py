"""A solve ends within its time limit, whatever it is at, and depends on time in no other way."""

import pytest

from pyomo_quad import load_scenario
from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.flight import PlanStatus, planning
from pyomo_quad.flight.planning import solve_scenario
from tests.command import IMPOSSIBLE, PAPER_CALM

TOO_SHORT = [setting.removeprefix("--set=") for setting in IMPOSSIBLE]


class IterationClock:
    """A clock that ticks once an iteration, so that a limit of so many seconds is exact."""

    def __init__(self):
        self.now = 0.0

    def monotonic(self):
        return self.now

    def perf_counter(self):
        return self.now

    def tick(self, _iteration):
        self.now += 1.0


def solve(monkeypatch, limit):
    clock = IterationClock()
    monkeypatch.setattr(planning, "time", clock)
    scenario = load_scenario(PAPER_CALM, [*TOO_SHORT, f"solver.time_limit={limit}"])
    return solve_scenario(scenario, progress=clock.tick), clock.now


def test_every_part_of_a_failing_solve_keeps_the_limit(monkeypatch):
    """The first solve, the elastic one, the shortest flight and each remedy are all stopped."""
    whole, iterations = solve(monkeypatch, 1e6)
    assert whole.status is PlanStatus.INFEASIBLE
    assert iterations > 60
    for share in (0.02, 0.3, 0.6):
        limit = int(share * iterations)
        plan, used = solve(monkeypatch, limit)
        assert limit <= used <= limit + 1
        if plan.status is not PlanStatus.INFEASIBLE:
            assert plan.status is PlanStatus.NOT_CONVERGED
            assert plan.message.startswith(f"given up after solver.time_limit = {limit} s; allow")


def test_the_command_says_that_time_ran_out(capsys):
    arguments = ["fly", PAPER_CALM, "--reference=plan", "--set=solver.time_limit=1e-3"]
    assert main(arguments) == ExitCode.NOT_SOLVED
    said = capsys.readouterr().err
    assert said.startswith(
        "paper_calm: no plan to follow, not_converged: given up after "
        "solver.time_limit = 0.001 s; allow more time"
    )
    assert len(said.splitlines()) == 1


@pytest.mark.parametrize("value", ["0", "-1.0", "1e300"])
def test_a_limit_is_a_time(value):
    with pytest.raises(ValueError, match=r"solver\.time_limit = .* s; must be"):
        load_scenario(PAPER_CALM, [f"solver.time_limit={value}"])
