"""Test 1 of the paper in rockit, a peer that pip can install: `pip install rockit-meco`.

A whole process: `python -m tests.benchmarks.peer ELEMENTS` imports, builds, solves and prints
the energy.  rockit holds controls constant over an element, so its optimum lies a little above.
"""

import sys

from tests.benchmarks import handwritten


def solve_with_rockit(elements, degree):
    """Return the energy that rockit's direct collocation finds."""
    import casadi
    import rockit

    ocp = rockit.Ocp(T=handwritten.DURATION)
    x = ocp.state(16, scale=casadi.DM(handwritten.STATE_SCALES))
    alpha = ocp.control(4, scale=casadi.DM(handwritten.CONTROL_SCALES))
    slopes, power, limited = handwritten.equations(has_wind=False)(x, alpha, 0.0)
    ocp.set_der(x, slopes)
    ocp.add_objective(ocp.integral(power))
    ocp.subject_to(ocp.at_t0(x) == handwritten.START)
    ocp.subject_to(ocp.at_tf(x) == handwritten.END)
    limit = handwritten.ACCELERATION_MAX
    ocp.subject_to(-limit <= (alpha <= limit))
    bounded = range(6, 8), range(12, 16)
    for k in (k for group in bounded for k in group):
        floor, ceiling = handwritten.STATE_FLOORS[k], handwritten.STATE_LIMITS[k]
        ocp.subject_to(floor <= (x[k] <= ceiling), include_first=False, include_last=False)
    ocp.subject_to((limited <= handwritten.LIMITED_MAX) >= handwritten.LIMITED_MIN)
    share = ocp.t / handwritten.DURATION
    ocp.set_initial(x, handwritten.START + share * (handwritten.END - handwritten.START))
    ocp.solver("ipopt", {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes"})
    ocp.method(rockit.DirectCollocation(N=elements, M=1, degree=degree, scheme="radau"))
    solution = ocp.solve()
    return float(casadi.DM(solution.value(ocp.objective)))


if __name__ == "__main__":
    print(solve_with_rockit(int(sys.argv[1]), 3))
