"""Solutions on coarse meshes that need no solve."""

from types import SimpleNamespace

import numpy as np

from pyomo_quad.collocation import Status, Trajectory
from pyomo_quad.flight.flight import POSITION_STATES


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
