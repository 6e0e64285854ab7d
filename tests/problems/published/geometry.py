"""Shortest, lowest and smallest curves, and ways between obstacles."""

import numpy as np
from pyomo.dae import Integral
from pyomo.environ import Constraint, cos, sin, sqrt
from scipy.optimize import brentq, fsolve

from tests.problems.published.statement import Case, guessed, minimised, posed, total

COPS = "Dolan, More and Munson (2004), COPS 3.0, ANL/MCS-TM-273"


def hanging_chain():
    m = posed("hanging chain", {"y": (1, 3, 0, 10)}, {"u": (-10, 20)}, lambda m, t: {"y": m.u[t]})
    guessed(m, u=lambda s: 8 * s - 2, y=lambda s: 4 * s**2 - 2 * s + 1)
    m.length = Integral(m.t, wrt=m.t, rule=lambda m, t: sqrt(1 + m.u[t] ** 2))
    m.rope = Constraint(expr=m.length == 4)
    return minimised(m, total(m, lambda m, t: m.y[t] * sqrt(1 + m.u[t] ** 2)))


def _chain_energy():
    """A catenary y = b + c cosh((t - a) / c) through (0, 1) and (1, 3), 4 long."""

    def misses(unknown):
        a, b, c = unknown
        return [
            b + c * np.cosh(a / c) - 1,
            b + c * np.cosh((1 - a) / c) - 3,
            c * (np.sinh((1 - a) / c) + np.sinh(a / c)) - 4,
        ]

    a, b, c = fsolve(misses, [0.3, 0.5, 0.2], xtol=1e-12)
    up, down = (1 - a) / c, -a / c
    area = 0.5 * c * (up - down) + 0.25 * c * (np.sinh(2 * up) - np.sinh(2 * down))
    return float(b * c * (np.sinh(up) - np.sinh(down)) + c * area)


def soap_film():
    m = posed("soap film", {"y": (1, 1, 0.1, 3)}, {"u": (-3, 3)}, lambda m, t: {"y": m.u[t]})
    return minimised(m, total(m, lambda m, t: 2 * np.pi * m.y[t] * sqrt(1 + m.u[t] ** 2)))


def _soap_area():
    c = brentq(lambda c: c * np.cosh(0.5 / c) - 1, 0.5, 2, xtol=1e-15)
    return float(np.pi * c * (1 + c * np.sinh(1 / c)))


LONGITUDE, LATITUDES = 1.8, (0.3, 0.9)


def great_circle():
    m = posed(
        "great circle",
        {"latitude": (*LATITUDES, -1.4, 1.4)},
        {"u": (-5, 5)},
        lambda m, t: {"latitude": m.u[t]},
        end=LONGITUDE,
    )
    return minimised(m, total(m, lambda m, t: sqrt(m.u[t] ** 2 + cos(m.latitude[t]) ** 2)))


def _great_circle_length():
    first, last = LATITUDES
    across = np.cos(first) * np.cos(last) * np.cos(LONGITUDE)
    return float(np.arccos(np.sin(first) * np.sin(last) + across))


def embedded_great_circle():
    """The sphere is a path equation of index 2, and nothing is said of the way along it."""
    ends = np.array([[1.0, 0.0, 0.0], EMBEDDED_END])
    m = posed(
        "great circle in space",
        {axis: tuple(map(float, ends[:, k])) for k, axis in enumerate("xyz")},
        {f"v{axis}": (None, None) for axis in "xyz"},
        lambda m, t: {axis: m.component(f"v{axis}")[t] for axis in "xyz"},
    )
    m.sphere = Constraint(m.t, rule=lambda m, t: m.x[t] ** 2 + m.y[t] ** 2 + m.z[t] ** 2 == 1)
    return minimised(m, total(m, lambda m, t: m.vx[t] ** 2 + m.vy[t] ** 2 + m.vz[t] ** 2))


# On the sphere, 2 rad east and 0.5 rad north of the start.
EMBEDDED_END = np.array([np.cos(2.0) * np.cos(0.5), np.sin(2.0) * np.cos(0.5), np.sin(0.5)])


def geodesic():
    """From New York to London on a spheroid, by headings in space, in 1000 km, without a guess."""
    wide, high = 6.384, 6.353

    def place(north, east):
        north, east = np.radians(north), np.radians(east)
        around = wide * np.cos(north)
        return tuple(
            map(float, (around * np.cos(east), around * np.sin(east), high * np.sin(north)))
        )

    ends = zip(place(40.6413, -73.7781), place(51.47, -0.4543), strict=True)
    m = posed(
        "geodesic",
        dict(zip("xyz", ends, strict=True)),
        {"tilt": (0, np.pi), "turn": (-np.pi, np.pi)},
        lambda m, t: {
            "x": sin(m.tilt[t]) * cos(m.turn[t]),
            "y": sin(m.tilt[t]) * sin(m.turn[t]),
            "z": cos(m.tilt[t]),
        },
        free=(3, 10, 6),
    )
    m.spheroid = Constraint(
        m.t,
        rule=lambda m, t: (m.x[t] ** 2 + m.y[t] ** 2) / wide**2 + m.z[t] ** 2 / high**2 == 1,
    )
    return minimised(m, m.T)


def zermelo():
    m = posed(
        "Zermelo",
        {"x": (3.66, 0), "y": (-1.86, 0)},
        {"heading": (-7, 7)},
        lambda m, t: {"x": cos(m.heading[t]) - m.y[t], "y": sin(m.heading[t])},
        free=(0.1, 20, 5),
    )
    guessed(m, heading=lambda s: 1.8 + 2.4 * s)
    return minimised(m, m.T)


def _zermelo_time():
    """Bryson and Ho: with a stream -y the tangent of the heading grows by 1 in a unit of time."""

    def misses(angles):
        a, b = angles
        sec_a, sec_b, tan_a, tan_b = 1 / np.cos(a), 1 / np.cos(b), np.tan(a), np.tan(b)
        along = sec_b * (tan_b - tan_a) - tan_a * (sec_b - sec_a)
        along += np.log(abs((tan_b + sec_b) / (tan_a + sec_a)))
        return [sec_a - sec_b + 1.86, along / 2 + 3.66]

    a, b = fsolve(misses, np.radians([105.0, 240.0]), xtol=1e-12)
    return float(np.tan(b) - np.tan(a))


CASES = (
    Case(name="hanging_chain", build=hanging_chain, published=_chain_energy(), source=COPS),
    Case(name="soap_film", build=soap_film, published=_soap_area(), source="catenoid"),
    Case(
        name="great_circle",
        build=great_circle,
        published=_great_circle_length(),
        source="spherical law of cosines",
    ),
    Case(
        name="embedded_circle",
        build=embedded_great_circle,
        published=float(np.arccos(EMBEDDED_END[0]) ** 2),
        source="the angle between the ends, squared",
    ),
    Case(
        name="geodesic",
        build=geodesic,
        published="5.5496819",
        source="PSOPT 5, examples/geodesic: the exact geodesic",
    ),
    Case(
        name="zermelo",
        build=zermelo,
        published=_zermelo_time(),
        source="Bryson and Ho (1975), section 2.7",
    ),
)
