"""rockit (`pip install rockit-meco`), direct collocation; controls are constant on an element."""

import casadi
import numpy as np
import rockit

from tests.benchmarks.peers.problems import FREE

RUNGS = (10, 20, 40, 80, 160, 320)
DEGREE = 4


def solve(problem, elements):
    """Return duration, pieces of control, and iterations; see `tests.benchmarks.peers`."""
    low, high, first = problem.duration
    ocp = rockit.Ocp(T=rockit.FreeTime(first) if problem.is_free else first)
    states = [ocp.state(scale=problem.scale(name)) for name in problem.states]
    controls = [ocp.control() for _ in problem.controls]
    for state, rate in zip(states, problem.rates(casadi, states, controls), strict=True):
        ocp.set_der(state, rate)
    if problem.is_free:
        ocp.subject_to(low <= (high >= ocp.T))
    for k, (state, (start, end, floor, ceiling)) in enumerate(
        zip(states, problem.states.values(), strict=True)
    ):
        ocp.subject_to(ocp.at_t0(state) == start)
        if end is not FREE:
            ocp.subject_to(ocp.at_tf(state) == end)
        ocp.subject_to(floor <= (state <= ceiling), include_first=False, include_last=end is FREE)
        ocp.set_initial(state, problem.guess(ocp.t / first, casadi)[k])
    for control, (floor, ceiling, value) in zip(controls, problem.controls.values(), strict=True):
        ocp.subject_to(floor <= (control <= ceiling))
        ocp.set_initial(control, value)
    for outside in [] if problem.path is None else problem.path(casadi, states, controls):
        ocp.subject_to(outside >= 0)
    spent = ocp.integral(problem.running(casadi, states, controls) + 0 * states[0])
    final = [ocp.at_tf(state) for state in states]
    ocp.add_objective(problem.objective(final, ocp.T, spent))
    quiet = {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes"}
    ocp.solver("ipopt", quiet | {"ipopt.max_iter": 1000})
    ocp.method(rockit.DirectCollocation(N=elements, M=1, degree=DEGREE, scheme="radau"))
    found = ocp.solve()
    held = np.column_stack(
        [found.sample(control, grid="control")[1][:elements] for control in controls]
    )
    pieces = [
        (e / elements, (e + 1) / elements, [e / elements], [held[e].tolist()])
        for e in range(elements)
    ]
    duration = float(found.value(ocp.T)) if problem.is_free else first
    return duration, pieces, int(found.stats["iter_count"])
