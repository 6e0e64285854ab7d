"""Limits over time: the limited values, their bounds, and the worst violation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pyomo_quad.collocation.mesh import FloatArray


@dataclass(frozen=True)
class Violation:
    """The worst violation of one limit: its name, size in its own unit, bound and time."""

    name: str
    size: float
    bound: float
    time: float

    @property
    def relative(self) -> float:
        """Size relative to the larger of 1 and the bound."""
        return self.size / max(1.0, abs(self.bound))


@dataclass(frozen=True)
class LimitValues:
    """A limit at n instants: its name, the limited values and their bounds."""

    name: str
    values: FloatArray
    lower: FloatArray
    upper: FloatArray

    def worst(self, chosen: slice, t: FloatArray) -> Violation:
        """Return the worst violation among some of the instants."""
        values, lower, upper = self.values[chosen], self.lower[chosen], self.upper[chosen]
        below, above = lower - values, values - upper
        size = np.maximum(below, above)
        at = int(np.argmax(size))
        bound = lower[at] if below[at] > above[at] else upper[at]
        bound = float(bound) if np.isfinite(bound) else 0.0
        return Violation(self.name, max(float(size[at]), 0.0), bound, float(t[at]))
