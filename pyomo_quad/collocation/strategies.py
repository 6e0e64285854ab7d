"""Table of the solution strategies that are tried in order, and the loop that tries them.

The strategies of the scope `WHOLE` start a whole solve from a warm start or from the guess. Its
first mesh is solved by the strategies of the scope `FIRST`, each further mesh by those of the scope
`MESH`. The scope `RESTART` starts the refinement again if Pontryagin's principle shows better
controls.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from enum import Enum, auto
from math import inf
from typing import TYPE_CHECKING, Any, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Set as AbstractSet

    from pyomo_quad.collocation.program.ipopt import SolverOptions


class Scope(Enum):
    """Part of a solve in which a strategy is tried.

    The parts are:

    - the whole solve;
    - the solve on the first mesh;
    - the solve on each further mesh of the refinement;
    - a restart of the refinement.
    """

    WHOLE = auto()
    FIRST = auto()
    MESH = auto()
    RESTART = auto()


class Fact(Enum):
    """Condition that must be true before a solution strategy is tried.

    An example is the condition that the caller gave a warm start. The method `Search.holds`
    evaluates the conditions.
    """

    #: A warm start is given.
    WARM_START = auto()
    #: The warm start exceeded its budget of iterations, and the solve from the guess failed.
    COLD_FAILED = auto()
    #: There are more equations than free unknowns.
    OVERDETERMINED = auto()
    #: There are as many equations as free unknowns.
    SQUARE = auto()
    #: The caller gave neither a mesh nor a warm start.
    FREE_MESH = auto()
    #: The caller gave a tolerance, but neither a guess nor a warm start.
    FREE_GUESS = auto()
    #: The search for the least violation after a failure was not interrupted.
    JUDGED = auto()
    #: The least violation is not known to be above zero.
    POSSIBLE = auto()
    #: There is one horizon only.
    ONE_HORIZON = auto()
    #: By Pontryagin's principle, other controls gain more than the tolerance.
    BETTER_CONTROLS = auto()
    #: The next solution is kept near the previous solution: by damping of the controls, or by an
    #: initial barrier parameter that corresponds to the last change of the objective.
    KEPT_NEAR = auto()
    #: Neither damping nor a small barrier parameter keeps the next solution near the previous.
    FREE = auto()


class First(Enum):
    """Kind of initial point from which a solution strategy starts Ipopt.

    Examples are the caller's guess, a simulation, the optimum on a coarse mesh, and the point of
    least constraint violation.
    """

    #: The start that the caller requested: warm start or guess.
    GIVEN = auto()
    #: The caller's guess, or the model's values, without the warm start.
    GUESS = auto()
    #: The last iterate of the warm start.
    REACHED = auto()
    #: A simulation from the initial states.
    SIMULATED = auto()
    #: The point of least constraint violation near the last iterate of a failed solve.
    LEAST_VIOLATION = auto()
    #: The point of least constraint violation; the redundant conditions, which follow from other
    #: equations, are left out of the solve.
    REDUCED = auto()
    #: The optimum on a coarse mesh.
    COARSE = auto()
    #: The optimum of the elastic program, whose equations may be violated at a penalty.
    PRICED = auto()
    #: The controls that minimise the Hamiltonian at each point.
    IMPROVED = auto()


@dataclass(frozen=True)
class Strategy:
    """Strategy for a solve: name, conditions, initial point, settings and budget of iterations.

    Attributes
    ----------
    scope : Scope
        Part of a solve.
    name : str
        Name in the record of attempts.
    when : set of Fact
        Conditions that must all be true.
    first : First
        Kind of initial point.
    finer : int
        Factor on the number of elements of the first mesh.
    barrier : str, optional
        Ipopt's option `mu_strategy`: "monotone" or "adaptive".
    is_scaled : bool
        Whether Ipopt solves the scaled program.
    is_firm : bool
        Whether the damping of the controls is increased.
    iterations : float or None
        Limit of iterations on each mesh. None, in the strategy "warm start" only, for the budget
        that a warm start records: the iterations of an earlier solve from the guess.
    times : int
        How often the strategy may be tried.
    """

    scope: Scope
    name: str
    when: AbstractSet[Fact] = frozenset()
    first: First = First.GIVEN
    finer: int = 1
    barrier: str | None = None
    is_scaled: bool = True
    # Ipopt then also begins with a larger barrier parameter.
    is_firm: bool = False
    # The budget has two numbers: iterations on the first mesh, and on all meshes. Without a record
    # for the same tolerance, there is no limit.
    iterations: float | None = inf
    # Only a restart may be tried more than once. `first_success` does not read this number; the
    # refinement itself counts the restarts.
    times: int = 1

    def settings(self, options: SolverOptions) -> SolverOptions:
        """Return the settings of Ipopt with which the strategy solves.

        If `barrier` is None, they are the caller's `options`, unchanged. Otherwise, `mu_strategy`
        is `barrier`, and the limit of iterations is reduced to `iterations` if it is larger.
        """
        if self.barrier is None:
            return options
        limited = options.at_most(self.iterations or inf)
        return replace(limited, extra=(*options.extra, ("mu_strategy", self.barrier)))


#: Limit of iterations of a strategy that repeats a failed solve with other settings of Ipopt; a
#: strategy that succeeds needs fewer iterations. A caller who allows fewer needs a quick answer, as
#: in flight; no further strategy is then tried.
PATIENCE = 200
#: Limit of iterations of a solve from the last mesh while the strategies with other settings have
#: not been tried: most solves from the last mesh take 5 to 50 iterations, and a solve that has not
#: ended after this number seldom ends at all.
_NEAR_PATIENCE = 150
#: Number of restarts of a refinement from controls that minimise the Hamiltonian: each gains more
#: than the tolerance, and hardly any problem has more than two.
MOST_RESTARTS = 8
RESTART = "restart from controls of least Hamiltonian"
_REDUCED_FINER = "without redundant conditions, finer mesh"

_W, _F, _M, _R = Scope.WHOLE, Scope.FIRST, Scope.MESH, Scope.RESTART
_POSSIBLE, _FREE = {Fact.POSSIBLE}, {Fact.JUDGED, Fact.FREE_MESH, Fact.FREE_GUESS}
# A first mesh may be too coarse for the limits, or too fine for the error of the initial point.
STRATEGIES = (
    Strategy(_W, "warm start", {Fact.WARM_START}, iterations=None),
    Strategy(_W, "cold start", first=First.GUESS),
    Strategy(_W, "warm start continued", {Fact.COLD_FAILED}, First.REACHED),
    Strategy(_F, "without redundant conditions", {Fact.OVERDETERMINED}, First.REDUCED),
    Strategy(_F, _REDUCED_FINER, {Fact.OVERDETERMINED, Fact.FREE_MESH}, First.REDUCED, 4),
    Strategy(_F, "requested start"),
    Strategy(_F, "from a simulation", {Fact.FREE_GUESS}, First.SIMULATED),
    Strategy(_F, "without redundant conditions", {Fact.JUDGED, Fact.SQUARE}, First.REDUCED),
    Strategy(_F, _REDUCED_FINER, {Fact.JUDGED, Fact.SQUARE, Fact.FREE_MESH}, First.REDUCED, 4),
    Strategy(
        _F,
        "from the point of least violation",
        {Fact.POSSIBLE, Fact.ONE_HORIZON},
        First.LEAST_VIOLATION,
    ),
    Strategy(_F, "monotone barrier", _POSSIBLE, barrier="monotone", iterations=PATIENCE),
    Strategy(
        _F, "without scaling", _POSSIBLE, barrier="adaptive", is_scaled=False, iterations=PATIENCE
    ),
    Strategy(
        _F,
        "monotone barrier without scaling",
        _POSSIBLE,
        barrier="monotone",
        is_scaled=False,
        iterations=PATIENCE,
    ),
    Strategy(_F, "mesh four times as fine", _FREE, finer=4),
    Strategy(_F, "mesh twice as fine", _FREE, finer=2),
    Strategy(_F, "from a coarse mesh", _FREE, First.COARSE),
    Strategy(_F, "from penalised equations", _FREE, First.PRICED),
    Strategy(_M, "from the last mesh", {Fact.KEPT_NEAR}, iterations=_NEAR_PATIENCE),
    Strategy(_M, "from the last mesh", {Fact.FREE}),
    Strategy(_M, "larger barrier, stronger damping", {Fact.KEPT_NEAR}, is_firm=True),
    Strategy(_M, "from the guess", {Fact.WARM_START}, First.GUESS),
    Strategy(_R, RESTART, {Fact.BETTER_CONTROLS}, First.IMPROVED, times=MOST_RESTARTS),
)

S = TypeVar("S", bound=Any)


class Search(ABC, Generic[S]):
    """Search for a solution by strategies, which `first_success` tries one after another.

    A strategy is tried only if its conditions (`Strategy.when`) are true. Subclasses evaluate these
    conditions, carry out the strategies, and define which results end the search.
    """

    @abstractmethod
    def holds(self, fact: Fact) -> bool:
        """Return whether `fact`, a condition for trying a solution strategy, is true at present.

        The condition is evaluated immediately before the strategy is tried.
        """

    @abstractmethod
    def attempt(self, strategy: Strategy) -> S | None:
        """Solve with a given solution strategy, and return the result.

        The result of a failed solve has the status of the failure. The result is None if nothing
        was solved, because the problem has no initial point of the kind `strategy.first`.
        """

    def is_final(self, found: S) -> bool:
        """Return whether `found`, the result of the last strategy, ends the search.

        By default, a result ends the search if its status is not a failure.
        """
        return not found.status.has_failed

    def failure(self, last: S) -> S:
        """Return the result to report if all strategies have failed.

        By default, this is `last`, the result of the strategy that was tried last.
        """
        return last


def first_success(scope: Scope, search: Search[S]) -> S:
    """Try the solution strategies of the table `STRATEGIES` in order, until one ends the search.

    Only strategies of the given scope whose conditions are all true are tried. `Search.is_final`
    states whether a result ends the search. If none does, `Search.failure` chooses the result to
    return. If more than one strategy was tried, the attribute `tried` of the result lists their
    names and statuses.
    """
    tried: list[str] = []
    last: Any = None
    for strategy in STRATEGIES:
        if strategy.scope is not scope or not all(map(search.holds, strategy.when)):
            continue
        found = search.attempt(strategy)
        if found is None:
            continue
        last = found
        tried.append(f"{strategy.name}: {found.status.value}")
        if search.is_final(found):
            break
    else:
        last = search.failure(last)
    return last.updated(tried=(*last.tried, *tried)) if len(tried) > 1 else last
