"""MAPTOR (`pip install maptor`), Radau points on a fixed mesh."""

import casadi
import maptor
import numpy as np

RUNGS = (5, 10, 20, 40, 80, 160)
DEGREE = 4


def solve(problem, elements):
    """Return duration, pieces of control, and iterations; see `tests.benchmarks.peers`."""
    low, high, first = problem.duration
    declared = maptor.Problem("benchmark")
    phase = declared.set_phase(1)
    time = phase.time(initial=0.0, final=(low, high) if problem.is_free else first)
    states = [
        phase.state(name, initial=start, final=end, boundary=(floor, ceiling))
        for name, (start, end, floor, ceiling) in problem.states.items()
    ]
    controls = [
        phase.control(name, boundary=(floor, ceiling))
        for name, (floor, ceiling, _) in problem.controls.items()
    ]
    rates = problem.rates(casadi, states, controls)
    phase.dynamics(dict(zip(states, rates, strict=True)))
    for outside in [] if problem.path is None else problem.path(casadi, states, controls):
        phase.path_constraints(outside >= 0)
    running = problem.running(casadi, states, controls)
    spent = 0.0 if isinstance(running, float) else phase.add_integral(running)
    final = [state.final for state in states]
    declared.minimize(problem.objective(final, time.final, spent))
    phase.mesh([DEGREE] * elements, np.linspace(-1.0, 1.0, elements + 1))
    nodes = np.array([0.0, *casadi.collocation_points(DEGREE, "radau")])
    value = [[limits[2]] for limits in problem.controls.values()]
    # Its Radau points begin with the element, so a guess at any points serves as well.
    phase.guess(
        states=[
            np.array([problem.guess((e + s) / elements) for s in nodes]).T for e in range(elements)
        ],
        controls=[np.tile(value, DEGREE) for _ in range(elements)],
        initial_time=0.0,
        terminal_time=first,
    )
    options = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": 0, "ipopt.max_iter": 1000}
    found = maptor.solve_fixed_mesh(declared, nlp_options=options, show_summary=False)
    if not found.status["success"]:
        raise RuntimeError(found.status["message"])
    held = np.column_stack([np.asarray(found[(1, name)]) for name in problem.controls])
    times = np.asarray(found[(1, "time_controls")])
    end = float(found.phases[1]["times"]["final"])
    pieces = []
    for e in range(elements):
        part = slice(e * DEGREE, (e + 1) * DEGREE)
        shares = times[part] / end
        pieces.append((e / elements, (e + 1) / elements, shares.tolist(), held[part].tolist()))
    return end, pieces, 0
