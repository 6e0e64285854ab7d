"""Soft limits: every limit but those of rotors and pack may be broken, at a price.

symbol | name | unit | meaning
s_k | most[k] | unit of limit k | largest breach of limit k over time
s+_j, s-_j | above[j], below[j] | unit of condition j | breach of condition j upwards and downwards
rho | price | J/unit | price of a unit of breach

A limit g(t) <= u over time becomes g(t) - s <= u with one s >= 0, a condition h = c becomes
h = c + s+ - s-, and the objective grows by rho times the sum of all s.  Some flight within the
limits of rotors and pack always exists, so that a plan does.  See docs/theory/soft_limits.md for
the price above which the breaches are zero wherever a flight without any exists.
"""

from typing import Any

from pyomo.core import (
    Block,
    ConcreteModel,
    Constraint,
    NonNegativeReals,
    Objective,
    Param,
    Var,
)
from pyomo.core.base.constraint import ConstraintData
from pyomo.core.base.units_container import units

from pyomo_quad.collocation.reading.rules import function_of
from pyomo_quad.scenario import Scenario

_LIMITS = (
    "limits.roll_limit",
    "limits.pitch_limit",
    "limits.speed_limit",
    "limits.validated_airspeed_limit",
    "limits.validated_climb_limit",
    "limits.validated_descent_limit",
    "limits.state_of_charge_limit",
    "limits.battery_current_limit",
    "limits.battery_voltage_limit",
    "homing.return_limit",
    "airspace.floor_limit",
    "airspace.ceiling_limit",
    "airspace.keep_in",
    "airspace.keep_out",
    "mission.hold_distance",
    "mission.hold_speed",
    "mission.passing_near",
    "mission.passing_speed",
)
_CONDITIONS = (
    "mission.passing_place",
    "mission.passing_heading",
    "mission.goal_place",
    "mission.goal_rest",
    "mission.goal_balance",
    "mission.goal_moments",
)
# Price of a breach of a metre, radian, ..., as the height [m] to which it would lift the vehicle:
# a flight that is a metre off its goal saves what takes it there, some ten metres' worth.
_LIFTED_M = 300.0
# Size of a breach by which solves are scaled, in its unit.
_USUAL = 0.1
#: Full name of the price of a unit of breach.
PRICE = "soft.price"
#: Largest breaches over time, and breaches of conditions upwards and downwards, by full name.
BREACHES = ("soft.most", "soft.above", "soft.below")


def usual_price(scenario: Scenario) -> float:
    """Return a price of breaches [J per their unit] that is above most multipliers."""
    return _LIFTED_M * scenario.vehicle.total_mass * scenario.gravity


def soften(m: ConcreteModel, scenario: Scenario) -> None:
    """Replace the limits and conditions of a model by soft ones, in block `soft`.

    Parameters
    ----------
    m : ConcreteModel
        With its `objective`; the price is a mutable parameter.
    """
    b = m.soft = Block(doc="soft limits: breaches and their price")
    limits = [c for c in map(m.find_component, _LIMITS) if c]
    conditions = [c for c in map(m.find_component, _CONDITIONS) if c]
    price = usual_price(scenario)
    b.price = Param(initialize=price, mutable=True, units=units.J, doc="price of a unit of breach")
    b.most = Var([c.name for c in limits], domain=NonNegativeReals, initialize=0.0, doc="s_k")
    places = [c[index].name for c in conditions for index in c if c[index].active]
    b.above = Var(places, domain=NonNegativeReals, initialize=0.0, doc="s+_j")
    b.below = Var(places, domain=NonNegativeReals, initialize=0.0, doc="s-_j")
    for breach in (b.most, b.above, b.below):
        m.scaling_factor[breach] = 1.0 / _USUAL
    for component in limits:
        _soften_limit(b, component)
    for component in conditions:
        _soften_condition(b, component)
    breaches = sum(b.most.values()) + sum(b.above.values()) + sum(b.below.values())
    m.objective.deactivate()
    m.soft_objective = Objective(
        expr=m.objective.expr + b.price * breaches, doc=f"{m.objective.doc}, and breaches"
    )


def _soften_limit(b: Block, limit: Constraint) -> None:
    """Replace a limit over time by a soft one for each of its ends."""
    name, stated = limit.name, function_of(limit)
    unit = units.get_units(limit[next(iter(limit))].body)
    ends = limit[next(iter(limit))].to_bounded_expression()

    def relaxed(side: int, holder: Block, index: tuple[Any, ...]) -> Any:
        relation = stated(holder.parent_block().find_component(owner), *index)
        if relation is Constraint.Skip:
            return relation
        lower, body, upper = ConstraintData(expr=relation).to_bounded_expression()
        breach = holder.most[name] * unit
        return body - breach <= upper if side else lower <= body + breach

    owner = limit.parent_block().name

    def below(holder: Block, *index: Any) -> Any:
        return relaxed(0, holder, index)

    def above(holder: Block, *index: Any) -> Any:
        return relaxed(1, holder, index)

    for rule, end in ((below, ends[0]), (above, ends[2])):
        if end is not None:
            soft = Constraint(*limit.index_set().subsets(), rule=rule, doc=f"{limit.doc}, soft")
            b.add_component(f"{name.replace('.', '_')}_{rule.__name__}", soft)
    limit.deactivate()


def _soften_condition(b: Block, condition: Constraint) -> None:
    """Replace a condition at a time by one whose breach either way has a price."""
    held = [index for index in condition if condition[index].active]

    def softly(holder: Block, *index: Any) -> Any:
        stated = condition[index]
        breach = holder.above[stated.name] - holder.below[stated.name]
        return stated.body == stated.lower + breach * units.get_units(stated.body)

    soft = Constraint(held, rule=softly, doc=f"{condition.doc}, soft")
    b.add_component(condition.name.replace(".", "_"), soft)
    condition.deactivate()
