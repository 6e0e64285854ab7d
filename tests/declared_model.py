"""The declared model at one instant: states in, declared values and rates out."""

from functools import cached_property

import numpy as np
from pyomo.core.expr.visitor import identify_variables
from pyomo.dae import DerivativeVar
from pyomo.environ import Constraint, value

from pyomo_quad.flight.steady import MomentumDemand
from pyomo_quad.model import build_model
from pyomo_quad.scenario import scenario_from_mapping
from tests.flights import PLANNER

MISSION = {"goal": {"position": [6.0, 7.0, 8.0]}, "duration": 10.0}
AIRSPACE = {
    "floor": -1.0,
    "ceiling": 9.0,
    "clearance": 0.1,
    "keep_out": [
        {
            "name": "mast",
            "shape": "cylinder",
            "centre": [3, 5],
            "radius": 0.5,
            "bottom": 0,
            "top": 9,
        },
        {"name": "balloon", "shape": "sphere", "centre": [1.0, 5.0, 7.0], "radius": 1.0},
        {"name": "hall", "shape": "box", "low": [4.0, 0.0, 0.0], "high": [6.0, 2.0, 3.0]},
    ],
}
ROTORS = (1, 2, 3, 4)
RIGID_BODY = ("x", "y", "z", "vx", "vy", "vz", "phi", "theta", "psi", "p", "q", "r")


def scenario(**tables):
    """A scenario of the paper's vehicle; tables as in a scenario file."""
    document = {
        "name": "agreement",
        "vehicle": {"use": "dji_phantom_2"},
        "wind": {"use": "calm", "coupling": "acceleration"},
        "mission": MISSION,
    }
    for name, table in tables.items():
        document[name] = document.get(name, {}) | table
    return scenario_from_mapping(document)


def steady(told):
    """The scenario's vehicle in steady flight."""
    return PLANNER.steady_flight(told)


def momentum_demand(told):
    """What the scenario's motions ask of the thrust."""
    return MomentumDemand(PLANNER.dynamics(told))


class Instant:
    """A model with its variables set at one time, halfway unless told otherwise."""

    def __init__(self, model, time=None):
        self.model = model
        self.t = sorted(model.time)[1] if time is None else time

    @classmethod
    def of(cls, time=None, **tables):
        return cls(build_model(scenario(**tables)), time)

    def set(self, body=(0.0,) * 12, omega=(0.0,) * 4, alpha=(0.0,) * 4, charge=0.0):
        for name, number in zip(RIGID_BODY, body, strict=True):
            self.model.rigid_body.component(name)[self.t].set_value(float(number))
        for j, speed, acceleration in zip(ROTORS, omega, alpha, strict=True):
            self.model.rotors.omega[j, self.t].set_value(float(speed))
            self.model.rotors.alpha[j, self.t].set_value(float(acceleration))
        self.model.battery.charge_drawn[self.t].set_value(float(charge))
        return self

    def hover(self, **more):
        return self.set(omega=(value(self.model.mission.hover_speed),) * 4, **more)

    def read(self, name, *index):
        return value(self.model.find_component(name)[(*index, self.t) if index else self.t])

    def rotors(self, name):
        return np.array([self.read(name, j) for j in ROTORS])

    def rates(self):
        """Solve each balance for its derivative, by derivative name."""
        for _, derivative, _ in self._balances:
            derivative.set_value(0.0)
        found = {}
        for name, derivative, balance in self._balances:
            left, right = balance.expr.args
            derivative.set_value(1.0)
            found[name] = value(right) / value(left)
            derivative.set_value(0.0)
        return found

    @cached_property
    def _balances(self):
        """The name of each derivative, its variable and the balance that has it."""
        return [
            _balance_of_derivative(data)
            for constraint in self.model.component_objects(Constraint, descend_into=True)
            for index, data in constraint.items()
            if (index[-1] if isinstance(index, tuple) else index) == self.t and data.equality
        ]


def _balance_of_derivative(balance):
    (derivative,) = (
        v
        for v in identify_variables(balance.expr)
        if isinstance(v.parent_component(), DerivativeVar)
    )
    index = derivative.index()
    name = derivative.parent_component().local_name
    return (f"{name}[{index[0]}]" if isinstance(index, tuple) else name), derivative, balance
