"""Rockets, orbits, gliders and aircraft."""

import numpy as np
from pyomo.environ import Constraint, cos, exp, sin, sqrt, tan

from tests.problems.published.statement import Case, guessed, maximised, minimised, posed

COPS = "Dolan, More and Munson (2004), COPS 3.0, ANL/MCS-TM-273"
PSOPT = "PSOPT 5, doc/SQP_ALL_EXAMPLES.csv"
BETTS = "Betts (2010), Practical Methods for Optimal Control"


def goddard():
    def rates(m, t):
        drag = 310 * m.v[t] ** 2 * exp(-500 * (m.h[t] - 1))
        return {
            "h": m.v[t],
            "v": (m.u[t] - drag) / m.mass[t] - 1 / m.h[t] ** 2,
            "mass": -2 * m.u[t],
        }

    m = posed(
        "Goddard",
        {"h": (1, None, 1, 1.1), "v": (0, None, 0, 0.3), "mass": (1, 0.6, 0.6, 1)},
        {"u": (0, 3.5)},
        rates,
        free=(0.05, 1, 0.2),
    )
    guessed(m, h=lambda s: 1 + 0.01 * s, v=lambda s: 0.4 * s * (1 - s))
    return maximised(m, m.h[1])


def hang_glider():
    def rates(m, t):
        ratio = (m.x[t] / 100 - 2.5) ** 2
        sink = m.vy[t] - 2.5 * (1 - ratio) * exp(-ratio)
        speed = sqrt(m.vx[t] ** 2 + sink**2)
        pressure = 0.5 * 1.13 * 14 * speed**2
        lift = m.lift[t] * pressure
        drag = (0.034 + 0.069662 * m.lift[t] ** 2) * pressure
        return {
            "x": m.vx[t],
            "y": m.vy[t],
            "vx": (-lift * sink - drag * m.vx[t]) / speed / 100,
            "vy": (lift * m.vx[t] - drag * sink) / speed / 100 - 9.81,
        }

    m = posed(
        "hang glider",
        {
            "x": (0, None, 0, 2000),
            "y": (1000, 900),
            "vx": (13.23, 13.23, 1, 50),
            "vy": (-1.288, -1.288),
        },
        {"lift": (0, 1.4, 1.0)},
        rates,
        free=(10, 200, 100),
    )
    guessed(m, x=lambda s: 1250 * s)
    return maximised(m, m.x[1])


def orbit_raising():
    def rates(m, t):
        push = 0.1405 / (1 - 0.0749 * t)
        return {
            "r": m.u[t],
            "u": m.v[t] ** 2 / m.r[t] - 1 / m.r[t] ** 2 + push * sin(m.angle[t]),
            "v": -m.u[t] * m.v[t] / m.r[t] + push * cos(m.angle[t]),
        }

    m = posed(
        "orbit raising",
        {"r": (1, None, 0.9, 2), "u": (0, 0, -1, 1), "v": (1, None, 0, 2)},
        {"angle": (-1, 7, 1)},
        rates,
        end=3.32,
    )
    guessed(m, r=lambda s: 1 + 0.5 * s, v=lambda s: 1 - 0.2 * s, angle=lambda s: 0.5 + 5 * s)
    m.circular = Constraint(expr=m.v[3.32] ** 2 * m.r[3.32] == 1)
    return maximised(m, m.r[3.32])


def orbit_raising_by_direction():
    """The same by components of a unit vector, from YAPSS' guess: a way that leaves nothing out."""

    def rates(m, t):
        push = 0.1405 / (1 - 0.0749 * t)
        return {
            "r": m.u[t],
            "theta": m.v[t] / m.r[t],
            "u": m.v[t] ** 2 / m.r[t] - 1 / m.r[t] ** 2 + push * m.outward[t],
            "v": -m.u[t] * m.v[t] / m.r[t] + push * m.along[t],
        }

    m = posed(
        "orbit raising",
        {
            "r": (1, None, 1, 10),
            "theta": (0, None, -np.pi, np.pi),
            "u": (0, 0, -10, 10),
            "v": (1, None, -np.pi, np.pi),
        },
        {"outward": (-1.1, 1.1), "along": (-1.1, 1.1)},
        rates,
        end=3.32,
    )
    guessed(
        m,
        r=lambda s: 1 + 0.5 * s,
        theta=lambda s: np.pi * s,
        v=lambda s: 1 - 0.5 * s,
        outward=lambda s: s,
        along=lambda s: 1 - s,
    )
    m.unit = Constraint(m.t, rule=lambda m, t: m.outward[t] ** 2 + m.along[t] ** 2 == 1)
    m.circular = Constraint(expr=m.v[3.32] == sqrt(1 / m.r[3.32]))
    return maximised(m, m.r[3.32])


def reentry():
    degree = np.pi / 180

    def rates(m, t):
        alpha = m.alpha[t] / degree
        height, speed = m.h[t] * 1e5, m.v[t] * 1e4
        radius = 20902900 + height
        gravity = 0.14076539e17 / radius**2
        pressure = 0.5 * 0.002378 * exp(-height / 23800) * speed**2
        mass = 203000 / 32.174
        drag = pressure * 2690 * (0.07854 - 6.1592e-3 * alpha + 6.21408e-4 * alpha**2)
        lift = pressure * 2690 * (-0.20704 + 0.029244 * alpha)
        climb, turn, latitude = m.gamma[t], m.psi[t], m.theta[t]
        return {
            "h": speed * sin(climb) / 1e5,
            "theta": speed / radius * cos(climb) * cos(turn),
            "v": (-drag / mass - gravity * sin(climb)) / 1e4,
            "gamma": lift / mass / speed * cos(m.beta[t])
            + cos(climb) * (speed / radius - gravity / speed),
            "psi": lift * sin(m.beta[t]) / (mass * speed * cos(climb))
            + speed / radius * cos(climb) * sin(turn) * tan(latitude),
        }

    m = posed(
        "re-entry",
        {
            "h": (2.6, 0.8, 0, 3),
            "theta": (0, None, -89 * degree, 89 * degree),
            "v": (2.56, 0.25, 0.1, 3),
            "gamma": (-degree, -5 * degree, -89 * degree, 89 * degree),
            "psi": (90 * degree, None, -np.pi, np.pi),
        },
        {"alpha": (-90 * degree, 90 * degree, 0.3), "beta": (-89 * degree, degree, -0.8)},
        rates,
        free=(500, 4000, 2000),
    )
    guessed(m, theta=lambda s: 0.4 * s, psi=lambda s: 1.57 * (1 - s))
    return maximised(m, m.theta[1] / degree)


def f8():
    def rates(m, t):
        x, y, z, w = m.x[t], m.y[t], m.z[t], m.w[t]
        return {
            "x": -0.877 * x
            + z
            - 0.088 * x * z
            + 0.47 * x**2
            - 0.019 * y**2
            - x**2 * z
            + 3.846 * x**3
            - 0.215 * w
            + 0.28 * x**2 * w
            + 0.47 * x * w**2
            + 0.63 * w**3,
            "y": z,
            "z": -4.208 * x
            - 0.396 * z
            - 0.47 * x**2
            - 3.564 * x**3
            - 20.967 * w
            + 6.265 * x**2 * w
            + 46 * x * w**2
            + 61.4 * w**3,
        }

    m = posed(
        "F-8",
        {"x": (0.4655, 0), "y": (0, 0), "z": (0, 0)},
        {"w": (-0.05236, 0.05236)},
        rates,
        free=(1, 10, 3.8),
    )
    return minimised(m, m.T)


def dynamic_soaring():
    """The gradient of wind that just keeps a glider up, in a round; nothing is guessed."""
    degree = np.pi / 180
    area, mass, gravity = 45.09703, 5.6, 32.2
    air = 0.002378 * area / 2 / mass

    def rates(m, t):
        v, climb, turn, gradient = m.v[t], m.climb[t], m.turn[t], m.gradient[t]
        lift = air * m.lift[t] * v
        drag = air * (0.00873 + 0.045 * m.lift[t] ** 2) * v**2
        gust = gradient * sin(climb)
        return {
            "x": v * cos(climb) * sin(turn) + gradient * m.h[t],
            "y": v * cos(climb) * cos(turn),
            "h": v * sin(climb),
            "v": -drag - gravity * sin(climb) - gust * v * sin(turn) * cos(climb),
            "climb": lift * cos(m.bank[t])
            - gravity * cos(climb) / v
            + gust * sin(turn) * sin(climb),
            "turn": (lift * sin(m.bank[t]) - gust * cos(turn)) / cos(climb),
            "gradient": 0,
        }

    m = posed(
        "dynamic soaring",
        {
            "x": (0, 0, -1500, 1500),
            "y": (0, 0, -1000, 1000),
            "h": (0, 0, 0, 1000),
            "v": (None, None, 10, 350),
            "climb": (None, None, -75 * degree, 75 * degree),
            "turn": (None, None, -3 * np.pi, np.pi / 2),
            "gradient": (None, None, 0.005, 0.15),
        },
        {"lift": (0, 1.5), "bank": (-75 * degree, 75 * degree)},
        rates,
        free=(10, 30, 24),
    )
    m.load_limit = Constraint(
        m.t, rule=lambda m, t: (-2, air / gravity * m.lift[t] * m.v[t] ** 2, 5)
    )
    for state, turned in ((m.v, 0), (m.climb, 0), (m.turn, -2 * np.pi)):
        m.add_component(f"{state.name}_again", Constraint(expr=state[1] == state[0] + turned))
    return minimised(m, m.gradient[1])


CASES = (
    Case(name="one_phase_goddard", build=goddard, published="1.0128", source=COPS),
    Case(name="hang_glider", build=hang_glider, published="1248.0", source=COPS),
    Case(
        name="orbit_raising",
        build=orbit_raising,
        published="1.525",
        source="Bryson and Ho (1975), section 2.5, after Moyer and Pinkham (1964)",
    ),
    Case(
        name="orbit_by_direction",
        build=orbit_raising_by_direction,
        published="1.5252777",
        source="YAPSS, tests/examples/test_orbit_raising.py",
    ),
    Case(
        name="dynamic_soaring",
        build=dynamic_soaring,
        published="0.063587",
        source="YAPSS, tests/examples/test_dynamic_soaring.py, after Zhao (2004), OCAM 25",
    ),
    Case(name="reentry", build=reentry, published="34.1412", source=BETTS),
    Case(name="f8", build=f8, published="3.78086", source=PSOPT, starts=6),
)
