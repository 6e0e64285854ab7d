"""Solves of one mission side by side, in forked copies of this process.

Each copy sends its solution back to this process, without the compiled problem, which this process
has already. The transfer therefore takes a few milliseconds only. Each copy also sends back its
best usable plan: a plan that simulation confirms at lower accuracy than requested.
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

    It is the number of available cores. It is 1 where this process must not be forked, for example
    on systems other than Linux.
    """
    return processes.cores(os.cpu_count() or 1, use_blas=True)


def solve_side_by_side(
    mission: MissionProblem, solves: Sequence[Callable[[], Solution]]
) -> tuple[Solution, ...]:
    """Carry out solves of a mission, as many at the same time as there are cores.

    Solves run in this process and in forked copies of it. The solutions do not depend on the number
    of cores. All solves run in this process, one after the other, if there is a single solve or a
    single core. The same holds for a call of this function from inside one of its own solves.

    If the user or the time limit stops the solves, this process no longer waits for the copies. It
    calls the unfinished solves itself. Each of them ends at once and returns a result that has not
    converged.

    Parameters
    ----------
    mission : MissionProblem
        Compiled problem of the mission. Its progress callback, `mission.search`, receives two
        things from each copy. One is the best usable plan: a plan that simulation confirms at lower
        accuracy than requested. The other is a measure of the copy's work: the number of mesh
        points, summed over the iterations of Ipopt.
    solves : sequence of callable
        Functions without arguments, each of which solves the problem of `mission`.

    Returns
    -------
    tuple of Solution
        Results in the order of `solves`, converged or not.
    """
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

    `solution` is the solution. `usable` is the best usable plan that the copy made: a plan that
    simulation confirms at lower accuracy than requested. It is None if the best usable plan is
    still the one that existed before the fork. `work` is the number of mesh points, summed over the
    iterations of Ipopt.
    """

    solution: Solution
    usable: Plan | None = None
    work: int = 0


# Compiled problem of the mission, which copies do not send back; empty when there are no copies.
_SHARED: list[object] = []


def _reduced(sent: object) -> Any:
    """Reduce an object for `pickle`, in a forked copy that sends a solution to this process.

    The list `_SHARED` has the problem of the mission and its compiled form. The copy and the
    original process both have these objects. If `sent` is one of them, only its index in the list
    is sent. Any other object is sent as a whole.

    The result is a reduction as the module `pickle` defines it: a function and its arguments. In
    the original process, `pickle` calls the function with the arguments to obtain the object. For
    an object of the list, the function is `_shared` and the argument is the index.
    """
    for place, shared in enumerate(_SHARED):
        if sent is shared:
            return _shared, (place,)
    return sent.__reduce_ex__(4)


def _shared(place: int) -> object:
    """Return the object with the index `place` in the list `_SHARED`.

    The list has the objects that forked copies of this process do not send back, because the
    original process has them: the problem of the mission and its compiled form. `pickle` calls this
    function in the original process, to replace the index that a copy has sent.
    """
    return _SHARED[place]
