"""One thing about a mission or its model that its author should know before a solve."""

from dataclasses import dataclass
from enum import StrEnum

__all__ = ["Finding", "Severity"]


class Severity(StrEnum):
    """Whether a finding rules a flight out, or only asks for a second look."""

    IMPOSSIBLE = "impossible"
    CAUTION = "caution"


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A field or declaration, what was found there, and what is allowed, in one line.

    Attributes
    ----------
    severity : Severity
    subject : str
        Dotted field of the scenario, or full name of the component.
    message : str
        One line that names it.
    """

    severity: Severity
    subject: str
    message: str

    def __str__(self) -> str:
        return self.message
