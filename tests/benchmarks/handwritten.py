"""The paper's missions written by hand in CasADi, as a user without this package would.

From the paper (equation numbers in brackets), in the manner of CasADi's own example of direct
collocation: Radau points, one call of the equations per point, CasADi's own Ipopt.  It shares
the vehicle's numbers with `tests/agreement/plain_quadrotor.py`, and nothing with the package:
a benchmark's rival and an independent check of the optimum.
"""

from dataclasses import dataclass

import casadi
import numpy as np

from tests.agreement.plain_quadrotor import (
    ARM,
    GRAVITY,
    INERTIA,
    IR,
    KAPPA,
    KB,
    KT,
    KV,
    MASS,
    RESISTANCE,
    TABLE_2,
)
from tests.benchmarks.measuring import seconds

DURATION, GOAL = 10.0, (6.0, 7.0, 8.0)
HOVER_SPEED = np.sqrt(MASS * GRAVITY / (4 * KB))
SPEED_MAX = 10_000 * 2 * np.pi / 60
ACCELERATION_MAX = 3000.0
# x y z vx vy vz phi theta psi p q r, four rotor speeds; then four rotor accelerations.
STATE_SCALES = np.array([8.0] * 3 + [0.8] * 3 + [0.1] * 6 + [HOVER_SPEED] * 4)
CONTROL_SCALES = np.full(4, 10.0)
START = np.concatenate([np.zeros(12), np.full(4, HOVER_SPEED)])
END = np.concatenate([GOAL, np.zeros(9), np.full(4, HOVER_SPEED)])
STATE_LIMITS = np.array([np.inf] * 6 + [np.pi / 2] * 2 + [np.inf] * 4 + [SPEED_MAX] * 4)
STATE_FLOORS = np.concatenate([-STATE_LIMITS[:12], np.zeros(4)])


@dataclass(frozen=True, kw_only=True)
class Result:
    """Optimum, counts, and seconds for the symbols, the derivatives and the solve."""

    energy_J: float
    variables: int
    iterations: int
    build_s: float
    derivatives_s: float
    solve_s: float


def _wind(t, table):
    """(11)-(12), m/s."""
    mean, amplitudes, frequencies, gust, period = table
    speed = mean + 2 * gust / (1 + casadi.exp(-4 * (casadi.sin(2 * np.pi / period * t) - 1)))
    for amplitude, frequency in zip(amplitudes, frequencies, strict=True):
        speed += amplitude * casadi.sin(frequency * t)
    return speed


def equations(*, has_wind, air=None):
    """Return (x, alpha, t) -> slopes, power, thrust and moments; (6), (7), (9), (1)-(3).

    `air` is the linear drag [kg/s] on the velocity against a wind, and that wind [m/s] of x and y.
    """
    x, alpha, t = casadi.SX.sym("x", 16), casadi.SX.sym("alpha", 4), casadi.SX.sym("t")
    _, _, _, vx, vy, vz, phi, theta, psi, p, q, r = casadi.vertsplit(x[:12])
    omega = x[12:]
    s1, s2, s3, s4 = casadi.vertsplit(omega**2)
    thrust = KB * (s1 + s2 + s3 + s4)
    roll, pitch = ARM * KB * (s2 - s4), ARM * KB * (s3 - s1)
    yaw = KAPPA * (s1 - s2 + s3 - s4)
    imbalance = omega[0] - omega[1] + omega[2] - omega[3]
    Ix, Iy, Iz = np.diag(INERTIA)
    wind_x = _wind(t, TABLE_2["x"]) if has_wind else 0
    wind_y = _wind(t, TABLE_2["y"]) if has_wind else 0
    drag, field = air or (0.0, lambda _x, _y: (0.0, 0.0))
    around_x, around_y = field(x[0], x[1])
    wind_x += drag / MASS * (around_x - vx)
    wind_y += drag / MASS * (around_y - vy)
    c, s = casadi.cos, casadi.sin
    slopes = casadi.vertcat(
        vx,
        vy,
        vz,
        (c(phi) * s(theta) * c(psi) + s(phi) * s(psi)) * thrust / MASS + wind_x,
        (c(phi) * s(theta) * s(psi) - s(phi) * c(psi)) * thrust / MASS + wind_y,
        c(phi) * c(theta) * thrust / MASS - GRAVITY - drag / MASS * vz,
        p,
        q,
        r,
        ((Iy - Iz) * q * r + IR * q * imbalance + roll) / Ix,
        ((Iz - Ix) * p * r - IR * p * imbalance + pitch) / Iy,
        ((Ix - Iy) * p * q + yaw) / Iz,
        alpha,
    )
    current = (IR * alpha + KAPPA * omega**2) / KT
    power = casadi.dot(RESISTANCE * current + omega / KV, current)
    limited = casadi.vertcat(thrust, roll, pitch, yaw)
    return casadi.Function("point", [x, alpha, t], [slopes, power, limited])


LARGEST_MOMENT = ARM * KB * SPEED_MAX**2
LIMITED_MAX = np.array(
    [4 * KB * SPEED_MAX**2, LARGEST_MOMENT, LARGEST_MOMENT, 2 * KAPPA * SPEED_MAX**2]
)
LIMITED_MIN = np.array([0.0, *-LIMITED_MAX[1:]])
LIMITED_SCALES = LIMITED_MAX


class Program:
    """Collects variables with bounds and guess, and rows with bounds."""

    def __init__(self):
        self.variables, self.lower, self.upper, self.guess = [], [], [], []
        self.rows, self.row_lower, self.row_upper = [], [], []

    def variable(self, name, scales, lower, upper, guess):
        symbol = casadi.MX.sym(name, len(scales))
        self.variables.append(symbol)
        self.lower.append(lower / scales)
        self.upper.append(upper / scales)
        self.guess.append(guess / scales)
        return symbol * scales

    def row(self, expression, lower=0.0, upper=0.0):
        self.rows.append(expression)
        self.row_lower.append(np.broadcast_to(lower, expression.shape[0]))
        self.row_upper.append(np.broadcast_to(upper, expression.shape[0]))

    def state(self, name, fraction, bow=0.0):
        guess = START + (END - START) * fraction
        guess[1] += bow * np.sin(np.pi * fraction)
        lower, upper = STATE_FLOORS, STATE_LIMITS
        if fraction in (0.0, 1.0):
            lower = upper = guess = START if fraction == 0.0 else END
        return self.variable(name, STATE_SCALES, lower, upper, guess)

    def control(self, name):
        limit = np.full(4, ACCELERATION_MAX)
        return self.variable(name, CONTROL_SCALES, -limit, limit, np.zeros(4))


def _transcribe(elements, degree, *, has_wind, mast=None, bow=0.0, air=None):
    point = equations(has_wind=has_wind, air=air)
    nodes = casadi.collocation_points(degree, "radau")
    slope_weights, _, quadrature = casadi.collocation_coeff(nodes)
    program, energy, h = Program(), 0, DURATION / elements
    last = program.state("x_0", 0.0)
    for e in range(elements):
        states, controls = [last], []
        for j, node in enumerate(nodes):
            is_last = e == elements - 1 and j == degree - 1
            fraction = 1.0 if is_last else (e + node) / elements
            states.append(program.state(f"x_{e}_{j}", fraction, bow))
            controls.append(program.control(f"alpha_{e}_{j}"))
        stacked = casadi.horzcat(*states)
        for j, node in enumerate(nodes):
            t = (e + node) * h
            slopes, power, limited = point(states[j + 1], controls[j], t)
            program.row((stacked @ slope_weights[:, j] - h * slopes) / STATE_SCALES)
            program.row(
                limited / LIMITED_SCALES, LIMITED_MIN / LIMITED_SCALES, LIMITED_MAX / LIMITED_SCALES
            )
            if mast is not None:
                *axis, radius = mast
                aside = states[j + 1][:2] - np.array(axis)
                program.row(casadi.dot(aside, aside), radius**2, np.inf)
            energy += h * quadrature[j] * power
        last = states[-1]
    return program, energy


def solve_by_hand(
    elements, degree, *, has_wind=False, tolerance=1e-9, mast=None, bow=0.0, air=None
):
    """Solve test 1 of the paper, or test 2 with its wind.

    `mast` is x, y and radius of a cylinder to keep out of, `bow` how far to +y the guess swerves,
    `air` is told in `equations`.
    """
    started = seconds()
    program, energy = _transcribe(elements, degree, has_wind=has_wind, mast=mast, bow=bow, air=air)
    built = seconds()
    solver = casadi.nlpsol(
        "by_hand",
        "ipopt",
        {
            "x": casadi.vertcat(*program.variables),
            "f": energy,
            "g": casadi.vertcat(*program.rows),
        },
        {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False, "ipopt.tol": tolerance},
    )
    derived = seconds()
    solution = solver(
        x0=np.concatenate(program.guess),
        lbx=np.concatenate(program.lower),
        ubx=np.concatenate(program.upper),
        lbg=np.concatenate(program.row_lower),
        ubg=np.concatenate(program.row_upper),
    )
    solved = seconds()
    statistics = solver.stats()
    if not statistics["success"]:
        raise RuntimeError(f"hand-written CasADi: {statistics['return_status']}")
    return Result(
        energy_J=float(solution["f"]),
        variables=sum(len(bound) for bound in program.lower),
        iterations=int(statistics["iter_count"]),
        build_s=built - started,
        derivatives_s=derived - built,
        solve_s=solved - derived,
    )
