"""An index-1 DAE: charge a capacitor through a resistor and a diode with the least loss.

    minimise    int_0^T (R i^2 + w i) dt
    subject to  C v' = i                     capacitor
                i = S (exp(w / W) - 1)       diode with voltage w
                source = v + R i + w         loop
                v(0) = 0,  v(T) = V,  source >= 0

Closed form: the loss is convex in the current, so the current is constant, i = C V / T.
"""

import numpy as np
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Objective, Var, exp, minimize

DURATION, VOLTAGE = 10.0, 5.0  # s, V
CAPACITY, RESISTANCE = 1.0, 2.0  # F, ohm
SATURATION_CURRENT, THERMAL_VOLTAGE = 1e-3, 0.1  # A, V
KINKS = ()


def build():
    m = ConcreteModel(name="charging through a diode")
    m.t = ContinuousSet(bounds=(0, DURATION))
    m.voltage = Var(m.t)
    m.current = Var(m.t, bounds=(0, None))
    m.diode_voltage = Var(m.t, bounds=(0, 1))
    m.source = Var(m.t, bounds=(0, None))
    m.dvoltage_dt = DerivativeVar(m.voltage, wrt=m.t)

    @m.Constraint(m.t)
    def capacitor(m, t):
        return CAPACITY * m.dvoltage_dt[t] == m.current[t]

    @m.Constraint(m.t)
    def diode(m, t):
        rise = exp(m.diode_voltage[t] / THERMAL_VOLTAGE) - 1
        return m.current[t] == SATURATION_CURRENT * rise

    @m.Constraint(m.t)
    def loop(m, t):
        return m.source[t] == m.voltage[t] + RESISTANCE * m.current[t] + m.diode_voltage[t]

    m.voltage[0].fix(0)
    m.voltage[DURATION].fix(VOLTAGE)

    @m.Expression(m.t)
    def loss(m, t):
        return RESISTANCE * m.current[t] ** 2 + m.diode_voltage[t] * m.current[t]

    m.lost_energy = Integral(m.t, wrt=m.t, rule=lambda m, t: m.loss[t])
    m.objective = Objective(expr=m.lost_energy, sense=minimize)
    return m


CURRENT = CAPACITY * VOLTAGE / DURATION
DIODE_VOLTAGE = THERMAL_VOLTAGE * np.log1p(CURRENT / SATURATION_CURRENT)


def objective():
    return DURATION * (RESISTANCE * CURRENT**2 + DIODE_VOLTAGE * CURRENT)


def state(t):
    return {"voltage": VOLTAGE * t / DURATION}


def control(t):
    source = state(t)["voltage"] + RESISTANCE * CURRENT + DIODE_VOLTAGE
    return {
        "current": np.full_like(t, CURRENT),
        "diode_voltage": np.full_like(t, DIODE_VOLTAGE),
        "source": source,
    }


def costate(t):
    """Return minus the marginal loss of charge: dL/di + p / C = 0."""
    diode_slope = THERMAL_VOLTAGE / (CURRENT + SATURATION_CURRENT)
    marginal_loss = 2 * RESISTANCE * CURRENT + DIODE_VOLTAGE + CURRENT * diode_slope
    return {"voltage": np.full_like(t, -CAPACITY * marginal_loss)}
