"""mpopt (`pip install mpopt`), Radau points on equal segments; the integral is a state more."""

import casadi
import numpy as np
from mpopt import mp

from tests.benchmarks.peers.problems import FREE

RUNGS = (5, 10, 20, 40, 80)
DEGREE = 4


def solve(problem, elements):
    """Return duration, pieces of control, and iterations; see `tests.benchmarks.peers`."""
    low, high, first = problem.duration
    n, k = len(problem.states), len(problem.controls)
    ocp = mp.OCP(n_states=n + 1, n_controls=k)

    def states_of(x):
        return [x[j] for j in range(n)]

    def dynamics(x, u, _t):
        controls = [u[j] for j in range(k)]
        rates = problem.rates(casadi, states_of(x), controls)
        return [*rates, problem.running(casadi, states_of(x), controls)]

    def ends(xf, _tf, _x0, _t0):
        parts = problem.states.values()
        return [xf[j] - end for j, (_, end, _, _) in enumerate(parts) if end is not FREE] or None

    def cost(xf, tf, _x0, _t0):
        return problem.objective(states_of(xf), tf, xf[n])

    def outside(x, u, _t):
        return [-g for g in problem.path(casadi, states_of(x), [u[j] for j in range(k)])]

    ocp.dynamics[0], ocp.terminal_constraints[0], ocp.terminal_costs[0] = dynamics, ends, cost
    if problem.path is not None:
        ocp.path_constraints[0] = outside
    start, floor, ceiling = ([s[j] for s in problem.states.values()] for j in (0, 2, 3))
    ocp.x00[0], ocp.xf0[0] = [*start, 0.0], [*problem.guess(1.0), 0.0]
    ocp.u00[0] = ocp.uf0[0] = [value for _, _, value in problem.controls.values()]
    ocp.lbx[0], ocp.ubx[0] = [*floor, -np.inf], [*ceiling, np.inf]
    ocp.lbu[0], ocp.ubu[0] = ([c[j] for c in problem.controls.values()] for j in (0, 1))
    ocp.tf0[0], ocp.lbtf[0], ocp.ubtf[0] = first, low, high
    ocp.scale_x = np.array([*(1 / problem.scale(name) for name in problem.states), 1.0])
    ocp.validate()
    solver = mp.mpopt(ocp, elements, DEGREE, scheme="LGR")
    quiet = {"ipopt.print_level": 0, "print_time": 0, "ipopt.sb": "yes", "ipopt.max_iter": 1000}
    solver.create_solver("ipopt", quiet)
    found = solver.solve()
    if not solver.nlp_solver.stats()["success"]:
        raise RuntimeError(solver.nlp_solver.stats()["return_status"])
    _, held, times, _ = solver.process_results(found, plot=False).get_original_data()
    times, held = np.ravel(times), np.asarray(held).reshape(len(np.ravel(times)), k)
    end = float(times[-1])
    pieces = []
    for e in range(elements):
        part = slice(e * DEGREE, (e + 1) * DEGREE + 1)
        shares = times[part] / end
        pieces.append((e / elements, (e + 1) / elements, shares.tolist(), held[part].tolist()))
    return end, pieces, int(solver.nlp_solver.stats()["iter_count"])
