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
        Relative tolerance of two differences: the plan's energy may differ from the least energy,
        and the simulated energy may differ from the plan's energy. Mesh refinement stops when the
        collocation error of the states is at most this tolerance.
    miss : float
        Largest deviation of the simulated final state from the mission's goal, and of the simulated
        position from each waypoint. The simulation has no feedback. The tolerance applies to each
        state in the state's unit: m, m/s or rad. For a state of magnitude above 1, the deviation is
        divided by the magnitude.
    breach : float
        Largest violation of a limit between collocation points, divided by the limit's magnitude.
        A magnitude below 1 counts as 1.
    turning : float
        Largest tolerated rate of change of the heading [rad/s], in a mission whose heading must
        stay constant. The level `quick` tolerates about three degrees per second, and the level
        `standard` about half a degree per second. These rates are harmless: a brief slow turn
        changes neither the path nor the energy.
    intrusion : float
        Largest distance [m] by which the flight may violate a limit of the airspace: the required
        distance from a keep-out zone, the floor, the ceiling or the fence. The tolerance `breach`
        applies to these limits, too: both tolerances must be met. Without `intrusion`, 1 % of
        `breach` would allow half a metre at a ceiling of 50 m. At the level `proof`, `intrusion` is
        infinite, so that only `breach` applies.
    integration : float
        Relative and absolute tolerance of the simulation. The value is far below the other
        tolerances, because errors of a flight without feedback grow about a millionfold in half a
        minute.
    spacing : float
        Distance [m] between neighbouring places at which the simulated path is checked for entry
        into a keep-out zone. Only the parts of the path near a zone are checked so densely.
    """

    energy: float
    miss: float
    breach: float
    turning: float
    intrusion: float
    integration: float
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
