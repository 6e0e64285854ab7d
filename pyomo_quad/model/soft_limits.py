"""Soft limits: limits and end conditions that a flight may violate at a penalty.

Replanning in flight uses soft limits, so that a plan exists even if the measured state already
violates a limit. The physical limits of rotors (speed, acceleration, thrust, moments) and pack
(greatest power, positive voltage) stay hard: they always permit some flight. The edges of terrain
and wind data stay hard, too.

symbol | name | unit | meaning
s_k | most[k] | unit of limit k | largest violation of limit k over time
s+_j, s-_j | above[j], below[j] | unit of condition j | violations of condition j, up and down
rho | price | J/unit | penalty per unit of violation

A limit g(t) <= u over time becomes g(t) - s <= u with one s >= 0. A condition h = c becomes h = c +
s+ - s-. The objective grows by rho times the sum of all s, s+ and s-. For a large rho, all
violations are zero if a flight without violation exists; see docs/theory/soft_limits.md.
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
# Penalty of a violation by one unit (metre, radian, ...), as the height [m] to which the same
# energy would lift the vehicle. A flight that ends a metre off its goal saves the energy of that
# metre, which is some ten metres of lift: the penalty is far above it.
_LIFTED_M = 300.0
# Usual size of a violation, in its unit, from which the solver's scaling is set.
_USUAL = 0.1
#: Full name of the parameter that holds the penalty per unit of violation.
PRICE = "soft.price"
#: Full names of the violations: of limits (largest over time), of conditions up- and downwards.
BREACHES = ("soft.most", "soft.above", "soft.below")


def usual_price(scenario: Scenario) -> float:
    """Return the initial penalty per unit of violation of a soft limit [J per unit].

    It is the energy that lifts the vehicle by 300 m. With a penalty above the value of eq. (2) in
    docs/theory/soft_limits.md, a plan violates no limit that it can keep.
    """
    return _LIFTED_M * scenario.vehicle.total_mass * scenario.gravity


def soften(m: ConcreteModel, scenario: Scenario) -> None:
    """Replace limits and end conditions of a model by soft constraints, in block `soft`.

    `soft_objective` adds all violations times the mutable parameter `soft.price` [J per unit] to
    the objective. The original constraints and objective are deactivated. The docstring of this
    module names the hard limits.
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
    """Replace a path constraint by a soft constraint for each of its bounds, lower and upper.

    The variable `most[limit.name]` of block `soft` is the largest violation of either bound over
    time.
    """
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
    """Replace an equality constraint at one time by a soft constraint in `b`, the block `soft`.

    The variables `above` and `below` of the block are the violations upwards and downwards.
    """
    held = [index for index in condition if condition[index].active]

    def softly(holder: Block, *index: Any) -> Any:
        stated = condition[index]
        breach = holder.above[stated.name] - holder.below[stated.name]
        return stated.body == stated.lower + breach * units.get_units(stated.body)

    soft = Constraint(held, rule=softly, doc=f"{condition.doc}, soft")
    b.add_component(condition.name.replace(".", "_"), soft)
    condition.deactivate()
