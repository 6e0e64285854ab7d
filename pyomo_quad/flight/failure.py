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
        The duration that the mission prescribes. If the duration is free, the greatest duration
        that the mission allows. The value comes with the name of its scenario field.
    shortest_duration_s : float or None
        The least duration in which the mission can be flown within its limits. A solve that
        minimises the duration finds it. None if there was no such solve or it failed.
    diagnosis : Diagnosis
        Diagnosis of the failed solve. It has the equations with the largest residuals, the active
        limits, and the limits that must all be relaxed together to make the mission feasible.
    remedies : tuple of Relaxation
        Single limits whose relaxation alone would make the mission possible.
    doubt : str
        Reason to believe that the mission is possible although no flight was found; empty if there
        is no such reason.
    """

    longest: NamedDuration
    shortest_duration_s: float | None
    diagnosis: Diagnosis
    remedies: tuple[Relaxation, ...]
    doubt: str = ""

    @property
    def is_too_short(self) -> bool:
        """Whether the mission's duration is shorter than the least possible duration.

        A mission of free duration is judged by the greatest duration that it allows. The least
        possible duration is the attribute `shortest_duration_s`. The result is False if this
        attribute is None.
        """
        return (
            self.shortest_duration_s is not None and self.shortest_duration_s > self.longest.value
        )

    def causes(self) -> Iterator[str]:
        """Yield one sentence for each cause of the failure and each remedy, the simplest first.

        If the attribute `doubt` is not empty, it is the only sentence: causes and remedies assume
        that the mission is impossible, and `doubt` is a reason to believe that it is possible.
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
