"""How the report on the paper prints numbers: kilojoules, as the paper does."""

from math import isfinite

from pyomo_quad.report.wording import NOTHING, fixed, rough

__all__ = ["kilojoules", "metres"]

_KILO = 1e3
_LARGEST_PLAIN = 1e6  # J
_SMALLEST_PLAIN = 1e-2  # m


def kilojoules(energy: float, digits: int = 3) -> str:
    """Return an energy in kJ.

    Parameters
    ----------
    energy : float
        J.
    digits : int, default 3
        Decimals.

    Returns
    -------
    str
        Two significant digits where the energy is beyond all reason, words where infinite.
    """
    if energy == -float("inf"):
        return "no minimum"
    if not isfinite(energy):
        return NOTHING
    return fixed(energy / _KILO, digits) if abs(energy) < _LARGEST_PLAIN else rough(energy / _KILO)


def metres(distance: float) -> str:
    """Return a distance from the goal in m.

    Parameters
    ----------
    distance : float
        m, not negative.

    Returns
    -------
    str
        Two decimals, or two significant digits where that would say zero.
    """
    return fixed(distance) if distance >= _SMALLEST_PLAIN else rough(distance)
