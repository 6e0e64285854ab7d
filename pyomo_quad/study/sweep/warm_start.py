"""What a solved case leaves for its children: a point of the program, and its multipliers.

Plain arrays in NumPy's own format, so that nothing in a store or on the wire is executable.
"""

from dataclasses import dataclass
from io import BytesIO
from typing import cast
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from pyomo_quad.collocation import Mesh, Problem, Solution
from pyomo_quad.collocation.ipopt import Multipliers
from pyomo_quad.collocation.nodes import FloatArray
from pyomo_quad.collocation.trajectory import Trajectory
from pyomo_quad.flight import Plan, Planner
from pyomo_quad.scenario import Scenario

__all__ = ["pack", "unpack"]

IntArray = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True)
class _Point:
    """What the engine reads of the solution that a solve starts from."""

    problem: Problem
    mesh: Mesh
    trajectory: Trajectory
    multipliers: Multipliers
    columns: tuple[IntArray, IntArray, IntArray]

    def split(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Split a vector shaped like the unknowns into states, algebraics and statics."""
        states, algebraics, statics = self.columns
        return unknowns[states], unknowns[algebraics], unknowns[statics]


@dataclass(frozen=True, kw_only=True)
class _Parent:
    """What the planner reads of the plan that a solve starts from."""

    solution: _Point

    @property
    def mesh(self) -> Mesh:
        return self.solution.mesh


def pack(solution: Solution) -> bytes:
    """Write down where another solve can start.

    Parameters
    ----------
    solution : Solution
        Converged.

    Returns
    -------
    bytes
        For `unpack`.
    """
    target = BytesIO()
    multipliers = solution.multipliers
    np.savez(
        target,
        breakpoints=np.asarray(solution.mesh.breakpoints),
        degrees=np.asarray(solution.mesh.degrees),
        unknowns=solution.unknowns,
        rows=multipliers.rows,
        lower=multipliers.lower,
        upper=multipliers.upper,
    )
    return target.getvalue()


def unpack(packed: bytes, planner: Planner, scenario: Scenario) -> Plan | None:
    """Read where a solve can start.

    Parameters
    ----------
    packed : bytes
        Written by `pack`.
    planner : Planner
        The one that is going to solve.
    scenario : Scenario
        What it is going to solve.

    Returns
    -------
    Plan or None
        For `Planner.solve`; None when the scenario's equations have another shape than those
        the point was found with.
    """
    try:
        with np.load(BytesIO(packed), allow_pickle=False) as file:
            held = {name: np.asarray(file[name]) for name in file.files}
        mesh = Mesh(
            breakpoints=tuple(float(b) for b in held["breakpoints"]),
            degrees=tuple(int(d) for d in held["degrees"]),
        )
        multipliers = Multipliers(rows=held["rows"], lower=held["lower"], upper=held["upper"])
        unknowns = held["unknowns"]
    except (BadZipFile, KeyError, ValueError):
        return None
    told = scenario.as_forecast()
    problem, _ = planner.problem_for(told)
    instance = problem.instance(planner.parameters(told), (0.0, told.mission.duration))
    program = problem.program(mesh, instance)
    layout = program.layout
    if unknowns.size != layout.unknowns or multipliers.rows.size != program.n_rows:
        return None
    columns = (layout.state_columns, layout.algebraic_columns, layout.static_columns)
    states, algebraics, statics = (unknowns[held] for held in columns)
    point = _Point(
        problem=problem,
        mesh=mesh,
        trajectory=Trajectory(mesh=mesh, states=states, algebraics=algebraics, statics=statics),
        multipliers=multipliers,
        columns=columns,
    )
    # The planner reads no more of a plan that it starts from, nor the engine of a solution.
    return cast("Plan", _Parent(solution=point))
