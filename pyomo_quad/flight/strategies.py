"""Planning strategies: ways to obtain or to improve a plan, in the order in which they are tried.

Each strategy has a condition and an action. An example is "the last solve failed" with "solve again
from the flight of shortest duration". The search for a plan goes through a list of strategies once.
It carries out each action whose condition holds, and records the outcome in `Plan.attempts`.
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
    """One way to improve a subject, for example a `Candidate` for the plan of a mission.

    Attributes
    ----------
    name : str
        Name in `Plan.attempts`.
    stage : Stage
        Stage of the search during the action.
    applies : callable
        Condition: takes the subject, returns whether to act.
    act : callable
        Action: changes the subject. Returns the outcome as text, or None if there is none.
    repeats : int
        Largest number of actions in a row, while the condition holds.
    """

    name: str
    stage: Stage
    applies: Callable[[Subject], bool]
    act: Callable[[Subject], str | None]
    repeats: int = 1


def carry_out(table: Sequence[Strategy[Subject]], subject: Subject, search: Search) -> None:
    """Carry out the strategies whose conditions hold, one after the other, and record the outcomes.

    The actions change `subject` in place. An outcome is recorded in `search` as "name of the
    strategy: outcome". While its condition holds, a strategy acts up to `Strategy.repeats` times in
    a row. If an action returns None, nothing is recorded, and the next strategy follows.
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
    """Plan a mission again with an upper limit on the power of the battery.

    The result is the status of the new solve.
    """
    # A new solve that fails is final: other initial guesses are not tried. The new plan replaces
    # the old plan only if simulation verifies it.
    return candidate.hold_pack(lambda gentler: carry_out((*FIRST, *PROOF), gentler, gentler.search))


#: The strategies of a mission, in order.
MISSION = (
    *FIRST,
    *RETRIES,
    *PROOF,
    Strategy(_WITHIN_PACK, REFINING, _C.lacks_power, _hold_pack),
)
