"""Planning strategies, in a table in the order in which they are tried.

A strategy is one way to obtain a plan or to improve it, such as a solve from another initial guess.
It has a name, the stage of the search to which it belongs, the condition under which it applies,
its action, and the largest number of times that it is repeated while its condition holds. The
outcome of each action is a line in the record of the search, `Plan.attempts`. An action without
outcome adds no line and is not repeated.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

from pyomo_quad.flight.candidate import Candidate
from pyomo_quad.flight.search import Stage
from pyomo_quad.model.battery import GIVEN_SHARE

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pyomo_quad.flight.search import Search

Subject = TypeVar("Subject")


class Strategy(NamedTuple, Generic[Subject]):
    """Planning strategy: a row of the table of strategies, with its condition and its action.

    Attributes
    ----------
    name : str
        Name in the record of the search.
    stage : Stage
        Stage of the search that a progress display shows.
    applies : callable
        Takes the subject, that is the object which the strategies improve, such as a candidate
        plan; returns whether the strategy applies.
    act : callable
        Takes the subject and improves it; returns the outcome as text for the record of the search,
        or None.
    repeats : int
        Largest number of times that the strategy is carried out in a row.
    """

    name: str
    stage: Stage
    applies: Callable[[Subject], bool]
    act: Callable[[Subject], str | None]
    repeats: int = 1


def carry_out(table: Sequence[Strategy[Subject]], subject: Subject, search: Search) -> None:
    """Apply the strategies of a table whose conditions are met, and record the outcomes.

    Parameters
    ----------
    table : sequence of Strategy
        Strategies, in the order in which they are tried.
    subject
        Object that the strategies improve, such as a `Candidate`.
    search : Search
        Progress of the search, in which the stage and the outcomes are recorded.
    """
    for strategy in table:
        for _ in range(strategy.repeats):
            if not strategy.applies(subject):
                break
            search.stage = strategy.stage
            outcome = strategy.act(subject)
            if outcome is None:
                break
            search.record.append(f"{strategy.name}: {outcome}")


# Multiples of the mission's duration for the continuation from a slow flight to the mission's own.
_SLOWER = (3.0, 2.0, 1.5, 1.2, 1.1)

_C = Candidate
ROUTES, COARSE, _, REFINING = Stage
#: Strategies for a first solution, of which the first that applies is decisive.
FIRST = (
    Strategy("candidate routes", ROUTES, _C.has_routes, _C.fly_routes),
    Strategy("similar flight", COARSE, _C.starts_at_flight, _C.from_flight),
    Strategy("warm start", COARSE, _C.starts_warm, _C.from_warm_start),
    Strategy("trajectory of a plan", COARSE, _C.starts_at_plan, _C.from_plan),
    Strategy("cruise", COARSE, _C.is_long, _C.from_cruise),
    Strategy("first solve", COARSE, _C.is_unsolved, _C.from_nothing),
)
_PAST = "from a flight exactly through the waypoints"
#: Retries of a failed solution, and in the end the reason why all of them failed.
RETRIES = (
    Strategy(_PAST, COARSE, _C.has_failed_at_waypoints, _C.past_waypoints),
    Strategy("elastic restoration", COARSE, _C.has_failed, _C.restore),
    *(
        Strategy(f"duration x {x:g}", COARSE, _C.may_be_slower, partial(_C.slow_down, by=x))
        for x in _SLOWER
    ),
    Strategy("continuation in duration", COARSE, _C.has_slower, _C.speed_up),
    Strategy("shortest flight", COARSE, _C.has_failed, _C.find_shortest),
    Strategy("guess from the shortest flight", COARSE, _C.has_shorter, _C.from_shortest),
    Strategy("diagnosis", COARSE, _C.has_failed, _C.judge),
)
_FINER_AFTER_FLIGHT = "smaller tolerance after a failed simulation"
#: Verification of a solution by simulation of its controls.
PROOF = (
    Strategy("flight", REFINING, _C.is_solved, _C.fly),
    *(
        strategy
        for again in ("", ", again", ", a third time")
        for strategy in (
            Strategy(f"stricter limits{again}", REFINING, _C.breaks_limits, _C.keep_limits),
            Strategy(f"{_FINER_AFTER_FLIGHT}{again}", REFINING, _C.is_astray, _C.tighten),
        )
    ),
)
_WITHIN_PACK = f"power limited to {100.0 * GIVEN_SHARE:.0f} % of the pack's greatest"


def _hold_pack(candidate: Candidate) -> str:
    """Plan the mission of a candidate again, within the power that the battery can give.

    The result is the outcome for the record of the search. If this plan fails too, no retries with
    other initial guesses follow.
    """
    return candidate.hold_pack(lambda gentler: carry_out((*FIRST, *PROOF), gentler, gentler.search))


#: The strategies of a mission, in order.
MISSION = (
    *FIRST,
    *RETRIES,
    *PROOF,
    Strategy(_WITHIN_PACK, REFINING, _C.lacks_power, _hold_pack),
)
