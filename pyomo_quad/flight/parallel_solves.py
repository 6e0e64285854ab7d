"""Solves of one mission side by side, in forked copies of this process.

Each copy sends its solution back to this process, without the compiled problem, which this process
has already. The transfer therefore takes a few milliseconds only. Each copy also sends back its
best usable plan, which is the result if the search is stopped. A plan is usable if a simulation
confirms it within less strict tolerances than those requested.
"""

from __future__ import annotations

import os
from functools import partial
from multiprocessing.reduction import ForkingPickler
from typing import TYPE_CHECKING, Any, NamedTuple

from pyomo_quad import processes

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pyomo_quad.collocation import Solution
    from pyomo_quad.flight.mission_problem import MissionProblem
    from pyomo_quad.flight.plan import Plan


def most_solves() -> int:
    """Return the number of solves of a mission that may run at the same time on this machine.

    It is the number of available cores, or 1 if this process must not be forked. Forks are not
    allowed outside Linux, in a worker process, or without OMP_NUM_THREADS=1.
    """
    return processes.cores(os.cpu_count() or 1, use_blas=True)


def solve_side_by_side(
    mission: MissionProblem, solves: Sequence[Callable[[], Solution]]
) -> tuple[Solution, ...]:
    """Carry out solves of a mission in forked processes, as many at a time as there are cores.

    The results are in the order of `solves`, and independent of the number of cores. If the mission
    has a `search`, this object receives the best usable plan of each solve. It also receives the
    work: the number of mesh points, summed over Ipopt's iterations.
    """
    # A call from inside one of the solves runs its own solves one after the other.
    if len(solves) < 2 or most_solves() < 2 or _SHARED:
        return tuple(solve() for solve in solves)
    search, here = mission.search, os.getpid()
    spent_s = 0.0 if search is None else search.spent_s

    def carry_out(solve: Callable[[], Solution]) -> Solution | _Sent:
        if os.getpid() == here:
            return solve()
        for shared in _SHARED:
            ForkingPickler.register(type(shared), _reduced)
        if search is None:
            return _Sent(solve())
        search.begin_apart(spent_s)
        usable, work = search.usable, search.work
        solution = solve()
        new = None if search.usable is usable else search.usable
        return _Sent(solution, new, search.work - work)

    _SHARED[:] = [mission.problem, mission.problem.compiled]
    # After a stop, this process no longer waits for the copies. It calls the unfinished solves
    # itself, and each of them ends at once.
    is_stopped = None if search is None else search.is_stopped
    tasks = [partial(carry_out, solve) for solve in solves]
    try:
        with processes.side_by_side(tasks, is_stopped=is_stopped) as finish:
            answers = finish()
    finally:
        _SHARED.clear()
    found = []
    for answer in answers:
        sent = answer if isinstance(answer, _Sent) else _Sent(answer)
        found.append(sent.solution)
        if search is not None:
            search.work += sent.work
            if sent.usable is not None:
                search.keep(sent.usable)
    return tuple(found)


class _Sent(NamedTuple):
    """Result of a solve in a forked copy of this process, as the copy sends it back.

    If the solve improved the best usable plan, `usable` is the new plan, otherwise None. `work` is
    the increase of `Search.work`.
    """

    solution: Solution
    usable: Plan | None = None
    work: int = 0


# Compiled problem of the mission, which copies do not send back; empty when there are no copies.
_SHARED: list[object] = []


def _reduced(sent: object) -> Any:
    """Return how `pickle` encodes an object that a forked copy sends to this process.

    The result has the form that Python prescribes for the method `__reduce_ex__`.
    """
    # Both processes have the objects of this list, so that only their index is sent.
    for place, shared in enumerate(_SHARED):
        if sent is shared:
            return _shared, (place,)
    return sent.__reduce_ex__(4)


def _shared(place: int) -> object:
    """Return the object with the index `place` in the list `_SHARED` of compiled problems.

    A forked copy sends this index instead of the compiled problem. When this process reads the
    answer, `pickle` calls this function.
    """
    return _SHARED[place]
