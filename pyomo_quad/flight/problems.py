"""Compiled optimal control problems of scenarios, and their equations for simulations."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.collocation import Dynamics, Problem, compile
from pyomo_quad.flight.baselines import declared_start
from pyomo_quad.flight.caches import MOST_PROBLEMS, MOST_STEADY, PROBLEMS, Recent
from pyomo_quad.flight.corridors import has_corridors
from pyomo_quad.flight.flight import POSITION_STATES
from pyomo_quad.flight.least_time import declared_free_times
from pyomo_quad.flight.steady import SteadyFlight
from pyomo_quad.flight.verdict import horizon_of
from pyomo_quad.model import build_model, parameter_values, structure_key
from pyomo_quad.model.build import guess_key
from pyomo_quad.model.limits import without_reserve
from pyomo_quad.model.wind import still_air
from pyomo_quad.scenario import Scenario

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pyomo_quad.arrays import FloatArray

Builder = Callable[[Scenario], Any]


def _start_key(scenario: Scenario) -> Scenario:
    """Return a key that is equal only for scenarios with equal initial states.

    The scenarios must have fixed durations. The key is the scenario without wind, baseline settings
    and duration.
    """
    # Duration, wind and settings of baseline flights do not affect the initial states.
    timeless = scenario.mission.model_copy(update={"duration": 1.0})
    return guess_key(scenario).model_copy(update={"mission": timeless, "baseline": None})


# Components of the declared wind along world x and y [m/s].
_WIND = ("wind.velocity_x", "wind.velocity_y")


class Problems:
    """Compiler of scenarios, which caches compiled problems.

    Scenarios that differ only in parameter values share a compiled problem. Problems of the
    package's own model are in a cache that all planners of the process share.

    Parameters
    ----------
    builder : callable, optional
        Takes a scenario and builds its Pyomo model. A user's own builder is called again for every
        scenario, because its model may contain numbers of the scenario as constants.
    """

    def __init__(self, builder: Builder = build_model) -> None:
        self._builder = builder
        self._problems = PROBLEMS if self.is_declared else Recent(MOST_PROBLEMS)
        self._steady: Recent[SteadyFlight] = Recent(MOST_STEADY)

    @property
    def builder(self) -> Builder:
        """Function that builds the Pyomo model of a scenario."""
        return self._builder

    @property
    def is_declared(self) -> bool:
        """Whether scenarios use the package's own model, and not a model of the user."""
        return self._builder is build_model

    def has_routes(self, scenario: Scenario) -> bool:
        """Return whether there may be several routes, past keep-out zones or through a wind field.

        The mission of the scenario is then solved along several routes, and the solutions are
        compared. The result is False for a user's own model.
        """
        has_choice = bool(scenario.airspace.keep_out) or has_corridors(scenario)
        return self.is_declared and has_choice

    def problem_for(self, scenario: Scenario) -> tuple[Problem, dict[str, float]]:
        """Return the compiled problem of a scenario, and the time spent on it [s] by phase.

        The phases are "build", in which the Pyomo model is built, and "compile". Both times are
        zero if a cached problem already has the scenario's initial guess and scaling of variables.
        If only these two differ, the model is built anew, but its equations are not compiled again.
        """
        key = self._key(scenario)
        built_for, problem = self._problems.get(key) or (scenario, None)
        # Initial guess and scaling are always computed for the scenario to be solved, so that
        # results are independent of earlier solves.
        if problem is not None and guess_key(built_for) == guess_key(scenario):
            return problem, {"build": 0.0, "compile": 0.0}
        started = time.perf_counter()
        model = self._builder(scenario)
        built = time.perf_counter()
        if problem is None:
            problem = compile(model, times=declared_free_times(model, scenario))
        else:
            problem = problem.holding(model)
        self._problems.store(key, (scenario, problem))
        return problem, {"build": built - started, "compile": time.perf_counter() - built}

    def _key(self, scenario: Scenario) -> Hashable:
        return structure_key(scenario) if self.is_declared else scenario

    def model(self, scenario: Scenario) -> Any:
        """Return the Pyomo model of a scenario, with the scenario's parameter values.

        It may be the model of the cached problem, which callers must not change.
        """
        built_for, problem = self._problems.get(self._key(scenario)) or (None, None)
        if problem is None or built_for != scenario:
            return self._builder(scenario)
        return problem.model

    def steady_flight(
        self, scenario: Scenario, known: Mapping[str, float] | None = None
    ) -> SteadyFlight:
        """Return the calculator of steady flight of a scenario's vehicle in still air.

        A user's own model may have states that the mission does not define. `known` maps their
        names to initial values. A calculator that is cached already keeps its earlier values.
        """
        steady = self._steady.get(scenario)
        if steady is None:
            problem, _ = self.problem_for(scenario)
            numbers = (self.parameters(scenario) or {}) | still_air(problem.model)
            horizon = horizon_of(scenario)
            still = problem.dynamics(parameters=numbers, horizon=horizon).without_iterations()
            steady = self._steady.store(scenario, SteadyFlight(scenario, still, known))
        return steady

    def parameters(self, scenario: Scenario) -> dict[str, float] | None:
        """Return the values of the parameters of a scenario's compiled problem, by full name.

        The result is None for a user's own model.
        """
        return parameter_values(scenario) if self.is_declared else None

    def dynamics(self, scenario: Scenario) -> Dynamics:
        """Return the equations of a scenario's vehicle in its wind, for simulations.

        Their limits on rotor speed and thrust are the full ones, without `limits.reserve`. Plans
        leave this reserve to the controller, which may use it in a simulation.
        """
        _, problem = self._problems.get(self._key(scenario)) or (scenario, None)
        if problem is None or not self._starts_alike(scenario):
            problem = self.problem_for(scenario)[0]
        numbers = without_reserve(self.parameters(scenario))
        horizon = horizon_of(scenario)
        return problem.dynamics(parameters=numbers, horizon=horizon).without_iterations()

    def _starts_alike(self, scenario: Scenario) -> bool:
        """Return whether the cached problem of a scenario has the scenario's initial states.

        If so, the equations of the cached problem can be used to simulate `scenario`.
        """
        built_for, _ = self._problems.get(self._key(scenario)) or (None, None)
        # A wind measured over time is sampled at fixed fractions of the duration, so that the
        # samples depend on the duration.
        if built_for is None or not self.is_declared or scenario.wind.series is not None:
            return False
        if built_for.mission.is_free or scenario.mission.is_free:
            # With a free duration, the two scenarios may differ in the wind only.
            return guess_key(built_for) == guess_key(scenario)
        return _start_key(built_for) == _start_key(scenario)

    def winds_at(self, scenario: Scenario, places: ArrayLike) -> FloatArray:
        """Return the wind along world x and y at given places when the mission starts [m/s].

        `places` has shape (n, 3), m; the result has shape (n, 2).
        """
        dynamics, held = self.dynamics(scenario), np.atleast_2d(places)
        names = list(dynamics.state_names)
        start = dynamics.initial_states() | declared_start(scenario, dynamics)
        states = np.tile([start[name] for name in names], (len(held), 1))
        states[:, [names.index(name) for name in POSITION_STATES]] = held
        controls = np.zeros((len(held), len(dynamics.control_names)))
        times = np.full(len(held), dynamics.start)
        return dynamics.table(tuple((name, None) for name in _WIND), times, states, controls)
