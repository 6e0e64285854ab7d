"""CasADi by hand, in the manner of its own example of direct collocation, with its own Ipopt."""

import casadi
import numpy as np

from tests.benchmarks.peers.problems import FREE

RUNGS = (5, 10, 20, 40, 80, 160)
DEGREE = 4


def solve(problem, elements):
    """Return duration, pieces of control, and iterations; see `tests.benchmarks.peers`."""
    n, k = len(problem.states), len(problem.controls)
    scales = np.array([problem.scale(name) for name in problem.states])
    point = _point(problem, scales)
    nodes = casadi.collocation_points(DEGREE, "radau")
    slopes, _, weights = casadi.collocation_coeff(nodes)
    low, high, first = problem.duration
    duration = casadi.MX.sym("T")
    unknowns, lower, upper, guess = [duration], [[low]], [[high]], [[first]]
    rows, row_upper, spent = [], [], 0.0
    start, end, floor, ceiling = (np.array(part, dtype=float) for part in _ends(problem))
    last = casadi.DM(start / scales)
    for e in range(elements):
        states = casadi.MX.sym(f"x{e}", n, DEGREE)
        controls = casadi.MX.sym(f"u{e}", k, DEGREE)
        rates, power, outside = point.map(DEGREE)(states, controls)
        rows.append(casadi.vec(casadi.horzcat(last, states) @ slopes - duration / elements * rates))
        row_upper.append(np.zeros(n * DEGREE))
        if problem.path is not None:
            rows.append(casadi.vec(outside))
            row_upper.append(np.full(outside.numel(), np.inf))
        spent += duration / elements * (power @ weights)
        for part, bound in ((lower, floor), (upper, ceiling)):
            bounds = np.tile(bound, (DEGREE, 1))
            if e == elements - 1:
                bounds[-1] = np.where(np.isnan(end), bound, end)
            part += [(bounds / scales).ravel(), *_limits(problem, part is upper)]
        shares = (e + np.array(nodes)) / elements
        guess.append(np.ravel([np.array(problem.guess(s)) / scales for s in shares]))
        guess.append(np.tile([c[2] for c in problem.controls.values()], DEGREE))
        unknowns += [casadi.vec(states), casadi.vec(controls)]
        last = states[:, -1]
    final = casadi.vertsplit(last * scales)
    program = {
        "x": casadi.vertcat(*unknowns),
        "f": problem.objective(final, duration, spent),
        "g": casadi.vertcat(*rows),
    }
    quiet = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False}
    solver = casadi.nlpsol("by_hand", "ipopt", program, quiet | {"ipopt.max_iter": 1000})
    found = solver(
        x0=np.concatenate(guess),
        lbx=np.concatenate(lower),
        ubx=np.concatenate(upper),
        lbg=0.0,
        ubg=np.concatenate(row_upper),
    )
    if not solver.stats()["success"]:
        raise RuntimeError(solver.stats()["return_status"])
    z, size = np.array(found["x"]).ravel(), (n + k) * DEGREE
    pieces = []
    for e in range(elements):
        controls = z[1 + e * size + n * DEGREE : 1 + (e + 1) * size].reshape(DEGREE, k)
        shares = (e + np.array(nodes)) / elements
        pieces.append((e / elements, (e + 1) / elements, shares.tolist(), controls.tolist()))
    return float(z[0]), pieces, int(solver.stats()["iter_count"])


def _point(problem, scales):
    x, u = casadi.SX.sym("x", len(problem.states)), casadi.SX.sym("u", len(problem.controls))
    states, controls = casadi.vertsplit(x * scales), casadi.vertsplit(u)
    rates = casadi.vertcat(*problem.rates(casadi, states, controls)) / scales
    outside = [] if problem.path is None else problem.path(casadi, states, controls)
    power = problem.running(casadi, states, controls)
    return casadi.Function("point", [x, u], [rates, power, casadi.vertcat(*outside)])


def _ends(problem):
    parts = zip(*problem.states.values(), strict=True)
    return [[np.nan if value is FREE else value for value in part] for part in parts]


def _limits(problem, is_upper):
    return [np.tile([limits[is_upper] for limits in problem.controls.values()], DEGREE)]
