"""Solves along candidate routes: cost estimates, coarse solves, and refinement of the best.

A journey is a sequence of routes, one for each leg from waypoint to waypoint. The best one is found
in these steps (docs/theory/routes.md):

- Journeys of high estimated cost are left out.
- The others are solved on a coarse mesh.
- The best are solved again on a finer mesh.
- The best of these are refined to the tolerance.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from math import inf
from typing import Any

import numpy as np

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import Mesh, Solution, SolveError, SolverOptions, Status
from pyomo_quad.flight.corridors import corridor_journeys, estimate_of, has_corridors
from pyomo_quad.flight.flight import POSITION_STATES, VELOCITY_STATES
from pyomo_quad.flight.geometric_plan import smooth_flight
from pyomo_quad.flight.long_flight import best_speed
from pyomo_quad.flight.mission_problem import MissionProblem
from pyomo_quad.flight.parallel_solves import most_solves, solve_side_by_side
from pyomo_quad.flight.references import quintic_progress
from pyomo_quad.flight.routes import Journey, NoRouteError, TriedRoute, length_of
from pyomo_quad.flight.verdict import energy_of
from pyomo_quad.flight.zones import Side, sides_passed
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.accuracy import Accuracy

# Least number of elements on which the flights along all routes are compared.
_ROUTE_ELEMENTS = 20
# Samples of a guess along each route, which resolve its corners.
_GUESS_SAMPLES = 201


# Relative error of an energy on the first mesh and on the next mesh. Flights whose energies exceed
# the least energy by no more than this error are solved again: on the next mesh, or to the
# tolerance.
_NEAR_ON_FIRST, _NEAR_ON_NEXT = 1e-3, 1e-4
# Largest numbers of flights that are solved again: on the next mesh, and to the tolerance.
_MOST_ON_NEXT, _MOST_REFINED = 4, 3
#: Ipopt's tolerance for flights on one mesh that are only compared: the complementarity gap that
#: the barrier leaves is then a tenth of `_NEAR_ON_FIRST`.
ON_FIRST = 1e-7
# Durations of the further guesses through a wind field, relative to the best solution so far: of
# the first, which shows whether there are many optima, and of those that search for a better one;
# the largest number of solves from them; the largest number of iterations of each; and the least
# relative saving for which a solution replaces the best one.
_PROBE, _FASTER, _MOST_FASTER, _PATIENCE, _SAVED = 0.85, (0.7, 0.85, 0.6), 12, 60, 1e-4
# Sides on which a flight touches zones, as pairs of name and side, for each leg.
_SidesTouched = tuple[frozenset[tuple[str, Side]], ...]
# Number of meshes of a solve to the next mesh, including the first.
_TO_THE_NEXT = 2
# Factor on `_NEAR_ON_FIRST` where accuracy `proof` is not requested: energies on one mesh have
# similar errors, so that their differences are more accurate (measured).
_ALIKE = 0.5


class RouteFlights:
    """Solver of a mission along candidate routes round keep-out zones or through a wind field.

    Candidates are the shortest journeys. Unless the accuracy is `proof`, those of high estimated
    cost are left out. In a wind field, candidates are up to four journeys of least energy in steady
    flight, and the shortest one. If a method is given the number of candidates `most`, they
    are the shortest journeys in a wind field, too.

    Parameters
    ----------
    mission : MissionProblem
        Compiled problem of the mission.
    known : Solution, optional
        Known solution along the shortest journey on the coarse mesh.

    Attributes
    ----------
    has_several_optima : bool
        Whether the mission has a free duration, a wind field and no waypoints. It may then have
        several local optima, and is solved from several initial guesses.
    """

    _near_on_first = _NEAR_ON_FIRST
    _tolerance = 0.0
    # Whether routes that a solved route dominates are left out.
    _is_pruned = False
    # Whether the easier mission past the waypoints is solved first.
    _is_plain = False
    has_several_optima = False

    def __init__(self, mission: MissionProblem, known: Solution | None = None) -> None:
        self._mission, self._scenario, self._known = mission, mission.told, known
        solver = self._scenario.solver
        self._mesh = Mesh.uniform(max(solver.elements, _ROUTE_ELEMENTS), solver.degree)
        self._tolerance = solver.tolerance
        self._has_corridors = has_corridors(self._scenario)
        flight = self._scenario.mission
        self.has_several_optima = self._has_corridors and flight.is_free and not flight.waypoints
        if solver.accuracy is not Accuracy.PROOF:
            self._near_on_first *= _ALIKE
            # Through a wind field, several optima pass the zones on the same sides.
            self._is_pruned = not self._has_corridors

    def best(self, most: int | None = None) -> tuple[Solution, tuple[TriedRoute, ...]]:
        """Solve the mission along candidate journeys; return the best solution and all results.

        At most `most` candidates are solved, by default `routes.MOST_ROUTES`; see `RouteFlights`.
        If zones block every journey, the solution has the status `INFEASIBLE`, and there are no
        results.
        """
        try:
            journeys = self._journeys(most)
        except NoRouteError as error:
            closed = self._mission.unsolved()
            return replace(closed, status=Status.INFEASIBLE, message=str(error)), ()
        return self.compared(journeys)

    def compared(self, journeys: Sequence[Journey]) -> tuple[Solution, tuple[TriedRoute, ...]]:
        """Solve the mission along given journeys; return the best solution and all results.

        The best solution is refined; its status is failed if no solve converges. There is one
        result for each different flight: journeys whose solves lead to one flight share a result. A
        journey is left out if it passes all zones that an earlier solution touches on the same
        sides (docs/theory/routes.md, eq. (1)). None is left out at the
        accuracy `proof` or in a wind field.
        """
        flown: list[tuple[Journey, Solution]] = []
        for journey, solution in self._each_flown(journeys):
            # Solves that start over and beside a sphere, for example, may end in the same flight.
            if not any(_is_same(solution, other) for _, other in flown):
                flown.append((journey, solution))
        known = dict(enumerate(solution for _, solution in flown))
        if self.has_several_optima:
            self._improve(known, journeys[0])
        near = self._near(known)
        refined = self._refined(known, near)
        best = min(refined, key=lambda k: _cost(refined[k])) if refined else _cheapest(known)[0]
        solution = refined.get(best, known[best])
        known |= {k: s for k, s in refined.items() if s.status.is_solved}
        return solution, tuple(
            TriedRoute(
                name="; ".join(route.name for route in self.as_flown(journey, known[k])),
                length_m=length_of(journey),
                energy_J=self.energy_of(known[k]) if known[k].status.is_solved else None,
                is_refined=k in refined and refined[k].status.is_solved,
                is_kept=k == best and solution.status.is_solved,
                estimate_J=estimate_of(journey),
            )
            for k, (journey, _) in enumerate(flown)
            if k in known
        )

    def _each_flown(self, journeys: Sequence[Journey]) -> Iterator[tuple[Journey, Solution]]:
        """Solve along journeys, one after the other or on several cores.

        Yields each journey with its solution. A journey is left out if a known solution is as good,
        see `_is_dominated`. None is left out at the accuracy `proof` or in a wind field.
        """
        dominant: list[_SidesTouched] = []

        def is_needed(journey: Journey) -> bool:
            return not any(_is_dominated(journey, sides) for sides in dominant)

        waiting, count = [*journeys], 1
        fly: Callable[[Journey], Solution]
        fly = partial(self._fly_first, is_alone=len(journeys) == 1)
        while waiting := [journey for journey in waiting if is_needed(journey)]:
            together, waiting = waiting[:count], waiting[count:]
            solves = [partial(fly, journey) for journey in together]
            solved = solve_side_by_side(self._mission, solves)
            for journey, solution in zip(together, solved, strict=True):
                # This condition makes the results independent of the number of cores.
                if is_needed(journey):
                    if self._is_pruned and solution.status.is_solved:
                        dominant.append(sides_touched(self._scenario, journey, solution))
                    yield journey, solution
            count, fly = most_solves(), self._fly_beside

    def _near(self, known: dict[int, Solution]) -> list[int]:
        """Solve along the cheapest journeys again, on a finer mesh; return the numbers of the best.

        `known` (number of a journey -> solution) is changed in place: finer solutions replace
        coarse ones, and duplicates are deleted.
        """
        near = _nearest(known, self._near_on_first, self._most(_MOST_ON_NEXT, self._near_on_first))
        if len(near) < 2:
            return near
        solves = [partial(self.refine, known[k], _TO_THE_NEXT) for k in near]
        improved = dict(zip(near, solve_side_by_side(self._mission, solves), strict=True))
        known |= {k: s for k, s in improved.items() if s.status.is_solved}
        for k in sorted(near, reverse=True):
            if any(_is_same(known[k], known[j]) for j in near if j < k):
                del known[k]
        compared = {k: s for k, s in known.items() if k in near}
        return _nearest(compared, _NEAR_ON_NEXT, self._most(_MOST_REFINED, _NEAR_ON_NEXT))

    def _most(self, most: int, error: float) -> int:
        """Return the largest number of journeys to solve again on a finer mesh: 1 or `most`.

        It is 1 if `error`, the relative error of energies on the present mesh, is within the
        mission's tolerance.
        """
        # With an error above the energy tolerance, journeys of similar energy cannot be ranked yet.
        # Otherwise the cheapest journey is already known to within the tolerance.
        return 1 if error <= self._tolerance else most

    def _refined(self, known: Mapping[int, Solution], near: list[int]) -> dict[int, Solution]:
        """Return the best solutions refined to the tolerance, by number of the journey.

        `near` has the numbers of the best journeys in `known`.
        """
        solves = [partial(self.refine, known[k], None) for k in near]
        refined = dict(zip(near, solve_side_by_side(self._mission, solves), strict=True))
        # If all these refinements fail, the other solutions are refined in order of cost.
        others = [k for k in _cheapest(known) if k not in near and known[k].status.is_solved]
        for k in others:
            statuses = [s.status for s in refined.values()]
            if Status.INTERRUPTED in statuses or any(status.is_solved for status in statuses):
                break
            refined[k] = self.refine(known[k], None)
        return refined

    def energy_of(self, solution: Solution) -> float:
        """Return the energy of a solution [J], which may differ from the objective of the solve.

        The objective may contain two other terms: the price of time [W] times the duration, and the
        energy lost inside the battery.
        """
        return energy_of(self._scenario, solution)

    def as_flown(self, journey: Journey, solution: Solution) -> Journey:
        """Return a journey with the sides on which its solution really passes the zones.

        A journey is a route for each leg of the mission. If the solve failed, the journey is
        returned unchanged.
        """
        is_flown = solution.status.is_solved
        return journey_as_flown(self._scenario, journey, solution) if is_flown else journey

    def _journeys(self, most: int | None) -> tuple[Journey, ...]:
        """Return the candidate journeys along which the mission is solved, at most `most` of them.

        In a wind field, if `most` is None, they are in order of energy, and the shortest journey is
        last. Otherwise, they are in order of length.
        """
        told = self._scenario
        journeys = self._mission.journeys[:most]
        if self._has_corridors and most is None:
            steady = self._mission.problems.steady_flight(told)
            return corridor_journeys(told, steady, journeys[0])
        # At the accuracy `proof`, journeys of higher estimated cost are solved, too.
        if told.solver.accuracy is Accuracy.PROOF or len(journeys) == 1:
            return journeys
        return promising(journeys, self._cost_per_metre(journeys[0]))

    def _cost_per_metre(self, shortest: Journey) -> Callable[[FloatArray], float]:
        """Return a function: course (unit vector) -> cost per metre of steady flight [J/m].

        The cost is infinite if steady flight is impossible. The ground speed is the length of
        `shortest` over the duration. If that is free, it is the speed of least cost.
        """
        told, steady = self._scenario, self._mission.steady
        mission = told.mission
        # The ground speed is the same for all directions. It is the speed of least cost if the
        # duration is free, and otherwise follows from the duration.
        speed = length_of(shortest) / told.nominal_duration
        if mission.is_free:
            way = shortest[0].places[-1] - shortest[0].places[0]
            length = float(np.linalg.norm(way))
            course = way / length if length > 0.0 else np.array([1.0, 0.0, 0.0])
            speed = best_speed(steady, course, mission.price_of_time)
        speed = min(speed, told.limits.speed_max or inf)

        def cost(course: FloatArray) -> float:
            try:
                # The price of time [W] is the weight of a free duration in the objective.
                return (steady.trim(speed * course).power_W + mission.price_of_time) / speed
            except SolveError:
                return inf

        return cost

    def _fly_first(self, journey: Journey, *, is_alone: bool) -> Solution:
        """Return the solution along the first journey.

        If the constructor was given a solution, this solution is returned without a solve. If there
        is no other journey (`is_alone`), a mission with several local optima is solved from two
        initial guesses.
        """
        if self._known is not None:
            return self._known
        smooth = self.smooth_guess(journey) if self.has_several_optima else None
        if smooth is None:
            return self.fly(journey)
        solves = [partial(self.fly, journey, smooth)]
        if is_alone:
            # A mission with several optima thus has at least two different guesses.
            solves.append(partial(self.fly, journey))
        solved = solve_side_by_side(self._mission, solves)
        return min(solved, key=lambda s: (s.status.has_failed, _cost(s)))

    def smooth_guess(self, journey: Journey) -> dict[str, Any] | None:
        """Return a flight along a journey with smooth corners, as an initial guess of a solve.

        The result is that of `flight.geometric_plan.smooth_flight`: samples of all states, or None
        if there is no such flight.
        """
        return smooth_flight(self._mission, journey)

    def fly(
        self, journey: Journey, guess: Any = None, options: SolverOptions | None = None
    ) -> Solution:
        """Solve the mission from a guess along a journey, on the coarse mesh for comparisons.

        The default guess follows the lines of the journey in the nominal duration. If a solve fails
        and there is an easier mission `MissionProblem.past_waypoints`, the solve is repeated. This
        and all later calls first solve the easier mission, and use its solution as the guess.
        """
        told, mission = self._scenario, self._mission
        if guess is None:
            guess = guess_along(
                journey,
                told.nominal_times,
                is_open=told.mission.is_free,
                # A waypoint is usually passed without a stop.
                is_even=len(journey) > 1 or self._has_corridors,
            )
        if self._is_plain and mission.past_waypoints is not None:
            begun = mission.past_waypoints.solve_roughly(mesh=self._mesh, guess=guess)
            guess = begun.trajectory if begun.status.is_solved else guess
        if options is None:
            options = self._rough_options()
            # With a small barrier parameter, iterates stay near the guess, one of several optima.
            options = options.from_a_flight() if self.has_several_optima else options
        rough = mission.solve_roughly(mesh=self._mesh, guess=guess, options=options)
        is_new = rough.status.has_failed and not self._is_plain
        if not is_new or mission.past_waypoints is None:
            return rough
        # The solves along all further journeys are expected to fail, too, and begin with the easier
        # mission.
        self._is_plain = True
        return self.fly(journey)

    def _improve(self, known: dict[int, Solution], journey: Journey) -> None:
        """Replace the best solution by a better local optimum, if solves from new guesses find one.

        `known` (number of a journey -> solution) is changed in place. The new guesses are the path
        of the best solution, flown faster, and the lines of `journey`. See docs/theory/routes.md.
        """
        first, options = _cheapest(known)[0], self._rough_options()
        if known[first].status.has_failed:
            return
        # If a faster flight along the best solution saves energy, there are several optima.
        found = self.fly_again(known[first], _PROBE, options.from_a_flight())
        if not _saves(found, known[first]):
            return
        # The lines of `journey` are another guess. With Ipopt's own barrier parameter, iterates
        # move farther from it.
        others = self.fly(journey, options=options)
        known[first] = min(self._faster(found), self._faster(others), key=_cost)

    def _faster(self, flown: Solution) -> Solution:
        """Solve again from faster flights along the best solution, until the cost falls no more.

        The best solution is at first `flown`, then each cheaper one that is found. An initial guess
        follows its path in less time. See docs/theory/routes.md.
        """
        best, shares = flown, [*_FASTER]
        for _ in range(_MOST_FASTER):
            if best.status.has_failed or not shares:
                break
            found = self.fly_again(best, shares.pop(0))
            if _saves(found, best):
                best, shares = found, [*_FASTER]
        return best

    def fly_again(
        self, flown: Solution, share: float, options: SolverOptions | None = None
    ) -> Solution:
        """Solve the mission again from the path of a solution, flown in another time.

        The initial guess lasts `share` times as long as `flown`; the end time of the mission is
        free. The solve has the given `options`, by default those for coarse solves. With any
        options, it takes at most 60 iterations on each mesh.
        """
        guess, chosen = guess_from(flown, share), options or self._rough_options()
        return self._mission.solve_roughly(
            mesh=self._mesh, guess=guess, options=chosen.at_most(_PATIENCE)
        )

    def _rough_options(self) -> SolverOptions:
        """Return Ipopt's options for the coarse solves with which journeys are compared."""
        options = self._mission.arguments["options"]
        # Without mesh refinement, the coarse solves are the last ones.
        if self._scenario.solver.max_refinements > 0:
            options = replace(options, tolerance=ON_FIRST)
        return options

    def _fly_beside(self, journey: Journey) -> Solution:
        """Solve along one of several journeys, without effect on the solves along the others.

        If the solve fails, the result has a failed status. Later calls of `fly` do not begin with
        an easier mission, unlike those after a failure of `fly`.
        """
        # After a failed solve, `fly` sets this flag, with which it solves an easier mission first
        # for every later journey.
        is_plain = self._is_plain
        solution = self.fly(journey)
        self._is_plain = is_plain
        return solution

    def refine(self, flown: Solution, meshes: int | None) -> Solution:
        """Refine the mesh of a solution and solve again, on at most `meshes` meshes.

        The present mesh is counted. If `meshes` is None, the mesh is refined to the mission's
        tolerance. If `solver.max_refinements` is 0, a solution with regeneration is returned
        unchanged. Without regeneration, coarse solves have easier parameter values, so that the
        mission is always solved again.
        """
        mission = self._mission
        if self._scenario.solver.max_refinements == 0 and not mission.easier:
            return flown
        if meshes is None and mission.easier:
            return mission.solve_from(flown.trajectory, flown.mesh)
        few = {} if meshes is None else {"max_meshes": meshes}
        if flown.status.is_solved and not mission.easier:
            return mission.go_on(flown, **few)
        # Without regeneration, a solve on few meshes uses the easiest parameter values.
        return mission.solve(
            next(iter(mission.easier), None) if few else None,
            mesh=flown.mesh,
            warm_start=flown,
            refinement=replace(mission.arguments["refinement"], **few),
        )


# Relative excess over the least estimated cost above which a journey is not solved. The estimate by
# straight legs ignores corners and changes of speed; as a rule it underestimates the cost of a
# detour.
_DEARER = 0.01


def promising(
    journeys: Sequence[Journey], cost_per_metre: Callable[[FloatArray], float]
) -> tuple[Journey, ...]:
    """Return the journeys whose estimated cost is at most 1 % above the least estimated cost.

    `cost_per_metre` takes a unit vector, shape (3,). It returns the cost of steady flight in this
    direction [J/m], infinite if there is none.
    """
    known: dict[tuple[float, ...], float] = {}

    def cost(journey: Journey) -> float:
        total = 0.0
        for step in (step for route in journey for step in np.diff(route.places, axis=0)):
            length = float(np.linalg.norm(step))
            if length > 0.0:
                course = step / length
                key = tuple(np.round(course, _DIGITS).tolist())
                if key not in known:
                    known[key] = cost_per_metre(course)
                total += length * known[key]
        return total

    costs = [cost(journey) for journey in journeys]
    most = (1.0 + _DEARER) * min(costs, default=inf)
    return tuple(journey for journey, c in zip(journeys, costs, strict=True) if c <= most)


# Decimals of the components of a unit vector beyond which two directions count as equal.
_DIGITS = 6


def guess_along(
    journey: Journey,
    times: Sequence[float],
    *,
    is_open: bool = False,
    is_even: bool = False,
) -> dict[str, Any]:
    """Return positions and velocities along a journey, as an initial guess of a solve.

    The result has samples of "time" [s] and of states. `times` [s] has arrival and departure at
    each waypoint, and the end. If `is_open`, the duration is free, and "time" has fractions of it.
    Without waypoints, the result of an open duration also has "duration" [s]. With waypoints, the
    model itself has initial guesses of the duration and of the times at the waypoints. If
    `is_even`, legs are flown at constant speed, otherwise from rest to rest.
    """
    begun = (0.0, *times[1::2])
    instants, places = [], []
    for route, first, last in zip(journey, begun, (*times[0:-1:2], times[-1]), strict=True):
        elapsed = np.linspace(0.0, 1.0, _GUESS_SAMPLES)
        instants.append(first + (last - first) * elapsed)
        progress = elapsed if is_even else quintic_progress(elapsed)
        places.append(route.places_at(progress))
    when, kept = np.unique(np.concatenate(instants), return_index=True)
    where = np.vstack(places)[kept]
    rates = np.gradient(where, when, axis=0)
    columns = dict(zip(POSITION_STATES, where.T, strict=True))
    told = when / times[-1] if is_open else when
    end = {"duration": times[-1]} if is_open and len(journey) == 1 else {}
    return {"time": told} | columns | dict(zip(VELOCITY_STATES, rates.T, strict=True)) | end


def guess_from(flown: Solution, share: float) -> dict[str, Any]:
    """Return the path of a solution, flown in another duration, as an initial guess of a solve.

    The duration is that of `flown` times `share`; velocities are divided by `share`. The keys of
    the result are "time" (fractions of the horizon), "duration" (new end time [s]) and names of
    states.

    Examples
    --------
    >>> guess_from(solution, 0.5)["duration"] / solution.horizon[1]
    0.5
    """
    fractions = np.linspace(0.0, 1.0, _GUESS_SAMPLES)
    states = flown.trajectory.states_at(fractions)
    names = [state.name for state in flown.problem.compiled.declared.states]
    columns = dict(zip(names, states.T, strict=True))
    # The same path takes `share` times as long.
    for name in VELOCITY_STATES:
        columns[name] = columns[name] / share
    return {"time": fractions} | columns | {"duration": share * flown.horizon[1]}


def journey_as_flown(told: Scenario, journey: Journey, solution: Solution) -> Journey:
    """Return a journey with the sides on which a solution really passes the zones.

    `told` is the scenario of the mission. The initial guess of the solve led along `journey`; the
    solution may pass a zone on another side than the guess.
    """
    track = solution.trajectory.states[:, _position_columns(solution)]
    times = solution.timeline.time(np.append(0.0, solution.mesh.point_fractions))
    passed = [solution.value("mission.passing_time", index=k) for k in range(len(journey) - 1)]
    begun = [0, *np.searchsorted(times, passed)]
    zones = {zone.name: zone for zone in told.airspace.keep_out}
    flown = []
    for route, first, last in zip(journey, begun, [*begun[1:], len(track) - 1], strict=True):
        part = track[first : last + 1]
        sides = []
        for name, side in route.sides:
            leg = zones[name], route.places[[0, -1]], told.airspace.clearance
            found = sides_passed(*leg, part[:-1], part[1:])
            crossed = found[found >= 0]
            sides.append((name, list(Side)[crossed[0]] if crossed.size else side))
        flown.append(replace(route, sides=tuple(sides)))
    return tuple(flown)


# Distance from a zone's clearance at which a path on a coarse mesh touches it [m].
_TOUCHING_M = 0.1
# Samples per element of the path, at which its distance from zones is computed.
_LOOKS = 8


def sides_touched(told: Scenario, journey: Journey, solution: Solution) -> _SidesTouched:
    """Return the zones that a flight touches on each leg, and the side on which it passes each.

    A flight touches a zone if it comes within 0.1 m of the zone's clearance. Each leg has a set of
    pairs (name of a zone, side), see docs/theory/routes.md, eq. (1). `told` is the scenario of the
    mission. `journey` is that of the solution's initial guess; only the zones that it names for a
    leg are examined.
    """
    mesh, columns = solution.mesh, _position_columns(solution)
    inner = np.linspace(0.0, 1.0, _LOOKS, endpoint=False)
    starts = np.asarray(mesh.breakpoints[:-1])
    fractions = np.append((starts[:, None] + mesh.widths[:, None] * inner).ravel(), 1.0)
    places = solution.trajectory.states_at(fractions)[:, columns]
    times = solution.timeline.time(fractions)
    passed = [solution.value("mission.passing_time", index=k) for k in range(len(journey) - 1)]
    borders = [0, *np.searchsorted(times, passed).tolist(), len(times) - 1]
    zones = {zone.name: zone for zone in told.airspace.keep_out}
    least = -told.airspace.clearance - _TOUCHING_M
    return tuple(
        frozenset(
            (name, side)
            for name, side in route.sides
            if zones[name].depth(places[first : last + 1]).max() >= least
        )
        for route, (first, last) in zip(
            journey_as_flown(told, journey, solution), pairwise(borders), strict=True
        )
    )


def _is_dominated(journey: Journey, touched: _SidesTouched) -> bool:
    """Return whether a journey need not be solved, because a known solution is as good.

    This is so if the journey passes all zones in `touched` on the sides given there. They are the
    zones that the solution touches, for each leg.
    """
    return all(sides <= set(route.sides) for route, sides in zip(journey, touched, strict=True))


def _position_columns(solution: Solution) -> list[int]:
    names = [slot.name for slot in solution.problem.compiled.declared.states]
    return [names.index(name) for name in POSITION_STATES]


# Relative difference of costs, and distance between paths [m], below which two solutions count as
# the same flight: what hardly costs anything, such as the rotors' shares, may differ.
_SAME_COST, _SAME_PLACE_M = 1e-6, 0.05


def _is_same(one: Solution, other: Solution) -> bool:
    """Return whether two solutions on one mesh have converged to the same flight.

    The relative difference of the costs must be at most 1e-6. The positions may differ by 5 cm
    along each axis.
    """
    if not (one.status.is_solved and other.status.is_solved):
        return False
    fractions = np.append(0.0, one.mesh.point_fractions)
    paths = (s.trajectory.states_at(fractions)[:, _position_columns(s)] for s in (one, other))
    apart = float(np.abs(np.subtract(*paths)).max())
    difference = abs(one.objective - other.objective)
    return difference <= _SAME_COST * abs(one.objective) and apart <= _SAME_PLACE_M


def _nearest(known: Mapping[int, Solution], share: float, most: int) -> list[int]:
    """Return the numbers of the solutions whose cost is near the least, the cheapest first.

    `share` is the largest relative difference from the least cost. At most `most` are returned.
    """
    costs = {k: _cost(s) for k, s in known.items() if s.status.is_solved}
    least = min(costs.values(), default=inf)
    order = sorted(costs, key=lambda k: costs[k])
    return [k for k in order if costs[k] - least <= share * abs(least)][:most]


def _cost(solution: Solution) -> float:
    return solution.objective if solution.status.is_solved else inf


def _saves(found: Solution, known: Solution) -> bool:
    """Return whether a solution costs less than a known one, by more than a relative 1e-4."""
    return _cost(found) < (1.0 - _SAVED) * _cost(known)


def _cheapest(known: Mapping[int, Solution]) -> list[int]:
    """Return the numbers of all solutions, sorted by cost, the cheapest first.

    The cost is the objective of the solve. Failed solves come last.
    """
    return sorted(known, key=lambda k: _cost(known[k]))
