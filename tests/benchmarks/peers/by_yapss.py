"""YAPSS (`pip install yapss`), Radau points, CasADi's derivatives."""

import numpy as np
from yapss import Problem as Declared
from yapss import math

from tests.benchmarks.peers.problems import FREE

RUNGS = (5, 10, 20, 40, 80, 160)
DEGREE = 4


def solve(problem, elements):
    """Return duration, pieces of control, and iterations; see `tests.benchmarks.peers`."""
    low, high, first = problem.duration
    n, k = len(problem.states), len(problem.controls)
    paths = 0 if problem.path is None else 1
    declared = Declared(name="benchmark", nx=[n], nu=[k], nq=[1], nh=[paths])

    def objective(arg):
        phase = arg.phase[0]
        arg.objective = problem.objective(phase.final_state, phase.final_time, phase.integral[0])

    def continuous(arg):
        phase = arg.phase[0]
        states, controls = list(phase.state), list(phase.control)
        phase.dynamics[:] = tuple(problem.rates(math, states, controls))
        phase.integrand[:] = (problem.running(math, states, controls) + 0 * states[0],)
        if paths:
            phase.path[:] = tuple(problem.path(math, states, controls))

    declared.functions.objective, declared.functions.continuous = objective, continuous
    bounds = declared.bounds.phase[0]
    bounds.initial_time.lower = bounds.initial_time.upper = 0.0
    bounds.final_time.lower, bounds.final_time.upper = low, high
    for j, (start, end, floor, ceiling) in enumerate(problem.states.values()):
        bounds.initial_state.lower[j] = bounds.initial_state.upper[j] = start
        bounds.state.lower[j], bounds.state.upper[j] = floor, ceiling
        if end is not FREE:
            bounds.final_state.lower[j] = bounds.final_state.upper[j] = end
    for j, (floor, ceiling, _) in enumerate(problem.controls.values()):
        bounds.control.lower[j], bounds.control.upper[j] = floor, ceiling
    if paths:
        bounds.path.lower[:] = 0.0
    shares = np.linspace(0.0, 1.0, elements + 1)
    guess = declared.guess.phase[0]
    guess.time = (shares * first).tolist()
    guess.state = np.array([problem.guess(s) for s in shares]).T.tolist()
    guess.control = [[value] * len(shares) for _, _, value in problem.controls.values()]
    declared.mesh.phase[0].collocation_points = elements * (DEGREE,)
    declared.mesh.phase[0].fraction = elements * (1.0 / elements,)
    declared.spectral_method = "lgr"
    declared.derivatives.method, declared.derivatives.order = "auto", "second"
    declared.ipopt_options.print_level, declared.ipopt_options.max_iter = 0, 1000
    found = declared.solve()
    if found.nlp_info.ipopt_status not in (0, 1):
        raise RuntimeError(str(found.nlp_info.ipopt_status_message))
    phase = found.phase[0]
    times, held = np.asarray(phase.time_c), np.asarray(phase.control).T
    end = float(phase.final_time)
    pieces = []
    for e in range(elements):
        part = slice(e * DEGREE, (e + 1) * DEGREE)
        pieces.append(
            (e / elements, (e + 1) / elements, (times[part] / end).tolist(), held[part].tolist())
        )
    return end, pieces, 0
