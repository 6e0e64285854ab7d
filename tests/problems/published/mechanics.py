"""Masses, springs, arms, cranes and landers."""

import numpy as np
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, RangeSet, Var, cos, exp, log, sin
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, minimize_scalar

from tests.problems.published.statement import (
    Case,
    guessed,
    maximised,
    minimised,
    posed,
    total,
)

COPS = "Dolan, More and Munson (2004), COPS 3.0, ANL/MCS-TM-273"
PSOPT = "PSOPT 5, doc/SQP_ALL_EXAMPLES.csv"


def oscillator():
    m = posed(
        "oscillator",
        {"x": (1, 0), "v": (0, 0)},
        {"u": (-1, 1)},
        lambda m, t: {"x": m.v[t], "v": m.u[t] - m.x[t]},
        free=(0.5, 5, 2),
    )
    return minimised(m, m.T)


def soft_landing():
    m = posed(
        "soft landing",
        {"h": (10, 0), "v": (-2, 0)},
        {"u": (0, 3)},
        lambda m, t: {"h": m.v[t], "v": m.u[t] - 1.5},
        free=(1, 10, 4),
    )
    return minimised(m, total(m, lambda m, t: m.T * m.u[t]))


def _landing_fuel():
    """Fall freely for s, then brake with 3 for (2 + 1.5 s) / 1.5."""
    # 10 - 2 s - 0.75 s^2 = (2 + 1.5 s)^2 / 3
    s = max(np.roots([1.5, 4.0, 4 / 3 - 10]))
    return float(2 * (2 + 1.5 * s))


def moon_landing():
    m = posed(
        "moon landing",
        {"h": (1, 0), "v": (-0.783, 0), "mass": (1, None, 0.1, 1)},
        {"u": (0, 1.227)},
        lambda m, t: {"h": m.v[t], "v": m.u[t] / m.mass[t] - 1, "mass": -m.u[t] / 2.349},
        free=(0.5, 10, 1.5),
    )
    guessed(m, mass=lambda s: 1 - 0.5 * s)
    return minimised(m, total(m, lambda m, t: m.T * m.u[t]))


def _moon_fuel():
    """Fall freely for s, then brake with full thrust, whose burn follows Tsiolkovsky's equation."""
    thrust, exhaust = 1.227, 2.349

    def burn(s):
        # v = -exhaust log(mass) - t - what gravity gave; the burn ends when it vanishes.
        fall = 0.783 + s
        return brentq(
            lambda b: -exhaust * np.log(1 - thrust * b / exhaust) - b - fall, 0.01, 1.85, xtol=1e-15
        )

    def miss(s):
        b, fall = burn(s), 0.783 + s
        height = 1 - 0.783 * s - s**2 / 2
        left = 1 - thrust * b / exhaust
        gained = exhaust * (b + exhaust / thrust * left * np.log(left))
        return height - fall * b - b**2 / 2 + gained

    return float(thrust * burn(brentq(miss, 0.0, 0.8, xtol=1e-15)))


def fuel_optimal():
    m = posed(
        "fuel optimal",
        {"x": (0, 1), "v": (0, 0)},
        {"push": (0, 1), "brake": (0, 1)},
        lambda m, t: {"x": m.v[t], "v": m.push[t] - m.brake[t]},
        end=4,
    )
    return minimised(m, total(m, lambda m, t: m.push[t] + m.brake[t]))


def robot_arm():
    def rates(m, t):
        by_latitude = ((5 - m.rho[t]) ** 3 + m.rho[t] ** 3) / 3
        return {
            "rho": m.rho_rate[t],
            "theta": m.theta_rate[t],
            "phi": m.phi_rate[t],
            "rho_rate": m.u_rho[t] / 5,
            "theta_rate": m.u_theta[t] / (by_latitude * sin(m.phi[t]) ** 2),
            "phi_rate": m.u_phi[t] / by_latitude,
        }

    m = posed(
        "robot arm",
        {
            "rho": (4.5, 4.5, 0, 5),
            "theta": (0, 2 * np.pi / 3, -np.pi, np.pi),
            "phi": (np.pi / 4, np.pi / 4, 0, np.pi),
            "rho_rate": (0, 0),
            "theta_rate": (0, 0),
            "phi_rate": (0, 0),
        },
        {f"u_{name}": (-1, 1) for name in ("rho", "theta", "phi")},
        rates,
        free=(1, 20, 10),
    )
    return minimised(m, m.T)


def two_link_arm():
    def rates(m, t):
        c, s = cos(m.elbow[t]), sin(m.elbow[t])
        first, second, u, w = m.a[t], m.b[t], m.u[t], m.w[t]
        one = s * (9 / 4 * c * first**2 + 2 * second**2) + 4 / 3 * (u - w) - 3 / 2 * c * w
        two = -(s * (7 / 2 * first**2 + 9 / 4 * c * second**2) - 7 / 3 * w + 3 / 2 * c * (u - w))
        below = 31 / 36 + 9 / 4 * s**2
        return {"a": one / below, "b": two / below, "elbow": second - first, "shoulder": first}

    m = posed(
        "two-link arm",
        {
            "a": (0, 0, -2, 2),
            "b": (0, 0, -2, 2),
            "elbow": (0.5, 0.5, -2, 2),
            "shoulder": (0, 0.522, -2, 2),
        },
        {"u": (-1, 1), "w": (-1, 1)},
        rates,
        free=(1, 10, 3),
    )
    return minimised(m, m.T)


def fuller():
    """Switches without end, at intervals that shrink, until the singular arc of order 2."""
    m = posed(
        "Fuller",
        {"x": (0, 0), "v": (1, 0)},
        {"u": (-1, 1)},
        lambda m, t: {"x": m.v[t], "v": m.u[t]},
        end=3.5,
    )
    return minimised(m, total(m, lambda m, t: m.x[t] ** 2))


def _fuller_cost():
    """Each pair of arcs, to x = c v |v| and on to x = 0, is the last one at a smaller scale."""
    c = np.sqrt((np.sqrt(33) - 1) / 24)
    turn = 1 / np.sqrt(1 + 2 * c)
    back = turn * np.sqrt(1 - 2 * c)
    out = np.polynomial.Polynomial([0, 1, -0.5])
    home = np.polynomial.Polynomial([c * turn**2, -turn, 0.5])
    pair = (out**2).integ()(1 + turn) + (home**2).integ()(turn - back)
    return float(pair / (1 - back**5))


def alp_rider():
    """Over a terrain that rises four times, a curved limit on fast and slow states together.

    Betts (2010) has 2030.85609, as opty's example of it says; 3,200 and 6,400 even elements of
    degree 4 give 2030.85523 and 2030.85566.  The controls that a refinement ends with, flown by
    SciPy, keep the limit at less: they follow the steep start, of half a hundredth of a second.
    """

    def square(m, t):
        return m.a[t] ** 2 + m.b[t] ** 2 + m.c[t] ** 2 + m.d[t] ** 2

    def terrain(t):
        peaks = ((3, 3, 12), (3, 6, 10), (3, 10, 6), (8, 15, 4))
        return 0.01 + sum(height * exp(-steep * (t - at) ** 2) for height, at, steep in peaks)

    m = posed(
        "alp rider",
        {"a": (2, 2), "b": (1, 3), "c": (2, 1), "d": (1, -2)},
        {"u": (None, None, 0), "w": (None, None, 0)},
        lambda m, t: {
            "a": -10 * m.a[t] + m.u[t] + m.w[t],
            "b": -2 * m.b[t] + m.u[t] + 2 * m.w[t],
            "c": -3 * m.c[t] + 5 * m.d[t] + m.u[t] - m.w[t],
            "d": 5 * m.c[t] - 3 * m.d[t] + m.u[t] + 3 * m.w[t],
        },
        end=20,
    )
    m.above = Constraint(m.t, rule=lambda m, t: square(m, t) >= terrain(t))
    cost = total(m, lambda m, t: 100 * square(m, t) + 0.01 * (m.u[t] ** 2 + m.w[t] ** 2))
    return minimised(m, cost)


def container_crane(effort=0.01):
    m = posed(
        "container crane",
        {
            "x": (0, 10),
            "rope": (22, 14),
            "swing": (0, 0),
            "vx": (0, 2.5, -2.5, 2.5),
            "hoist": (-1, 0, -1, 1),
            "spin": (0, 0),
        },
        {"u": (-2.83374, 2.83374), "w": (-0.80865, 0.71265)},
        lambda m, t: {
            "x": m.vx[t],
            "rope": m.hoist[t],
            "swing": m.spin[t],
            "vx": m.u[t] + 17.2656 * m.swing[t],
            "hoist": m.w[t],
            "spin": -(m.u[t] + 27.0756 * m.swing[t] + 2 * m.hoist[t] * m.spin[t]) / m.rope[t],
        },
        end=9,
    )

    def cost(m, t):
        efforts = effort * (m.u[t] ** 2 + m.w[t] ** 2)
        return (m.swing[t] ** 2 + m.spin[t] ** 2 + efforts) / 2

    return minimised(m, total(m, cost))


def free_flying_robot():
    def rates(m, t):
        left, right = m.u1[t] - m.u2[t], m.u3[t] - m.u4[t]
        return {
            "x": m.vx[t],
            "y": m.vy[t],
            "theta": m.spin[t],
            "vx": (left + right) * cos(m.theta[t]),
            "vy": (left + right) * sin(m.theta[t]),
            "spin": 0.2 * left - 0.2 * right,
        }

    still = dict.fromkeys(("vx", "vy", "spin"), (0, 0))
    m = posed(
        "free-flying robot",
        {"x": (-10, 0), "y": (-10, 0), "theta": (np.pi / 2, 0)} | still,
        {f"u{k}": (0, 1) for k in (1, 2, 3, 4)},
        rates,
        end=12,
    )
    m.left = Constraint(m.t, rule=lambda m, t: m.u1[t] + m.u2[t] <= 1)
    m.right = Constraint(m.t, rule=lambda m, t: m.u3[t] + m.u4[t] <= 1)
    return minimised(m, total(m, lambda m, t: m.u1[t] + m.u2[t] + m.u3[t] + m.u4[t]))


def cubic_hyper_sensitive():
    m = posed(
        "cubic hyper-sensitive",
        {"x": (1.5, 1)},
        {"u": (-50, 50)},
        lambda m, t: {"x": m.u[t] - m.x[t] ** 3},
        end=50,
    )
    return minimised(m, total(m, lambda m, t: (m.x[t] ** 2 + m.u[t] ** 2) / 2))


def rayleigh():
    m = posed(
        "Rayleigh",
        {"x": (-5, None, -10, 10), "v": (-5, None, -10, 10)},
        {"u": (-10, 10)},
        lambda m, t: {
            "x": m.v[t],
            "v": -m.x[t] + m.v[t] * (1.4 - 0.14 * m.v[t] ** 2) + 4 * m.u[t],
        },
        end=4.5,
    )
    m.current = Constraint(m.t, rule=lambda m, t: m.u[t] + m.x[t] / 6 <= 0)
    return minimised(m, total(m, lambda m, t: m.u[t] ** 2 + m.x[t] ** 2))


def van_der_pol(floor=None):
    m = posed(
        "van der Pol",
        {"x": (0, None) if floor is None else (0, None, floor, None), "y": (1, None)},
        {"u": (-0.3, 1)},
        lambda m, t: {
            "x": (1 - m.y[t] ** 2) * m.x[t] - m.y[t] + m.u[t],
            "y": m.x[t],
        },
        end=5,
    )
    return minimised(m, total(m, lambda m, t: m.x[t] ** 2 + m.y[t] ** 2 + m.u[t] ** 2))


def van_der_pol_above_a_floor():
    return van_der_pol(-0.4)


def isoperimetric():
    m = posed(
        "isoperimetric",
        {"x": (1, 0, -10, 10)},
        {"u": (-4, 4)},
        lambda m, t: {"x": m.u[t] - sin(m.x[t])},
    )
    m.effort = Integral(m.t, wrt=m.t, rule=lambda m, t: m.u[t] ** 2)
    m.budget = Constraint(expr=m.effort == 10)
    return minimised(m, total(m, lambda m, t: m.x[t]))


def aly_chan():
    m = posed(
        "Aly-Chan",
        {"x": (0, None), "v": (1, None)},
        {"u": (-1, 1)},
        lambda m, t: {"x": m.v[t], "v": m.u[t]},
        end=np.pi / 2,
    )
    return minimised(m, total(m, lambda m, t: (m.v[t] ** 2 - m.x[t] ** 2) / 2))


def interior_point():
    m = ConcreteModel(name="interior point")
    m.t = ContinuousSet(initialize=[0, 0.75, 1])
    m.x, m.u = Var(m.t), Var(m.t)
    m.dx = DerivativeVar(m.x, wrt=m.t)
    m.law = Constraint(m.t, rule=lambda m, t: m.dx[t] == m.u[t])
    for t, x in ((0, 1), (0.75, 0.9), (1, 0.75)):
        m.x[t].fix(x)
    return minimised(m, total(m, lambda m, t: m.x[t] ** 2 + m.u[t] ** 2))


def _interior_cost():
    """Between fixed values x'' = x, and the cost is x x' between the ends."""
    cost = 0.0
    for width, a, b in ((0.75, 1, 0.9), (0.25, 0.9, 0.75)):
        s, c = np.sinh(width), np.cosh(width)
        cost += ((a**2 + b**2) * c - 2 * a * b) / s
    return float(cost)


def logarithmic():
    m = posed(
        "logarithmic",
        {"y": (5, None, 0.05, 20)},
        {"u": (-20, 20)},
        lambda m, t: {"y": m.y[t] * log(m.y[t]) + m.y[t] * m.u[t]},
        end=5,
    )
    return minimised(m, total(m, lambda m, t: (log(m.y[t]) ** 2 + m.u[t] ** 2) / 2))


def _logarithmic_cost():
    """A linear regulator in log y: P' = P^2 - 2 P - 1, P(5) = 0."""
    p = 1 + np.sqrt(2) * np.tanh(5 * np.sqrt(2) + np.arctanh(-1 / np.sqrt(2)))
    return float(p * np.log(5) ** 2 / 2)


def hager():
    m = posed(
        "Hager",
        {"x": (1, None)},
        {"u": (-5, 5)},
        lambda m, t: {"x": 2.5 * (-m.x[t] + m.x[t] * m.u[t] - m.u[t] ** 2)},
        end=2,
    )
    guessed(m, x=lambda s: 1 - 0.5 * s, u=lambda s: 0.3)
    return maximised(m, m.x[2])


def complementary():
    """Betts' dynamic complementarity: y' = 2 - sign(y), its sign s with p, q >= 0 by a penalty."""
    m = posed(
        "complementarity",
        {"y": (-1, None, -10, 10)},
        {"s": (-1, 1), "p": (0, 10), "q": (0, 10)},
        lambda m, t: {"y": 2 - m.s[t]},
        end=2.0,
    )
    m.parts = Constraint(m.t, rule=lambda m, t: m.q[t] - m.p[t] == m.y[t])

    def running(m, t):
        left = m.p[t] * (m.s[t] + 1) + m.q[t] * (1 - m.s[t])
        return m.y[t] ** 2 + PENALTY * left

    return minimised(m, (m.y[2] - 5 / 3) ** 2 + total(m, running))


PENALTY = 1e3


def _complementary_cost():
    """The switch from s = -1 to 1 at y = -e: until then y grows by 3 in a unit of time, then by 1.

    All else is bang-bang: H is linear in s, with a slope that changes its sign once.
    """

    def cost(e):
        last = 5 / 3 - 2 * e / 3
        return (1 - e**3) / 9 + (last**3 + e**3) / 3 + PENALTY * e**2 + (last - 5 / 3) ** 2

    return float(minimize_scalar(cost, bounds=(0, 0.1), options={"xatol": 1e-12}).fun)


COMPLEMENTARY_COST = _complementary_cost()


def singular_control():
    """Luus' control whose square costs next to nothing, so that restarts find no end of gains."""
    m = posed(
        "singular control",
        {"x": (0, None), "y": (-1, None), "z": (-(5**0.5), None)},
        {"u": (0, 10)},
        lambda m, t: {
            "x": m.y[t],
            "y": -m.z[t] * m.u[t] + 16 * t - 8,
            "z": m.u[t],
        },
    )

    def running(m, t):
        bent = m.y[t] + 16 * t - 8 - 0.1 * m.z[t] * m.u[t] ** 2
        return m.x[t] ** 2 + m.y[t] ** 2 + 5e-4 * bent**2

    return minimised(m, total(m, running))


# Three equal masses on a figure of eight, with the digits of C. Simo.
PERIOD = 6.32591398
PLACE, SPEED = np.array([0.97000436, -0.24308753]), np.array([-0.93240737, -0.86473146])
PLACES = np.array([PLACE, -PLACE, 0 * PLACE])
SPEEDS = np.array([-SPEED / 2, -SPEED / 2, SPEED])


def three_bodies(start, duration):
    """Return the path of three equal masses over shares of a duration."""

    def rates(_, y):
        q, a = y[:6].reshape(3, 2), np.zeros((3, 2))
        for b in range(3):
            for o in {0, 1, 2} - {b}:
                a[b] += (q[o] - q[b]) / np.linalg.norm(q[o] - q[b]) ** 3
        return np.concatenate([y[6:], a.ravel()])

    path = solve_ivp(rates, (0, duration), start, rtol=1e-9, atol=1e-9, dense_output=True).sol
    return lambda share: path(duration * share)


def figure_eight():
    """The period of the orbit that begins at the published places, each end condition written out.

    Two bodies begin at the same speed.  Of the end conditions, two follow from the conserved
    momentum, others nearly from energy and angular momentum.
    """
    m = ConcreteModel(name="figure of eight")
    m.t = ContinuousSet(bounds=(0, 1))
    # Another closed orbit begins at these places, and takes 6.2908.
    m.T = Var(bounds=(6.3, 6.4), initialize=6.33)
    m.body, m.axis = RangeSet(0, 2), RangeSet(0, 1)
    path = three_bodies(np.concatenate([PLACES.ravel(), SPEEDS.ravel()]), PERIOD)
    m.q = Var(m.body, m.axis, m.t, initialize=lambda m, b, a, t: path(t)[2 * b + a])
    m.p = Var(m.body, m.axis, m.t, initialize=lambda m, b, a, t: path(t)[6 + 2 * b + a])
    m.dq, m.dp = DerivativeVar(m.q, wrt=m.t), DerivativeVar(m.p, wrt=m.t)

    @m.Constraint(m.body, m.axis, m.t)
    def motion(m, b, a, t):
        return m.dq[b, a, t] == m.p[b, a, t]

    @m.Constraint(m.body, m.axis, m.t)
    def gravity(m, b, a, t):
        def cubed(o):
            return sum((m.q[b, k, t] - m.q[o, k, t]) ** 2 for k in m.axis) ** 1.5

        others = (o for o in m.body if o != b)
        return m.dp[b, a, t] == sum((m.q[o, a, t] - m.q[b, a, t]) / cubed(o) for o in others)

    for name, state in (("q", m.q), ("p", m.p)):
        closed = Constraint(m.body, m.axis, rule=lambda m, b, a, s=state: s[b, a, 1] == s[b, a, 0])
        m.add_component(f"closed_{name}", closed)
    m.alike = Constraint(m.axis, rule=lambda m, a: m.p[0, a, 0] == m.p[1, a, 0])
    for b in m.body:
        for a in m.axis:
            m.q[b, a, 0].fix(PLACES[b, a])
    return minimised(m, m.T)


CASES = (
    Case(
        name="oscillator",
        build=oscillator,
        published=float(np.arccos(0.875) + np.arccos(0.25)),
        source="Pontryagin et al. (1962), section 1.5",
    ),
    Case(
        name="soft_landing",
        build=soft_landing,
        published=_landing_fuel(),
        source="GPOPS 4 manual, Moon lander",
    ),
    Case(
        name="moon_landing",
        build=moon_landing,
        published=_moon_fuel(),
        source="Meditch (1964), IEEE TAC 9",
    ),
    Case(
        name="fuel_optimal",
        build=fuel_optimal,
        published=4 - 2 * 3**0.5,
        source="Athans and Falb (1966), section 8.5",
    ),
    Case(name="robot_arm", build=robot_arm, published="9.141", source=COPS),
    Case(
        name="two_link_arm",
        build=two_link_arm,
        published="2.98",
        source="Luus (2000), section 12.4.2; PSOPT 5 has 2.988662 on its coarse mesh",
    ),
    Case(
        name="fuller",
        build=fuller,
        published=_fuller_cost(),
        source="Fuller (1963); BOCOP's examples have 0.268",
    ),
    Case(
        name="free_flying_robot",
        build=free_flying_robot,
        published="7.910",
        source="Betts (2010): 7.910154646; GPOPS-II: 7.9101902; no digits but these agree",
    ),
    Case(
        name="alp_rider",
        build=alp_rider,
        published="2030.85",
        source="Betts (2010): 2030.85609, as opty's example of it says; no digits but these are "
        "left by a flight of the controls found, which keeps the limit and costs 2030.85419",
    ),
    Case(
        name="container_crane",
        build=container_crane,
        published="0.0375195",
        source="Augustin and Maurer (2001), as Maptor's example of it solves it",
    ),
    Case(
        name="cubic_hyper_sensitive",
        build=cubic_hyper_sensitive,
        published="1.3308",
        source=PSOPT,
    ),
    Case(
        name="rayleigh",
        build=rayleigh,
        published="44.8044",
        source="Maurer and Augustin (2001); PSOPT 5 has 44.77625 on its coarse mesh",
    ),
    Case(
        name="van_der_pol",
        build=van_der_pol,
        published="2.86726",
        source="Balsa-Canto et al. (2002), case 6.1, in the PROPT guide, example 124",
    ),
    Case(
        name="van_der_pol_floor",
        build=van_der_pol_above_a_floor,
        published="2.954",
        source="Vassiliadis, Sargent and Pantelides (1994), I&EC Research 33",
    ),
    Case(name="isoperimetric", build=isoperimetric, published="-0.3755", source=PSOPT),
    Case(name="aly_chan", build=aly_chan, published=0.0, source="Aly and Chan (1973), IJC 17"),
    Case(
        name="mpec",
        build=complementary,
        published=COMPLEMENTARY_COST,
        source="one switch, found by itself; Betts (2010) states it, and PSOPT 5 has 1.656309 and "
        "1.654223 on coarse meshes",
    ),
    Case(
        name="singular5",
        build=singular_control,
        published="0.1192",
        source="Luus (2002), stated as PSOPT 5 does in examples/singular5: 0.119262 there",
    ),
    Case(
        name="figure_eight",
        build=figure_eight,
        published="6.3259140",
        source="Chenciner and Montgomery (2000), Annals of Mathematics 152, with Simo's digits: "
        "6.32591398, of which a place of eight digits determines these",
        times=lambda m: {1: m.T},
    ),
    Case(name="interior_point", build=interior_point, published=_interior_cost(), source=PSOPT),
    Case(
        name="logarithmic",
        build=logarithmic,
        published=_logarithmic_cost(),
        source="Garg et al. (2010), Automatica 46",
    ),
    Case(
        name="hager",
        build=hager,
        published=float(4 / (1 + 3 * np.exp(5))),
        source="Hager, Hou and Rao (2016), JOTA 169",
    ),
)
