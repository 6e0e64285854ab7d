"""Accuracy levels of a mission: tolerances that a plan and its simulated flight must meet.

A vehicle model is good to about 2 %: `quick` and `standard` suffice for missions that are flown,
`proof` for studies that compare small differences.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from types import MappingProxyType


class Accuracy(StrEnum):
    """Required accuracy of a plan, the least accurate first."""

    QUICK = "quick"
    STANDARD = "standard"
    PROOF = "proof"

    def meets(self, asked: "Accuracy") -> bool:
        """Return whether this accuracy is at least as high as another."""
        order = list(Accuracy)
        return order.index(self) >= order.index(asked)


@dataclass(frozen=True, kw_only=True)
class Figures:
    """Tolerances of an accuracy level.

    Attributes
    ----------
    energy : float
        Share of the energy by which the plan's may be above the least one, and the flight of the
        controls may differ from the plan; also the relative error of states to which the mesh is
        refined.
    miss : float
        Of any final state when the controls are flown open loop, and of the waypoints: metres,
        metres per second, radians or, for values above 1, relative.
    breach : float
        Of a limit between the points, relative to the larger of 1 and the limit.
    integration : float
        Relative and absolute tolerance of the flight.  Errors of a flight without feedback grow
        about a millionfold in half a minute.
    spacing : float
        Distance [m] between the samples at which the flight is compared with zones.
    """

    energy: float
    miss: float
    breach: float
    integration: float
    spacing: float


#: Errors allowed at each accuracy.  Between samples 5 mm apart, a straight flight cuts into a ball
#: of half a metre by less than 1e-5 m and into the edge of a zone by less than 4e-4 m; the former
#: grows at most with the square of the spacing, the latter in proportion to it.
FIGURES: Mapping[Accuracy, Figures] = MappingProxyType(
    {
        Accuracy.QUICK: Figures(
            energy=1e-3,
            miss=0.1,
            breach=1e-2,
            integration=1e-10,
            spacing=5e-2,
        ),
        Accuracy.STANDARD: Figures(
            energy=1e-4,
            miss=1e-2,
            breach=1e-3,
            integration=1e-11,
            spacing=1e-2,
        ),
        Accuracy.PROOF: Figures(
            energy=1e-6,
            miss=1e-4,
            breach=1e-4,
            integration=1e-12,
            spacing=5e-3,
        ),
    }
)
#: Errors of a usable plan. It may end half a metre off, which feedback in flight corrects.
USABLE = replace(FIGURES[Accuracy.QUICK], miss=0.5)
