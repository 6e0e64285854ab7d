"""Numbers read off the declared model, for the floors above that do not import Pyomo."""

from typing import Any

from pyomo.environ import units, value

__all__ = ["convert", "number"]


def number(expression: Any) -> float:
    """Return what an expression of the model is worth now.

    Parameters
    ----------
    expression : Pyomo expression
        With all its variables and parameters given.

    Returns
    -------
    float
        In the expression's own unit.
    """
    return float(value(expression))


def convert(amount: float, unit: str, wanted: str) -> float:
    """Return an amount in another unit.

    Parameters
    ----------
    amount : float
        In the first unit.
    unit, wanted : str
        As Pyomo's units spell them, such as ``"coulomb"`` and ``"ampere_hour"``.

    Returns
    -------
    float
        In the second unit.
    """
    return float(
        units.convert_value(
            amount, from_units=getattr(units, unit), to_units=getattr(units, wanted)
        )
    )
