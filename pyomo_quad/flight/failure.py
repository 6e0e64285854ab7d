"""Why no plan was found, in words that say what to change."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pyomo_quad.collocation import Diagnosis, Relaxation

__all__ = ["Failure"]


@dataclass(frozen=True, kw_only=True)
class Failure:
    """The diagnosis of a solve that failed.

    Attributes
    ----------
    duration_s : float
        The mission's duration.
    shortest_duration_s : float or None
        The least time in which the mission can be flown within its limits; None where none was
        found.
    diagnosis : Diagnosis
        The engine's: worst equations, active limits, what has to give way together.
    remedies : tuple of Relaxation
        Single limits whose change alone would make the mission possible.
    """

    duration_s: float
    shortest_duration_s: float | None
    diagnosis: Diagnosis
    remedies: tuple[Relaxation, ...]

    @property
    def is_too_short(self) -> bool:
        """Whether more time would do."""
        return self.shortest_duration_s is not None and self.shortest_duration_s > self.duration_s

    def causes(self) -> Iterator[str]:
        """Yield one sentence per cause or remedy, the plainest first."""
        if self.shortest_duration_s is not None and self.is_too_short:
            missing = self.shortest_duration_s - self.duration_s
            limits = ", ".join(str(limit.name) for limit in self.diagnosis.active) or "its limits"
            yield (
                f"mission.duration = {self.duration_s:g} s is {missing:.3g} s too short: within "
                f"{limits} the goal takes at least {self.shortest_duration_s:.4g} s."
            )
        for remedy in self.remedies:
            yield (
                f"{remedy.name} = {remedy.limit:.6g} {remedy.unit}: the mission would be "
                f"possible if this alone gave way by {remedy.amount:.4g} {remedy.unit}."
            )
        for relaxation in self.diagnosis.relaxations:
            yield f"least change that makes the mission possible: {relaxation}."
