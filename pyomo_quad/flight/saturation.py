"""Smooth limits: what a real actuator or a prudent estimate must not exceed."""

from collections.abc import Sequence
from math import sqrt, tanh

__all__ = ["bend", "braking_rate", "project"]

# Below this share of the limit `bend` changes nothing, so that small signals stay linear.
_LINEAR_SHARE = 0.8
# Width of the layer below the bound in which `project` turns outward motion aside.
_PROJECTION_LAYER = 0.1


def bend(magnitude: float, limit: float) -> float:
    """Limit a number smoothly, leaving it untouched well below the limit.

    Parameters
    ----------
    magnitude : float
        Any number.
    limit : float
        Largest absolute value of the result, positive.

    Returns
    -------
    float
        The number itself up to 80 % of the limit, then a tanh that approaches the limit; two
        derivatives are continuous.
    """
    straight = _LINEAR_SHARE * limit
    excess = abs(magnitude) - straight
    if excess <= 0:
        return magnitude
    rest = limit - straight
    bent = straight + rest * tanh(excess / rest)
    return bent if magnitude > 0 else -bent


def braking_rate(error: float, gain: float, acceleration_max: float) -> float:
    """Return the rate at which to close an error so that it can still be braked.

    Parameters
    ----------
    error : float
        Distance to go.
    gain : float
        Rate over error for small errors, 1/s.
    acceleration_max : float
        Largest deceleration available.

    Returns
    -------
    float
        ``gain * error`` for small errors, the square root of ``acceleration_max * error`` for
        large ones.

    Notes
    -----
    Along the returned curve the deceleration r dr/de equals a/2 q (2 + q) / (1 + q)^2 with
    q = gain^2 |e| / a: it never exceeds half of what is available, whatever the gain.
    """
    return gain * error / sqrt(1 + gain**2 * abs(error) / acceleration_max)


def project(estimate: Sequence[float], rate: Sequence[float], bound: float) -> list[float]:
    """Keep an estimate inside a ball by turning aside the outward part of its rate.

    Smooth projection of Krstic, Kanellakopoulos and Kokotovic (1995), appendix E.

    Parameters
    ----------
    estimate : sequence of float
        Present estimate, inside the ball.
    rate : sequence of float
        Rate that the adaptation law asks for.
    bound : float
        Radius of the ball.

    Returns
    -------
    list of float
        The rate to apply. Continuous in its arguments; for every true value inside 90 % of the
        ball, (estimate - true) . (result - rate) <= 0, so projecting never raises V.
    """
    outward = sum(d * r for d, r in zip(estimate, rate, strict=True))
    inner = bound * (1 - _PROJECTION_LAYER)
    size_squared = sum(d * d for d in estimate)
    depth = (size_squared - inner**2) / (bound**2 - inner**2)
    if depth <= 0 or outward <= 0:
        return list(rate)
    turned = min(depth, 1.0) * outward / size_squared
    return [r - turned * d for d, r in zip(estimate, rate, strict=True)]
