"""Limits on variables and expressions over time: values, bounds, and the worst violation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pyomo_quad.collocation.mesh import FloatArray


@dataclass(frozen=True)
class Violation:
    """Worst violation of a limit over time.

    Attributes
    ----------
    name : str
        Name of the component that declares the limit.
    size : float
        Amount by which the limit is exceeded, in the limit's unit; 0 if the limit is satisfied.
    bound : float
        Value of the limit at the time of the worst violation; 0 if this value is infinite.
    time : float
        Physical time of the worst violation. For a satisfied limit, the time at which the quantity
        is nearest to the limit.
    """

    name: str
    size: float
    bound: float
    time: float

    @property
    def relative(self) -> float:
        """Size of the violation relative to max(1, abs(bound)), dimensionless.

        Here `bound` is the value of the limit at the time of the worst violation.
        """
        return self.size / max(1.0, abs(self.bound))


def outside(values: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return by how much values lie outside their bounds, relative to max(1, abs(bound)).

    Here `bound` is the violated bound. The result is 0 for a value between its bounds, which may be
    infinite.
    """
    with np.errstate(invalid="ignore"):
        below = (lower - values) / np.maximum(1.0, np.abs(lower))
        above = (values - upper) / np.maximum(1.0, np.abs(upper))
    return np.nan_to_num(np.fmax(np.fmax(below, above), 0.0), nan=0.0)


@dataclass(frozen=True)
class LimitValues:
    """Values of a limited quantity at n times, with the lower and upper bounds at these times.

    Attributes
    ----------
    name : str
        Name of the component that declares the limit.
    values : ndarray, shape (n,)
        Values of the limited variable or expression, in its own unit.
    lower, upper : ndarray, shape (n,)
        Bounds at the same times; infinite where there is no bound.
    """

    name: str
    values: FloatArray
    lower: FloatArray
    upper: FloatArray

    @property
    def relative_violations(self) -> FloatArray:
        """Violations at the n times relative to max(1, abs(bound)), shape (n,).

        Here `bound` is the violated bound at that time, the lower or the upper bound. The violation
        is 0 for a value between the bounds.
        """
        return outside(self.values, self.lower, self.upper)

    def worst(self, chosen: slice, t: FloatArray) -> Violation:
        """Return the worst violation of the limit among a range of times.

        `chosen` are the positions of these times, and `t` the chosen times only. If the limit is
        satisfied, the size of the violation is 0.
        """
        values, lower, upper = self.values[chosen], self.lower[chosen], self.upper[chosen]
        below, above = lower - values, values - upper
        size = np.maximum(below, above)
        at = int(np.argmax(size))
        bound = lower[at] if below[at] > above[at] else upper[at]
        bound = float(bound) if np.isfinite(bound) else 0.0
        return Violation(self.name, max(float(size[at]), 0.0), bound, float(t[at]))
