"""The order of the fallbacks and what is logged of them, with solves that only pretend."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import pytest

from pyomo_quad.collocation import Mesh, Status, Trajectory
from pyomo_quad.flight import planning
from pyomo_quad.flight.planning import Rescuer

DURATION = 10.0


def path(name):
    return Trajectory(mesh=Mesh.uniform(1, 1), states=name, algebraics=name, statics=())


@dataclass(frozen=True)
class Pretended:
    status: Status
    trajectory: Trajectory = field(default_factory=lambda: path("mission"))
    objective: float = 0.0


FAILED, DONE = Pretended(Status.NOT_CONVERGED), Pretended(Status.CONVERGED)


class Solves:
    """Answers that are given in turn, and what was asked."""

    def __init__(self, *answers, slowly=DONE, shortest=None):
        self.answers, self.slowly, self.shortest = list(answers), slowly, shortest
        self.guesses, self.slow = [], []

    def solve(self, trajectory):
        self.guesses.append(trajectory.states)
        return self.answers.pop(0)

    def solve_slowly(self, duration, trajectory):
        self.slow.append((duration, None if trajectory is None else trajectory.states))
        return self.slowly

    def rescuer(self):
        return Rescuer(
            duration=DURATION,
            solve=self.solve,
            solve_slowly=self.solve_slowly,
            solve_shortest=lambda: self.shortest,
            progress=None,
        )


@pytest.fixture
def diagnosed(monkeypatch):
    def answer(*, feasible_point=None, is_infeasible=False):
        found = SimpleNamespace(
            feasible_point=feasible_point, is_infeasible=is_infeasible, relaxations=(), active=()
        )
        monkeypatch.setattr(planning, "diagnose", lambda *_, **__: found)

    return answer


def shortest(duration):
    return Pretended(Status.CONVERGED, path("shortest"), duration)


def test_a_flight_that_keeps_every_limit_is_the_first_guess(diagnosed):
    diagnosed(feasible_point=path("elastic"))
    solves = Solves(DONE)
    rescued = solves.rescuer()(FAILED)
    assert solves.guesses == ["elastic"]
    assert rescued.solution is DONE
    assert rescued.failure is None
    assert rescued.attempts == ("first solve: not_converged", "elastic restoration: converged")


def test_a_slow_flight_is_sped_up_when_that_guess_fails(diagnosed):
    diagnosed(feasible_point=path("elastic"))
    solves = Solves(FAILED, DONE, slowly=Pretended(Status.CONVERGED, path("slow")))
    rescued = solves.rescuer()(FAILED)
    assert [duration for duration, _ in solves.slow] == pytest.approx([30, 20, 15, 12, 11])
    assert [guess for _, guess in solves.slow] == [None, *["slow"] * 4]
    assert solves.guesses == ["elastic", "slow"]
    assert rescued.attempts[1] == "elastic restoration: not_converged"
    assert rescued.attempts[-1] == "continuation in duration: converged"


def test_the_shortest_flight_is_the_last_guess(diagnosed):
    diagnosed()
    solves = Solves(FAILED, DONE, shortest=shortest(4.0))
    rescued = solves.rescuer()(FAILED)
    assert solves.guesses == ["mission", "shortest"]
    assert rescued.attempts[-2:] == (
        "shortest flight: 4 s",
        "guess from the shortest flight: converged",
    )


def test_a_mission_is_infeasible_when_the_shortest_flight_takes_longer(diagnosed):
    diagnosed(is_infeasible=True)
    rescued = Solves(shortest=shortest(12.5)).rescuer()(FAILED)
    assert rescued.solution.status is Status.INFEASIBLE
    assert next(rescued.failure.causes()).startswith("mission.duration = 10 s is 2.5 s too short")


def test_a_shorter_flight_contradicts_the_elastic_solve(diagnosed):
    diagnosed(is_infeasible=True)
    rescued = Solves(FAILED, shortest=shortest(4.0)).rescuer()(FAILED)
    assert rescued.solution.status is Status.NOT_CONVERGED
    assert rescued.failure is not None


def test_an_interruption_ends_the_rescue(diagnosed):
    diagnosed()
    stopped = Pretended(Status.INTERRUPTED)
    rescued = Solves(slowly=stopped).rescuer()(FAILED)
    assert rescued.solution is stopped
    assert rescued.failure is None
