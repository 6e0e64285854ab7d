"""The ground: flat at z = 0, or terrain.

symbol | name | unit | meaning
U(x, y) | above | m | height of a smooth surface that is nowhere below the ground
L(x, y) | below | m | height of a smooth surface that is nowhere above the ground
z - U | height_limited_below | m | height above the surface U, limited by a floor
z - L | height_limited_above | m | height above the surface L, limited by a ceiling

z is the height coordinate of the vehicle. A floor is the least permitted height above the ground, a
ceiling the greatest. Over flat ground, both heights equal z, and the model has no block `ground`.

The ground of `airspace.terrain` is bilinear between the points of its grid. U and L are splines
through values on the same grid, which the module `scenario.surfaces` computes. The splines
(`collocation.Table`) are twice differentiable with exact derivatives, and the cost of an evaluation
is independent of the size of the grid.

The height above the ground is at least z - U and at most z - L. If z - U >= floor, the height above
the ground is therefore at least the floor. If z - L <= ceiling, it is at most the ceiling. The
attribute `excess` of a surface is its greatest vertical distance from the ground. The limit z - U
>= floor is stricter than the floor by at most `excess`.
"""

from typing import Any

from pyomo.core import Block, ConcreteModel, Expression
from pyomo.core.base.units_container import units
from pyomo.core.expr import NumericExpression

from pyomo_quad.collocation import Table
from pyomo_quad.scenario import Scenario

# Side of a surface, in `TerrainGrid.surface` -> its table, and the height of the vehicle over it.
_SURFACES = {1: ("above", "height_limited_below"), -1: ("below", "height_limited_above")}


def declare_ground(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare the heights of the vehicle above the terrain in block `ground` [m].

    They are `height_limited_below` for a floor and, if the airspace has a ceiling,
    `height_limited_above`. The docstring of this module defines both. Without terrain, nothing is
    declared.
    """
    grid = scenario.airspace.ground
    if grid is None:
        return
    b = m.ground = Block(doc="ground")
    for side, (name, height) in _SURFACES.items():
        if side < 0 and scenario.airspace.ceiling is None:
            continue
        surface = grid.surface(side)
        lengths = {"units": units.m, "arg_units": [units.m, units.m]}
        table = Table(surface.x, surface.y, surface.heights, **lengths)
        b.add_component(name, table)

        def above(b: Block, t: float, table: Table = table) -> NumericExpression:
            body = b.parent_block().rigid_body
            return body.z[t] - table(body.x[t], body.y[t])

        doc = f"height over the smooth surface {name} the ground [m]"
        b.add_component(height, Expression(m.time, rule=above, doc=doc))


def height_above_ground(m: ConcreteModel, t: float, side: int = 1) -> Any:
    """Return the height of the vehicle that a floor (`side` 1) or a ceiling (-1) limits [m].

    Over flat ground, it is z. Over terrain, it is the height above a smooth surface. For a floor,
    the surface is nowhere below the ground. For a ceiling, it is nowhere above the ground. Over
    terrain, `side` -1 is allowed only if the airspace has a ceiling.
    """
    b = m.component("ground")
    return m.rigid_body.z[t] if b is None else b.component(_SURFACES[side][1])[t]
