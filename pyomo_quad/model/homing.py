"""Reserve of charge that brings a vehicle home from any place, as a limit along the flight.

symbol | name | unit | meaning
d_k | way | m | straight distance to home k
w_k | tail_wind | m/s | component of the wind towards home k, at the vehicle
g_k | ground_speed | m/s | ground speed on a straight course to home k (wind triangle, airspeed V)
H_k | height_home | m | least height of the level return to home k over terrain
c_k | climb | m | climb from the vehicle's height to H_k, over terrain
q_k | charge_to | A h | charge of the return to home k, including the margin
q | charge_home | A h | charge of the return to the nearest home

A home is a place at which the vehicle may land: the start of the mission, or a rally point.

The return is computed with one airspeed V and with the constant current i of steady, level flight.
At the ground speed g = w + sqrt(V^2 - abs(wind)^2 + w^2), the charge is (1 + margin) i d / g. The
margin covers the errors of two assumptions: the wind on the whole return equals the wind at the
vehicle, and a sloping path takes as much charge per metre as level flight. Without terrain, the
vehicle flies straight home.

Over terrain, the vehicle climbs vertically to the height H_k, flies level to the place above the
home, and descends. H_k is the highest ground on the straight line to the home, plus the floor of
the airspace. The climb draws a current of its own, at a given rate of climb. Over terrain, d in the
formula of the charge is the length of level flight plus descent. See docs/theory/homing.md.
"""

from collections.abc import Hashable

from pyomo.core import Block, ConcreteModel, Set, exp, sqrt, tanh
from pyomo.core.base.units_container import units
from pyomo.core.expr import NumericExpression, RelationalExpression

from pyomo_quad.collocation import Table
from pyomo_quad.model.battery import CHARGE
from pyomo_quad.model.parameters import (
    Parameter,
    declare_parameters,
    fields_of,
    parameters_in,
    saturated,
)
from pyomo_quad.model.wind_field import smooth_positive
from pyomo_quad.scenario import Scenario

# Added in quadrature to the way home, so that its length is differentiable at the home itself.
_AT_HOME = 1.0 * units.m
# Ground speed, and square of the airspeed along the way, below which the wind prevents the return,
# with the widths over which these limits are rounded; see `saturated`.
_SLOWEST, _SPEED_WIDTH = 0.5 * units.m / units.s, 0.05 * units.m / units.s
_STOPPED, _SQUARE_WIDTH = 0.25 * units.m**2 / units.s**2, 0.025 * units.m**2 / units.s**2
# Sharpness of the smooth minimum over homes: where the charges of two returns differ by 1/200 of
# the pack, the weight of the return with more charge is smaller by a factor e.
_SHARPNESS = 200.0
# Width over which the climb is rounded upwards near zero.
_CLIMB_WIDTH = 1.0 * units.m


def _homes(scenario: Scenario) -> tuple[tuple[float, float, float], ...]:
    return (scenario.mission.start.position, *scenario.mission.rally)


def _places(axis: int, scenario: Scenario) -> dict[int, float]:
    return {k: place[axis] for k, place in enumerate(_homes(scenario))}


_HOMES = tuple(
    Parameter(
        name=f"home_{name}",
        units=units.m,
        value=lambda s, axis=axis: _places(axis, s),  # type: ignore[misc]
        doc=f"{name} of the places to return to",
    )
    for axis, name in enumerate("xyz")
)
_USABLE_CHARGE = Parameter(
    name="usable_charge",
    units=units.dimensionless,
    value=lambda s: 1.0 - s.limits.least_charge,
    doc="share of the charge that is used when the return ends",
)


@parameters_in("homing")
def parameters_of(scenario: Scenario) -> tuple[Parameter, ...]:
    """Return the parameters of the return flight; empty for a mission without return reserve.

    The return reserve is the charge that a plan keeps for a flight to the nearest landing place.
    """
    if not scenario.mission.return_reserve:
        return ()
    names = ["margin", "airspeed", "current"]
    if scenario.airspace.ground is not None:
        names += ["climb_rate", "climb_current"]
    return (*_HOMES, _USABLE_CHARGE, *fields_of("mission.return_flight", *names))


def terrain_key(scenario: Scenario) -> Hashable:
    """Return the places of the homes if the compiled model depends on them, or None.

    With terrain and a return reserve, the compiled model has a height table for each home and is
    valid only for these homes.
    """
    has_tables = scenario.mission.return_reserve and scenario.airspace.ground is not None
    return _homes(scenario) if has_tables else None


def declare_homing(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare the charge of a return flight in block `homing`, and the limit that reserves it.

    The charge drawn plus the charge of the return to the nearest home is at most the usable charge.
    Without a return reserve, nothing is declared.
    """
    if not scenario.mission.return_reserve:
        return
    b = m.homing = Block(doc="return to the start or a rally point")
    declare_parameters(b, scenario)
    b.home = Set(initialize=list(_places(0, scenario)))
    _declare_way(b, m)
    if scenario.airspace.ground is not None:
        _declare_climb(b, m, scenario)
    _declare_charge(b, m)

    @b.Constraint(m.time, doc="charge left in the pack suffices for the return [A h]")
    def return_limit(b: Block, t: float) -> RelationalExpression:
        pack = b.parent_block().battery
        # The usable charge is the capacity less the least charge that must remain.
        usable = b.usable_charge * pack.pack_capacity
        return pack.charge_drawn[t] + b.charge_home[t] <= usable


def _declare_way(b: Block, m: ConcreteModel) -> None:
    @b.Expression(b.home, m.time, doc="straight way home, docs/theory/homing.md eq. (1) [m]")
    def way(b: Block, k: int, t: float) -> NumericExpression:
        body = b.parent_block().rigid_body
        squares = (b.home_x[k] - body.x[t]) ** 2 + (b.home_y[k] - body.y[t]) ** 2
        return sqrt(squares + (b.home_z[k] - body.z[t]) ** 2 + _AT_HOME**2)

    @b.Expression(
        b.home, m.time, doc="wind along the way home, docs/theory/homing.md eq. (2) [m/s]"
    )
    def tail_wind(b: Block, k: int, t: float) -> NumericExpression:
        body, wind = b.parent_block().rigid_body, b.parent_block().wind
        along_x = wind.velocity_x[t] * (b.home_x[k] - body.x[t])
        along_y = wind.velocity_y[t] * (b.home_y[k] - body.y[t])
        return (along_x + along_y) / b.way[k, t]

    @b.Expression(
        b.home, m.time, doc="speed over ground on the way home, docs/theory/homing.md eq. (3) [m/s]"
    )
    def ground_speed(b: Block, k: int, t: float) -> NumericExpression:
        wind = b.parent_block().wind
        across = wind.velocity_x[t] ** 2 + wind.velocity_y[t] ** 2 - b.tail_wind[k, t] ** 2
        left = b.airspeed**2 - across
        # In a cross wind that is faster than the airspeed, the vehicle cannot track the way.
        held = (1 + tanh(left / _SQUARE_WIDTH)) / 2
        along = b.tail_wind[k, t] + sqrt(saturated(left, _STOPPED, _SQUARE_WIDTH))
        return saturated(held * along, _SLOWEST, _SPEED_WIDTH)


def _declare_climb(b: Block, m: ConcreteModel, scenario: Scenario) -> None:
    """Declare height, climb and length [m] of the return over terrain, for each home and time.

    They are eqs. (7) to (9) of docs/theory/homing.md. Nothing is declared without terrain.
    """
    ground, floor = scenario.airspace.ground, m.airspace.component("floor")
    if ground is None:
        return
    tables = {}
    for k, home in enumerate(_homes(scenario)):
        surface = ground.surface_of_ways(home)
        lengths = {"units": units.m, "arg_units": [units.m, units.m]}
        tables[k] = Table(surface.x, surface.y, surface.heights, **lengths)
        b.add_component(f"ground_on_way_{k}", tables[k])

    @b.Expression(
        b.home, m.time, doc="least height of the return, docs/theory/homing.md eq. (7) [m]"
    )
    def height_home(b: Block, k: int, t: float) -> NumericExpression:
        body = b.parent_block().rigid_body
        above = tables[k](body.x[t], body.y[t])
        return above if floor is None else above + floor

    @b.Expression(b.home, m.time, doc="climb to that height, docs/theory/homing.md eq. (8) [m]")
    def climb(b: Block, k: int, t: float) -> NumericExpression:
        missing = b.height_home[k, t] - b.parent_block().rigid_body.z[t]
        return smooth_positive(missing, _CLIMB_WIDTH)

    @b.Expression(b.home, m.time, doc="level way and descent, docs/theory/homing.md eq. (9) [m]")
    def way_flown(b: Block, k: int, t: float) -> NumericExpression:
        body = b.parent_block().rigid_body
        descent = body.z[t] + b.climb[k, t] - b.home_z[k]
        level = (b.home_x[k] - body.x[t]) ** 2 + (b.home_y[k] - body.y[t]) ** 2
        return sqrt(level + _AT_HOME**2) + sqrt(descent**2 + _AT_HOME**2)


def _declare_charge(b: Block, m: ConcreteModel) -> None:
    @b.Expression(
        b.home,
        m.time,
        doc="charge of the return with its margin, docs/theory/homing.md eqs. (4), (10) [A h]",
    )
    def charge_to(b: Block, k: int, t: float) -> NumericExpression:
        if b.component("climb") is None:
            drawn = b.current * b.way[k, t] / b.ground_speed[k, t]
        else:
            drawn = b.current * b.way_flown[k, t] / b.ground_speed[k, t]
            drawn += b.climb_current * b.climb[k, t] / b.climb_rate
        return units.convert((1 + b.margin) * drawn, to_units=CHARGE)

    @b.Expression(
        m.time, doc="charge of the return to the nearest home, docs/theory/homing.md eq. (5) [A h]"
    )
    def charge_home(b: Block, t: float) -> NumericExpression:
        homes = list(b.home)
        if len(homes) == 1:
            return b.charge_to[homes[0], t]
        # A mean whose weights decrease with the charge is smooth and never below the minimum.
        capacity = b.parent_block().battery.pack_capacity
        weights = [
            exp(-_SHARPNESS * (b.charge_to[k, t] - b.charge_to[homes[0], t]) / capacity)
            for k in homes
        ]
        weighted = sum(w * b.charge_to[k, t] for w, k in zip(weights, homes, strict=True))
        return weighted / sum(weights)
