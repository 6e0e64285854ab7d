"""Explanation of a failed solve to the user: causes and remedies in terms of the mission."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pyomo_quad.collocation import Diagnosis, Relaxation
    from pyomo_quad.scenario.mission import NamedDuration


@dataclass(frozen=True, kw_only=True)
class Failure:
    """Explanation of a failed solve in terms of the mission.

    Attributes
    ----------
    longest : NamedDuration
        Duration of the mission; if it is free, the greatest allowed duration.
    shortest_duration_s : float or None
        Least possible duration; None if it was not found.
    diagnosis : Diagnosis
        Diagnosis of the failed solve.
    remedies : tuple of Relaxation
        Single limits whose relaxation alone would make the mission possible.
    doubt : str
        Reason to believe that the mission is possible, or empty.
    """

    longest: NamedDuration
    shortest_duration_s: float | None
    diagnosis: Diagnosis
    remedies: tuple[Relaxation, ...]
    doubt: str = ""

    @property
    def is_too_short(self) -> bool:
        """Whether the mission's duration is shorter than the least possible duration.

        The two durations are the attributes `longest` and `shortest_duration_s`. The result is
        False if `shortest_duration_s` is None.
        """
        return (
            self.shortest_duration_s is not None and self.shortest_duration_s > self.longest.value
        )

    def causes(self) -> Iterator[str]:
        """Yield one sentence for each cause of the failure and each remedy, the simplest first.

        If there is reason to believe that the mission is possible (attribute `doubt`), this reason
        is the only sentence. Causes and remedies would assume that the mission is impossible.
        """
        if self.doubt:
            yield self.doubt
            return
        if self.shortest_duration_s is not None and self.is_too_short:
            missing = self.shortest_duration_s - self.longest.value
            limits = ", ".join(str(limit.name) for limit in self.diagnosis.active) or "its limits"
            yield (
                f"{self.longest.field} = {self.longest.value:g} s is {missing:.3g} s too short: "
                f"within {limits} the goal takes at least {self.shortest_duration_s:.4g} s."
            )
        for remedy in self.remedies:
            yield (
                f"{remedy.name} = {remedy.limit:.6g} {remedy.unit}: the mission would be "
                f"possible if this limit alone were relaxed by {remedy.amount:.4g} {remedy.unit}."
            )
        for relaxation in self.diagnosis.relaxations:
            yield f"least change that makes the mission possible: {relaxation}."
