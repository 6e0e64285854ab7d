"""Missions of free time written by hand in CasADi: legs between places, each of its own duration.

The equations are those of `tests/benchmarks/handwritten.py`; the package has no part in it.
"""

import itertools
from dataclasses import dataclass

import casadi
import numpy as np

from tests.benchmarks.handwritten import (
    ACCELERATION_MAX,
    CONTROL_SCALES,
    HOVER_SPEED,
    LIMITED_MAX,
    LIMITED_MIN,
    LIMITED_SCALES,
    STATE_FLOORS,
    STATE_LIMITS,
    STATE_SCALES,
    Program,
    equations,
)


@dataclass(frozen=True, kw_only=True)
class ByHand:
    """Least energy [J], the time at the end of each leg [s], and the mesh's states."""

    energy_J: float
    passing_times_s: tuple[float, ...]

    @property
    def duration_s(self):
        return self.passing_times_s[-1]


def hovering(place):
    return np.concatenate([place, np.zeros(9), np.full(4, HOVER_SPEED)])


def solve_legs(
    places, *, elements, degree, guess, total=None, price=0.0, has_wind=False, is_quickest=False
):
    """Fly from hover at the first place through the others to hover at the last.

    `guess` is the duration of each leg; `total` fixes their sum.  The quickest flight counts no
    energy.
    """
    point = equations(has_wind=has_wind)
    nodes = casadi.collocation_points(degree, "radau")
    slope_weights, _, quadrature = casadi.collocation_coeff(nodes)
    program, energy, now = Program(), 0, 0
    states = [program.variable("x_0", STATE_SCALES, *(hovering(places[0]),) * 3)]
    times = []
    for leg, (here, there) in enumerate(itertools.pairwise(places)):
        one = np.ones(1)
        duration = program.variable(f"T_{leg}", one, 0.3 * one, 60.0 * one, guess[leg] * one)
        h = duration / elements
        for e in range(elements):
            states, controls = states[-1:], []
            for j, node in enumerate(nodes):
                fraction = (e + node) / elements
                lower, upper = STATE_FLOORS.copy(), STATE_LIMITS.copy()
                near = hovering(here) + (hovering(there) - hovering(here)) * fraction
                if e == elements - 1 and j == degree - 1:
                    held = slice(None) if leg == len(places) - 2 else slice(0, 3)
                    lower[held] = upper[held] = hovering(there)[held]
                name = f"{leg}_{e}_{j}"
                states.append(program.variable(f"x_{name}", STATE_SCALES, lower, upper, near))
                limit = np.full(4, ACCELERATION_MAX)
                controls.append(
                    program.variable(f"a_{name}", CONTROL_SCALES, -limit, limit, np.zeros(4))
                )
            stacked = casadi.horzcat(*states)
            for j, node in enumerate(nodes):
                slopes, power, limited = point(states[j + 1], controls[j], now + (e + node) * h)
                program.row((stacked @ slope_weights[:, j] - h * slopes) / STATE_SCALES)
                program.row(
                    limited / LIMITED_SCALES,
                    LIMITED_MIN / LIMITED_SCALES,
                    LIMITED_MAX / LIMITED_SCALES,
                )
                energy += h * quadrature[j] * power
        now = now + duration
        times.append(now)
    if total is not None:
        program.row(now, total, total)
    unknowns = casadi.vertcat(*program.variables)
    solver = casadi.nlpsol(
        "by_hand",
        "ipopt",
        {
            "x": unknowns,
            "f": now if is_quickest else energy + price * now,
            "g": casadi.vertcat(*program.rows),
        },
        {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False, "ipopt.tol": 1e-9},
    )
    found = solver(
        x0=np.concatenate(program.guess),
        lbx=np.concatenate(program.lower),
        ubx=np.concatenate(program.upper),
        lbg=np.concatenate(program.row_lower),
        ubg=np.concatenate(program.row_upper),
    )
    if not solver.stats()["success"]:
        raise RuntimeError(f"hand-written CasADi: {solver.stats()['return_status']}")
    read = casadi.Function("read", [unknowns], [energy, casadi.vertcat(*times)])
    spent, passed = read(found["x"])
    return ByHand(energy_J=float(spent), passing_times_s=tuple(passed.full().ravel().tolist()))
