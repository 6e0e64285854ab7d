"""Reactors and processes, and the like of them in fisheries, mines and medicine."""

from pyomo.dae import ContinuousSet, DerivativeVar
from pyomo.environ import ConcreteModel, Constraint, Expression, Var, exp, log

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
DADEBO = "Dadebo and McAuley (1995), Computers & Chemical Engineering 19"


def catalyst_mixing(end=1.0):
    m = posed(
        "catalyst mixing",
        {"a": (1, None, 0, 1), "b": (0, None, 0, 1)},
        {"u": (0, 1)},
        lambda m, t: {
            "a": m.u[t] * (10 * m.b[t] - m.a[t]),
            "b": m.u[t] * (m.a[t] - 10 * m.b[t]) - (1 - m.u[t]) * m.b[t],
        },
        end=end,
    )
    guessed(m, a=lambda _s: 1, b=lambda _s: 0)
    return maximised(m, 1 - m.a[end] - m.b[end])


def long_catalyst_mixing():
    return catalyst_mixing(4.0)


def parallel_reactions():
    m = posed(
        "parallel reactions",
        {"a": (1, None, 0, 1), "b": (0, None, 0, 1)},
        {"u": (0, 5)},
        lambda m, t: {"a": -(m.u[t] + m.u[t] ** 2 / 2) * m.a[t], "b": m.u[t] * m.a[t]},
    )
    return maximised(m, m.b[1])


def batch_reactor():
    def rates(m, t):
        k1, k2 = 4e3 * exp(-2500 / m.kelvin[t]), 6.2e5 * exp(-5000 / m.kelvin[t])
        lost = k1 * m.a[t] ** 2
        return {"a": -lost, "b": lost - k2 * m.b[t]}

    m = posed(
        "batch reactor",
        {"a": (1, None, 0, 1), "b": (0, None, 0, 1)},
        {"kelvin": (298, 398)},
        rates,
    )
    return maximised(m, m.b[1])


def reactor_of_rates(*, are_variables=True):
    """The same for as long as it pays, 0.05 a unit of time, with its rates as variables."""
    m = ConcreteModel(name="batch reactor of rates")
    m.t, m.T = ContinuousSet(bounds=(0, 1)), Var(bounds=(0.1, 10), initialize=1)
    m.a, m.b = Var(m.t, bounds=(0, 1)), Var(m.t, bounds=(0, 1))
    m.kelvin = Var(m.t, bounds=(298, 398))
    m.da, m.db = DerivativeVar(m.a, wrt=m.t), DerivativeVar(m.b, wrt=m.t)
    for name, (factor, energy) in {"k1": (4e3, 2500), "k2": (6.2e5, 5000)}.items():

        def law(m, t, factor=factor, energy=energy):
            return factor * exp(-energy / m.kelvin[t])

        if not are_variables:
            m.add_component(name, Expression(m.t, rule=law))
            continue
        m.add_component(name, Var(m.t))
        m.add_component(
            f"{name}_law",
            Constraint(m.t, rule=lambda m, t, k=name, law=law: m.component(k)[t] == law(m, t)),
        )
    m.loss = Constraint(m.t, rule=lambda m, t: m.da[t] == -m.k1[t] * m.a[t] ** 2)
    m.gain = Constraint(m.t, rule=lambda m, t: m.db[t] == m.k1[t] * m.a[t] ** 2 - m.k2[t] * m.b[t])
    m.a[0].fix(1)
    m.b[0].fix(0)
    return maximised(m, m.b[1] - 0.05 * m.T)


# Declared instants of the kinetic reactor: start, the end of two stages of transients, and the end.
STAGES = (0.0, 0.01, 0.5, 2.0)
# What the concentration of protons times `base` is, mol/kg.
PROTONS = 1e-11


def kinetic_reactor():
    """Leineweber's batch reactor in three phases, the last three quarters of the time.

    The ions that the acid's equilibria bind are substituted.  `base` stands for the published
    exponent of the protons, which is its logarithm: `base` rises from nearly zero in proportion to
    time, so that polynomials follow it, but not the exponent, beside the start.  The limit on y4 is
    twice the square of time in the first two phases and 1.5 in the last.
    """
    m = ConcreteModel(name="kinetic batch reactor")
    m.t = ContinuousSet(initialize=STAGES)
    last = STAGES[-1]
    m.T1, m.T2 = Var(initialize=STAGES[1]), Var(bounds=(0.02, 2.5), initialize=STAGES[2])
    m.T1.fix(STAGES[1])
    m.T3, m.p = Var(bounds=(1.5, 10), initialize=last), Var(bounds=(0, 0.0262), initialize=0.013)
    guesses = {
        "y1": (2, 1.5776, 1.55, 0.5, 0.05),
        "y2": (10, 8.32, 8.3, 6.9, 5.8),
        "y3": (2, 0, 0.03, 0.7, 0.5),
        "y4": (2, 0, 2e-4, 0.4, 1),
        "y5": (2, 0, 0.01, 0.4, 1),
        "y6": (0.1, 0.014, 0.002, 0.012, 0.014),
        "base": (10, 0.01, 1.7, 0.8, 0.4),
        "kelvin": (393.15, 393, 372, 390, 393),
    }
    lowest = {"y2": 5, "kelvin": 293.15}
    for key, (most, *held) in guesses.items():
        first = dict(zip(STAGES, held, strict=True))
        m.add_component(key, Var(m.t, bounds=(lowest.get(key, 0), most)))
        for t, number in first.items():
            m.component(key)[t].set_value(number)

    def rates(m, t):
        k1 = 1.3708e12 * exp(-9.2984e3 / m.kelvin[t])
        back = 1.6215e20 * exp(-1.3108e4 / m.kelvin[t])
        k2 = 5.2282e12 * exp(-9.5999e3 / m.kelvin[t])
        u2, u3, u4 = ions(m, t)
        r1 = k1 * m.y2[t] * m.y6[t] - back * u4
        r2 = k2 * m.y2[t] * u2
        r3 = k1 * m.y4[t] * m.y6[t] - back / 2 * u3
        return {"y1": -r2, "y2": -r1 - r2, "y3": r2 + r3, "y4": -r3, "y5": r1, "y6": -r1 - r3}

    def ions(m, t):
        parts = ((m.y1, 4.876e-14), (m.y3, 1.7884e-16), (m.y5, 2.575e-16))
        bound = ((y[t], constant / PROTONS * m.base[t]) for y, constant in parts)
        return [y * share / (1 + share) for y, share in bound]

    for key in [f"y{k}" for k in range(1, 7)]:
        m.add_component(f"d{key}", DerivativeVar(m.component(key), wrt=m.t))

        def law(m, t, key=key):
            return m.component(f"d{key}")[t] == rates(m, t)[key]

        m.add_component(f"{key}_law", Constraint(m.t, rule=law))
    m.charge = Constraint(
        m.t,
        rule=lambda m, t: 100 * (m.base[t] * (m.p - m.y6[t] - sum(ions(m, t))) + PROTONS) == 0,
    )
    m.limit = Constraint(m.t, rule=lambda m, t: m.y4[t] <= (2 * t**2 if t <= STAGES[2] else 1.5))
    for key, number in {"y1": 1.5776, "y2": 8.32, "y3": 0, "y4": 0, "y5": 0}.items():
        m.component(key)[0].fix(number)
    m.first = Constraint(expr=m.y6[0] == m.p)
    m.made = Constraint(expr=m.y4[last] >= 1)
    m.quarter = Constraint(expr=m.T2 == m.T3 / 4)
    return minimised(m, m.T3 + 100 * m.p)


def kinetic_times(m):
    """Return what gives the reactor's instants."""
    return dict(zip(STAGES[1:], (m.T1, m.T2, m.T3), strict=True))


def stirred_tank():
    def rates(m, t):
        heat = (m.y[t] + 0.5) * exp(25 * m.x[t] / (m.x[t] + 2))
        return {
            "x": -(2 + m.u[t]) * (m.x[t] + 0.25) + heat,
            "y": 0.5 - m.y[t] - heat,
        }

    m = posed(
        "stirred tank",
        {"x": (0.05, None, -1, 1), "y": (0, None, -1, 1)},
        {"u": (-5, 5)},
        rates,
        end=0.78,
    )
    return minimised(m, total(m, lambda m, t: m.x[t] ** 2 + m.y[t] ** 2 + 0.1 * m.u[t] ** 2))


def mine():
    m = posed(
        "mine", {"x": (10, None, 0.01, 10)}, {"u": (0, 20)}, lambda m, t: {"x": -m.u[t]}, end=3
    )
    guessed(m, x=lambda s: 10 - 9 * s)
    return maximised(m, total(m, lambda m, t: 2 * m.u[t] - m.u[t] ** 2 / m.x[t]))


def fishing():
    m = posed(
        "fishing",
        {"prey": (0.5, None, 0, 3), "hunter": (0.7, None, 0, 3)},
        {"w": (0, 1)},
        lambda m, t: {
            "prey": m.prey[t] - m.prey[t] * m.hunter[t] - 0.4 * m.prey[t] * m.w[t],
            "hunter": -m.hunter[t] + m.prey[t] * m.hunter[t] - 0.2 * m.hunter[t] * m.w[t],
        },
        end=12,
    )
    guessed(m, prey=lambda _s: 1, hunter=lambda _s: 1)
    return minimised(m, total(m, lambda m, t: (m.prey[t] - 1) ** 2 + (m.hunter[t] - 1) ** 2))


# Of a tumour that nothing treats.
SIZE = ((5.85 - 0.02) / 0.00873) ** 1.5


def tumour():
    m = posed(
        "tumour",
        {"p": (SIZE / 2, None, 1, SIZE), "q": (SIZE / 4, None, 1, SIZE), "y": (0, None, 0, 15)},
        {"u": (0, 75)},
        lambda m, t: {
            "p": -0.084 * m.p[t] * log(m.p[t] / m.q[t]),
            "q": m.q[t] * (5.85 - 0.02 - 0.00873 * m.p[t] ** (2 / 3) - 0.15 * m.u[t]),
            "y": m.u[t],
        },
        free=(0.1, 5, 1.2),
    )
    guessed(m, p=lambda s: (0.5 - 0.1 * s) * SIZE, q=lambda _s: SIZE / 4, y=lambda s: 15 * s)
    return minimised(m, m.p[1])


def lee_ramirez():
    """A bioreactor whose feed of glucose is singular: Ipopt finds no way to 6.15 (Banga 2005)."""

    def rates(m, t):
        x1, x2, x3, x4, x5, x6, x7 = (m.component(f"x{k}")[t] for k in range(1, 8))
        fed = m.glucose[t] + m.inducer[t]
        taken = x3 / (14.35 + x3 + x3**2 / 111.5)
        growth = taken * (x6 + 0.22 * x7 / (0.22 + x5))
        shock = 0.09 * x5 / (0.034 + x5)
        return {
            "x1": fed,
            "x2": growth * x2 - fed * x2 / x1,
            "x3": 100 * m.glucose[t] / x1 - fed * x3 / x1 - growth * x2 / 0.51,
            "x4": 0.233 * taken * (0.0005 + x5) / (0.022 + x5) * x2 - fed * x4 / x1,
            "x5": 4 * m.inducer[t] / x1 - fed * x5 / x1,
            "x6": -shock * x6,
            "x7": shock * (1 - x7),
        }

    first = (1, 0.1, 40, 0, 0, 1, 0)
    m = posed(
        "Lee-Ramirez",
        {f"x{k}": (x, None) for k, x in enumerate(first, start=1)},
        {"glucose": (0, 1, 0.1), "inducer": (0, 1, 0.05)},
        rates,
        end=10,
    )
    guessed(m, **{f"x{k}": lambda _s, x=x: x for k, x in enumerate(first, start=1)})
    return maximised(m, m.x1[10] * m.x4[10])


def oil_shale():
    laws = ((8.86, 20300.0), (24.25, 37400.0), (23.67, 33800.0), (18.75, 28200.0), (20.70, 31000.0))

    def rates(m, t):
        k1, k2, k3, k4, k5 = (exp(a - b / 1.9872 / m.kelvin[t]) for a, b in laws)
        a, b = m.kerogen[t], m.bitumen[t]
        return {
            "kerogen": -k1 * a - (k3 + k4 + k5) * a * b,
            "bitumen": k1 * a - k2 * b + k3 * a * b,
        }

    m = posed(
        "oil shale",
        {"kerogen": (1, None, 0, 1), "bitumen": (0, None, 0, 1)},
        {"kelvin": (698.15, 748.15)},
        rates,
        free=(1, 30, 10),
    )
    return maximised(m, m.bitumen[1])


CASES = (
    Case(name="catalyst_mixing", build=catalyst_mixing, published="0.0480557", source=COPS),
    Case(
        name="long_catalyst_mixing",
        build=long_catalyst_mixing,
        published="0.192",
        source="BOCOP, test/examples.list.csv: jackson_basic",
    ),
    Case(name="parallel_reactions", build=parallel_reactions, published="0.5735", source=DADEBO),
    Case(name="batch_reactor", build=batch_reactor, published="0.6108", source=DADEBO),
    Case(
        name="reactor_of_rates",
        build=reactor_of_rates,
        published="0.56913196",
        source="Pontryagin's conditions by shooting, in tests/unit/collocation/test_first_guesses",
        times=lambda m: {1: m.T},
    ),
    Case(
        name="stirred_tank",
        build=stirred_tank,
        published="0.0266",
        source="Kirk (1970), Optimal Control Theory, section 6.2",
    ),
    Case(
        name="mine",
        build=mine,
        published=10 * 2**2 * 3 / (4 + 2 * 3),
        source="Dorroh and Ferreyra (1994), JOTA 80",
    ),
    Case(
        name="fishing",
        build=fishing,
        published="1.34408",
        source="Sager (2012), A benchmark library of mixed-integer optimal control",
    ),
    Case(
        name="tumour",
        build=tumour,
        published="7571.67",
        source="Betts (2020), example 10.142: 7571.67158",
    ),
    Case(
        name="kinetic_reactor",
        build=kinetic_reactor,
        published="3.165",
        source="Betts (2010), example 6.15: 3.16466910, of which SciPy flies 1.4e-5 less",
        times=kinetic_times,
    ),
    Case(name="oil_shale", build=oil_shale, published="0.354", source="Luus (2000), section 9.4"),
)
