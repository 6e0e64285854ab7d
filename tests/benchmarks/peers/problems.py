"""The problems that all peers solve, as data: no peer's own words are used.

Equations are functions of a name space `f` with `sin`, `cos` and the like, so that CasADi, Pyomo,
OpenMDAO and NumPy each read the same ones.  `best` is the published or closed form where there is
one, and otherwise this engine's optimum at 1e-9, of which the table says when a peer undercuts it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np

from tests.agreement import plain_quadrotor as quad

FREE = None
HOVER = float(np.sqrt(quad.MASS * quad.GRAVITY / (4 * quad.KB)))
SPEED_MAX = 10_000 * 2 * np.pi / 60


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Minimise an objective of the final states, the duration and an integral.

    Attributes
    ----------
    states : dict
        By name start, end (`FREE` for what is free), least and greatest value.
    controls : dict
        By name least and greatest value, and a first one.
    duration : tuple
        Least, greatest and first value; a fixed one has all three alike.
    rates : callable
        (f, states, controls) -> rates, in the order of the states.
    running : callable
        (f, states, controls) -> integrand.
    objective : callable
        (final states, duration, integral) -> what is minimised.
    path : callable, optional
        (f, states, controls) -> what must not be negative.
    ends : dict
        By name the first value of a free end, where it is not the start's.  From a body at rest all
        the way SLSQP does not solve the brachistochrone: the equations, linearised there at one
        angle, cannot reach both coordinates of the end.
    """

    states: dict
    controls: dict
    duration: tuple
    rates: Callable
    running: Callable = lambda _f, _x, _u: 0.0
    objective: Callable
    best: float
    path: Callable | None = None
    scales: dict = field(default_factory=dict)
    ends: dict = field(default_factory=dict)
    # Name of a state and how far its first guess bows aside of the straight line.
    bow: tuple = ("", 0.0)

    @property
    def is_free(self):
        """Whether the duration is free."""
        return self.duration[0] < self.duration[1]

    def scale(self, name):
        """Return the usual size of a state."""
        return self.scales.get(name, 1.0)

    def guess(self, share, f=np):
        """Return a first value of each state at a share of the horizon: a straight line."""
        found = []
        for name, (start, end, _low, _high) in self.states.items():
            last = self.ends.get(name, start) if end is FREE else end
            value = start + share * (last - start)
            aside = self.bow[1] * f.sin(np.pi * share) if name == self.bow[0] else 0.0
            found.append(value + aside)
        return found


def _named(symbols, names):
    """Return symbols by name, as attributes."""
    return SimpleNamespace(**dict(zip(names, symbols, strict=True)))


INF = float("inf")


def _quad_rates(f, x, u):
    """(6), (7), (9) and (1) of the paper in calm air."""
    vx, vy, vz, phi, theta, psi, p, q, r = x[3:12]
    omega = x[12:16]
    s1, s2, s3, s4 = (w * w for w in omega)
    thrust = quad.KB * (s1 + s2 + s3 + s4) / quad.MASS
    roll, pitch = quad.ARM * quad.KB * (s2 - s4), quad.ARM * quad.KB * (s3 - s1)
    yaw = quad.KAPPA * (s1 - s2 + s3 - s4)
    drum = quad.IR * (omega[0] - omega[1] + omega[2] - omega[3])
    Ix, Iy, Iz = (float(moment) for moment in np.diag(quad.INERTIA))
    c, s = f.cos, f.sin
    return [
        vx,
        vy,
        vz,
        (c(phi) * s(theta) * c(psi) + s(phi) * s(psi)) * thrust,
        (c(phi) * s(theta) * s(psi) - s(phi) * c(psi)) * thrust,
        c(phi) * c(theta) * thrust - quad.GRAVITY,
        p,
        q,
        r,
        ((Iy - Iz) * q * r + drum * q + roll) / Ix,
        ((Iz - Ix) * p * r - drum * p + pitch) / Iy,
        ((Ix - Iy) * p * q + yaw) / Iz,
        *(u[k] for k in range(4)),
    ]


def _quad_power(_f, x, u):
    """(3): electrical power of the four motors."""
    power = 0.0
    for k in range(4):
        current = (quad.IR * u[k] + quad.KAPPA * x[12 + k] * x[12 + k]) / quad.KT
        power = power + (quad.RESISTANCE * current + x[12 + k] / quad.KV) * current
    return power


def _quad(best, duration=(10.0, 10.0, 10.0), **more):
    goal = (6.0, 7.0, 8.0)
    places = {name: (0.0, end, -50.0, 50.0) for name, end in zip("xyz", goal, strict=True)}
    still = dict.fromkeys(("vx", "vy", "vz"), (0.0, 0.0, -50.0, 50.0))
    tilts = dict.fromkeys(("phi", "theta"), (0.0, 0.0, -np.pi / 2, np.pi / 2))
    turning = dict.fromkeys(("psi", "p", "q", "r"), (0.0, 0.0, -50.0, 50.0))
    rotors = {f"omega_{k}": (HOVER, HOVER, 0.0, SPEED_MAX) for k in range(1, 5)}
    sizes = dict.fromkeys(places, 8.0) | dict.fromkeys(rotors, HOVER)
    return Problem(
        states=places | still | tilts | turning | rotors,
        controls={f"alpha_{k}": (-3000.0, 3000.0, 0.0) for k in range(1, 5)},
        duration=duration,
        rates=_quad_rates,
        running=_quad_power,
        objective=lambda _x, _T, integral: integral,
        best=best,
        scales=sizes | dict.fromkeys((*still,), 1.0) | dict.fromkeys((*tilts, *turning), 0.1),
        **more,
    )


def _there_and_back(f, x, u):
    """Return rates of a first leg, and of how far it is from a second leg flown backwards.

    The second leg starts at the goal and has reversed rates, so that both legs end at the waypoint
    at one moment, and all that joins them is an end of zero: an optimiser of one phase can do it.
    """
    ahead = _quad_rates(f, x[:16], u[:4])
    back = _quad_rates(f, _second_leg(x), u[4:])
    return [*ahead, *(a + b for a, b in zip(ahead, back, strict=True))]


def _second_leg(x):
    return [x[k] - x[16 + k] for k in range(16)]


def _waypoint(place, best):
    """Return the paper's mission through a place at half of its time."""
    whole = _quad(best)
    goal = {name: end for name, (_, end, *_) in whole.states.items() if name in "xyz"}
    states = {
        name: (start, FREE, low, high) for name, (start, _, low, high) in whole.states.items()
    }
    for name, value in zip("xyz", place, strict=True):
        states[name] = (0.0, value, -50.0, 50.0)
    gaps = {f"gap_{name}": (-goal.get(name, 0.0), 0.0, -SPEED_MAX, SPEED_MAX) for name in states}
    backward = {f"back_{name}": limits for name, limits in whole.controls.items()}
    sizes = whole.scales | {f"gap_{name}": size for name, size in whole.scales.items()}
    half = whole.duration[2] / 2
    return Problem(
        states=states | gaps,
        controls=whole.controls | backward,
        duration=(half, half, half),
        rates=_there_and_back,
        running=lambda f, x, u: _quad_power(f, x, u[:4]) + _quad_power(f, _second_leg(x), u[4:]),
        objective=whole.objective,
        best=best,
        scales=sizes,
        ends={f"v{name}": value / whole.duration[2] for name, value in goal.items()},
    )


def _simple(states, controls, duration, rates, objective, best, **more):
    """Return a problem whose rates and integrand take states and controls by name."""
    names = tuple(states), tuple(controls)

    def by_name(function):
        return lambda f, x, u: function(f, _named(x, names[0]), _named(u, names[1]))

    if "running" in more:
        more["running"] = by_name(more["running"])
    return Problem(
        states=states,
        controls=controls,
        duration=duration,
        rates=by_name(rates),
        objective=objective,
        best=best,
        **more,
    )


def _duration(_x, T, _integral):
    return T


def _integral(_x, _T, integral):
    return integral


# The quickest first, for a run may be stopped.
PROBLEMS = {
    "brachistochrone": _simple(
        {"x": (0, 10, 0, 20), "y": (0, 5, 0, 20), "v": (0, FREE, 0, 30)},
        {"angle": (0, np.pi, 0.8)},
        (0.1, 10, 2),
        lambda f, x, u: [x.v * f.sin(u.angle), x.v * f.cos(u.angle), 9.80665 * f.cos(u.angle)],
        _duration,
        1.8016031224531,
        ends={"v": 10},
    ),
    "Bryson-Denham": _simple(
        {"x": (0, 0, -1, 1 / 9), "v": (1, -1, -5, 5)},
        {"u": (-20, 20, 0)},
        (1, 1, 1),
        lambda _f, x, u: [x.v, u.u],
        _integral,
        4.0,
        running=lambda _f, _x, u: u.u * u.u / 2,
    ),
    "oscillator": _simple(
        {"x": (1, 0, -5, 5), "v": (0, 0, -5, 5)},
        {"u": (-1, 1, 0)},
        (0.5, 5, 2),
        lambda _f, x, u: [x.v, u.u - x.x],
        _duration,
        1.8234765819369754,
    ),
    "soft landing": _simple(
        {"h": (10, 0, 0, 20), "v": (-2, 0, -20, 20)},
        {"u": (0, 3, 1.5)},
        (1, 10, 4),
        lambda _f, x, u: [x.v, u.u - 1.5],
        _integral,
        8.246211251235321,
        running=lambda _f, _x, u: u.u,
    ),
    "moon landing": _simple(
        {"h": (1, 0, -1, 5), "v": (-0.783, 0, -5, 5), "mass": (1, FREE, 0.1, 1)},
        {"u": (0, 1.227, 0.6)},
        (0.5, 10, 1.5),
        lambda _f, x, u: [x.v, u.u / x.mass - 1, -u.u / 2.349],
        _integral,
        1.4203125990491978,
        running=lambda _f, _x, u: u.u,
    ),
    "Zermelo": _simple(
        {"x": (3.66, 0, -10, 10), "y": (-1.86, 0, -10, 10)},
        {"heading": (-7, 7, 3.0)},
        (0.1, 20, 5),
        lambda f, x, u: [f.cos(u.heading) - x.y, f.sin(u.heading)],
        _duration,
        5.457865263560505,
    ),
    "catalyst mixing": _simple(
        {"a": (1, FREE, 0, 1), "b": (0, FREE, 0, 1)},
        {"u": (0, 1, 0.5)},
        (1, 1, 1),
        lambda _f, x, u: [
            u.u * (10 * x.b - x.a),
            u.u * (x.a - 10 * x.b) - (1 - u.u) * x.b,
        ],
        lambda x, _T, _integral: x[0] + x[1] - 1,
        -0.0480556858,
    ),
    "parallel reactions": _simple(
        {"a": (1, FREE, 0, 1), "b": (0, FREE, 0, 1)},
        {"u": (0, 5, 1)},
        (1, 1, 1),
        lambda _f, x, u: [-(u.u + u.u * u.u / 2) * x.a, u.u * x.a],
        lambda x, _T, _integral: -x[1],
        -0.57354506,
    ),
    "container crane": _simple(
        {
            "x": (0, 10, -20, 20),
            "rope": (22, 14, 1, 40),
            "swing": (0, 0, -2, 2),
            "vx": (0, 2.5, -2.5, 2.5),
            "hoist": (-1, 0, -1, 1),
            "spin": (0, 0, -5, 5),
        },
        {"u": (-2.83374, 2.83374, 0), "w": (-0.80865, 0.71265, 0)},
        (9, 9, 9),
        lambda _f, x, u: [
            x.vx,
            x.hoist,
            x.spin,
            u.u + 17.2656 * x.swing,
            u.w,
            -(u.u + 27.0756 * x.swing + 2 * x.hoist * x.spin) / x.rope,
        ],
        _integral,
        0.0375195,
        running=lambda _f, x, u: (
            (x.swing * x.swing + x.spin * x.spin + 0.01 * (u.u * u.u + u.w * u.w)) / 2
        ),
    ),
    "ducted fan": _simple(
        {
            "x": (0, 1, -5, 5),
            "y": (0, 0, -5, 5),
            "tilt": (0, 0, -np.pi / 6, np.pi / 6),
            "vx": (0, 0, -10, 10),
            "vy": (0, 0, -10, 10),
            "spin": (0, 0, -50, 50),
        },
        {"u": (-5, 5, 0), "w": (0, 17, 4)},
        (0.1, 10, 1),
        lambda f, x, u: [
            x.vx,
            x.vy,
            x.spin,
            (u.u * f.cos(x.tilt) - u.w * f.sin(x.tilt)) / 2.2,
            (u.u * f.sin(x.tilt) + u.w * f.cos(x.tilt) - 4.0) / 2.2,
            0.2 * u.u / 0.05,
        ],
        lambda _x, T, integral: integral / T + 1000 * T,
        1831.6092,
        running=lambda _f, _x, u: 2 * u.u * u.u + u.w * u.w,
    ),
    "the paper's mission": _quad(709.65279),
    "the same, free time": _quad(303.28429, (1.0, 30.0, 6.0)),
    "the same, a mast in the way": _quad(
        709.797305,
        path=lambda _f, x, _u: [(x[0] - 3.0) ** 2 + (x[1] - 3.5) ** 2 - 1.0],
        bow=("y", 2.0),
    ),
    "the same, a waypoint halfway": _waypoint((5.0, 2.0, 5.0), 710.6158835),
}
