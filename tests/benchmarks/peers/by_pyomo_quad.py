"""This engine: a Pyomo.DAE model, refined until a tolerance is met."""

import numpy as np
import pyomo.environ as pyo
from pyomo.dae import ContinuousSet, DerivativeVar, Integral

from pyomo_quad.collocation import compile
from tests.benchmarks.peers.problems import FREE

RUNGS = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)


def model_of(problem):
    """Return the Pyomo.DAE model of a problem on a horizon of length one."""
    m = pyo.ConcreteModel()
    m.s = ContinuousSet(bounds=(0, 1))
    low, high, first = problem.duration
    m.T = pyo.Var(bounds=(low, high), initialize=first)
    if not problem.is_free:
        m.T.fix(first)
    for k, (name, (start, end, floor, ceiling)) in enumerate(problem.states.items()):
        variable = pyo.Var(
            m.s, bounds=(floor, ceiling), initialize=lambda _m, s, k=k: problem.guess(s)[k]
        )
        m.add_component(name, variable)
        m.add_component(f"d{name}", DerivativeVar(variable, wrt=m.s))
        variable[0].fix(start)
        if end is not FREE:
            variable[1].fix(end)
    for name, (floor, ceiling, value) in problem.controls.items():
        m.add_component(name, pyo.Var(m.s, bounds=(floor, ceiling), initialize=value))

    def at(m, s):
        states = [m.component(name)[s] for name in problem.states]
        return states, [m.component(name)[s] for name in problem.controls]

    for k, name in enumerate(problem.states):

        def law(m, s, k=k, name=name):
            return m.component(f"d{name}")[s] == m.T * problem.rates(pyo, *at(m, s))[k]

        m.add_component(f"{name}_law", pyo.Constraint(m.s, rule=law))
    if problem.path is not None:
        m.outside = pyo.Constraint(m.s, rule=lambda m, s: problem.path(pyo, *at(m, s))[0] >= 0)
    m.spent = Integral(m.s, wrt=m.s, rule=lambda m, s: m.T * problem.running(pyo, *at(m, s)))
    final = [m.component(name)[1] for name in problem.states]
    m.cost = pyo.Objective(expr=problem.objective(final, m.T, m.spent))
    return m


def solve(problem, tolerance):
    """Return duration, pieces of control, and iterations; see `tests.benchmarks.peers`."""
    found = compile(model_of(problem)).solve(tolerance=tolerance)
    if not found.status.is_solved:
        raise RuntimeError(found.message)
    mesh, held = found.mesh, found.trajectory
    duration = found.value("T") if problem.is_free else problem.duration[2]
    pieces, first = [], 0
    for start, end, degree in zip(
        mesh.breakpoints[:-1], mesh.breakpoints[1:], mesh.degrees, strict=True
    ):
        points = mesh.point_fractions[first : first + degree]
        values = held.algebraics_at(points)
        columns = [_column(found, name) for name in problem.controls]
        pieces.append((start, end, points.tolist(), np.asarray(values)[:, columns].tolist()))
        first += degree
    return duration, pieces, sum(record.iterations for record in found.history)


def _column(found, name):
    slots = found.problem.compiled.declared.algebraics
    return [slot.name for slot in slots].index(name)
