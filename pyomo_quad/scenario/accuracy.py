"""Accuracy levels of a plan: tolerances of its energy, states and limits.

A vehicle model predicts power to about 2 %. The levels `quick` and `standard` therefore suffice for
real flights; the level `proof` is for studies that compare small differences of energy.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from math import inf
from types import MappingProxyType


class Accuracy(StrEnum):
    """Accuracy that a scenario requires of its plan: `QUICK`, `STANDARD` or `PROOF`.

    The members are listed in ascending order of accuracy. The class `Figures` holds the numerical
    tolerances that each of these levels stands for.
    """

    QUICK = "quick"
    STANDARD = "standard"
    PROOF = "proof"

    def meets(self, asked: "Accuracy") -> bool:
        """Return whether this level is at least as accurate as the required level, `asked`."""
        order = list(Accuracy)
        return order.index(self) >= order.index(asked)


@dataclass(frozen=True, kw_only=True)
class Figures:
    """Tolerances that a plan and the simulation of its controls must meet at an accuracy level.

    Attributes
    ----------
    energy : float
        Relative tolerance of the energy.
    miss : float
        Largest deviation of a state x [m, m/s or rad] from the goal at the end, divided by
        max(abs(x), 1).
    breach : float
        Largest relative violation of a limit.
    turning : float
        Largest rate of a heading that must be constant [rad/s].
    intrusion : float
        Largest violation of an airspace limit [m].
    integration : float
        Relative and absolute tolerance of the simulation.
    spacing : float
        Distance between neighbouring places of the path at which zones are checked [m].
    """

    # Bounds the difference between the plan's energy and the least energy, and between the
    # simulated energy and the plan's energy. Mesh refinement stops when the collocation error of
    # the states is at most this tolerance.
    energy: float
    # The simulation has no feedback. The deviation of a state x [m, m/s or rad] is divided by
    # max(abs(x), 1). For a waypoint, `miss` bounds the distance [m] outside its radius.
    miss: float
    # Between collocation points: the violation divided by max(abs(limit), 1).
    breach: float
    # About 3 deg/s at `quick`, and 0.5 deg/s at `standard`. A brief turn at these rates changes
    # neither the path nor the energy.
    turning: float
    # Airspace limits are the distance from a zone, floor, ceiling and fence. A flight must satisfy
    # both `breach` and `intrusion`, because a relative tolerance is wide at a high limit: 1 % of a
    # ceiling at 50 m is half a metre. At the level `proof`, `breach` alone is strict enough (5 mm
    # at 50 m), and `intrusion` is infinite.
    intrusion: float
    # In a flight without feedback, errors grow about a millionfold in half a minute. The value is
    # therefore far below the other tolerances.
    integration: float
    # At these places the simulated path is checked for entry into a keep-out zone. Parts of the
    # path far from all zones are checked less densely.
    spacing: float


#: Tolerances of each accuracy level. The spacing bounds how far a straight flight can enter a zone
#: between two checked places: at 5 mm, less than 1e-5 m into a ball with a radius of half a metre,
#: and less than 4e-4 m into the edge of a zone. The first depth grows at most with the square of
#: the spacing, the second in proportion to the spacing.
FIGURES: Mapping[Accuracy, Figures] = MappingProxyType(
    {
        Accuracy.QUICK: Figures(
            energy=1e-3,
            miss=0.1,
            breach=1e-2,
            turning=5e-2,
            intrusion=2e-3,
            integration=1e-10,
            spacing=5e-2,
        ),
        Accuracy.STANDARD: Figures(
            energy=1e-4,
            miss=1e-2,
            breach=1e-3,
            turning=1e-2,
            intrusion=1e-3,
            integration=1e-11,
            spacing=1e-2,
        ),
        Accuracy.PROOF: Figures(
            energy=1e-6,
            miss=1e-4,
            breach=1e-4,
            turning=1e-4,
            intrusion=inf,
            integration=1e-12,
            spacing=5e-3,
        ),
    }
)
#: Tolerances of a usable plan. It may end half a metre from the goal, and turn the heading at up to
#: 6 degrees a second for a moment: feedback in flight corrects both.
USABLE = replace(FIGURES[Accuracy.QUICK], miss=0.5, turning=0.1)
