"""Numbers of a vehicle with their origin: given, computed, or estimated with a range."""

from dataclasses import dataclass
from enum import StrEnum


class Kind(StrEnum):
    """Origin of a number."""

    GIVEN = "given"
    COMPUTED = "computed"
    ESTIMATED = "estimated"
    MEASURED = "fitted to the hover measurement"


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A number with its range and a description of its origin.

    The range covers vehicles of this kind, by the source named in `said`. The range of a given or
    computed number is the number itself.
    """

    value: float
    low: float
    high: float
    kind: Kind
    said: str

    @property
    def source(self) -> str:
        """Source of the number, for a vehicle file."""
        if self.low < self.high:
            return f"{self.kind.value}: {self.said}; range {self.low:.3g} to {self.high:.3g}"
        return f"{self.kind.value}: {self.said}"

    @property
    def spread(self) -> float:
        """Width of the range relative to the value."""
        return (self.high - self.low) / self.value if self.value else 0.0


def given(value: float, said: str) -> Estimate:
    """Return a number stated by the owner."""
    return Estimate(value=value, low=value, high=value, kind=Kind.GIVEN, said=said)


def computed(value: float, formula: str) -> Estimate:
    """Return a number computed from other numbers."""
    return Estimate(value=value, low=value, high=value, kind=Kind.COMPUTED, said=formula)


def estimated(value: float, said: str, low: float, high: float) -> Estimate:
    """Return an estimated number, with factors for the ends of its range."""
    return Estimate(value=value, low=low * value, high=high * value, kind=Kind.ESTIMATED, said=said)
