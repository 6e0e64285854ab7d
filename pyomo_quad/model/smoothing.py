"""Smooth stand-ins for `max`, so that every declared equation has two derivatives."""

from pyomo.core import sqrt, tanh
from pyomo.core.expr import NumericExpression


def positive_part(value: NumericExpression, width: NumericExpression) -> NumericExpression:
    """Return a smooth max(value, 0): convex, increasing, never negative.

    Parameters
    ----------
    value : expression
        Any quantity.
    width : expression
        Half the distance over which the corner is rounded, same unit.

    Returns
    -------
    expression
        Exceeds the true maximum by width/2 at value = 0 and by width^2/(4 |value|) far off.
    """
    return (value + sqrt(value**2 + width**2)) / 2


def floored(
    value: NumericExpression, floor: NumericExpression, width: NumericExpression
) -> NumericExpression:
    """Return a smooth max(value, floor) that never falls below the floor.

    Parameters
    ----------
    value, floor : expression
        Quantities of the same unit.
    width : expression
        As for `positive_part`.

    Returns
    -------
    expression
        The rounded maximum.
    """
    return floor + positive_part(value - floor, width)


def saturated(
    value: NumericExpression, floor: NumericExpression, width: NumericExpression
) -> NumericExpression:
    """Return `value` while it is well above the floor, and the floor far below it.

    Parameters
    ----------
    value, floor : expression
        Quantities of the same unit.
    width : expression
        Ten times this above the floor, value and result agree to 2e-8 of the width; near the
        floor the result may dip below it by 0.14 of the width.

    Returns
    -------
    expression
        Exact to rounding in the range where an equation is meant to be used, finite outside,
        and free of overflow, which a softplus is not.
    """
    excess = value - floor
    return floor + excess * (1 + tanh(excess / width)) / 2
