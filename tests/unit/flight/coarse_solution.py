"""Solutions on coarse meshes that need no solve."""

from types import SimpleNamespace

import numpy as np

from pyomo_quad.collocation import SolverOptions, Status, Trajectory
from pyomo_quad.flight.flight import POSITION_STATES
from pyomo_quad.flight.route_flights import RouteFlights


def solution_at(height, objective, mesh):
    """Return a converged solution of three states that stay at a height."""
    states = np.full((mesh.points + 1, len(POSITION_STATES)), height)
    held = Trajectory(
        mesh=mesh, states=states, algebraics=np.zeros((mesh.points, 0)), statics=np.zeros(0)
    )
    slots = [SimpleNamespace(name=name) for name in POSITION_STATES]
    declared = SimpleNamespace(states=slots)
    return SimpleNamespace(
        status=Status.CONVERGED,
        objective=objective,
        trajectory=held,
        mesh=mesh,
        problem=SimpleNamespace(compiled=SimpleNamespace(declared=declared)),
    )


class CoarseFlights(RouteFlights):
    """Flights along routes whose solutions are given by tests, as `solution_at` returns them."""

    def __init__(self):
        """Need no mission, and know no solution."""
        self._mission = self._known = None

    def _rough_options(self):
        return SolverOptions()

    def fly_again(self, flown, _share, options=None):
        del options
        return flown

    def refine(self, flown, _meshes):
        return flown

    def energy_of(self, solution):
        return solution.objective

    def as_flown(self, journey, _solution):
        return journey
