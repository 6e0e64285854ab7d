"""Values of a vehicle's properties, such as its mass, with their uncertainty and origin."""

from dataclasses import dataclass
from enum import StrEnum


class Kind(StrEnum):
    """Origin of a property's value: given by the owner, computed, estimated or measured."""

    GIVEN = "given"
    COMPUTED = "computed"
    ESTIMATED = "estimated"
    MEASURED = "fitted to the hover measurement"


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Value of a vehicle's property, such as its mass, with range and origin.

    Attributes
    ----------
    value : float
        Best value, in SI units.
    low, high : float
        Range in which the property of most vehicles of this size lies. For a given or computed
        value, both equal the value.
    kind : Kind
        Whether the value was given, computed, estimated or measured.
    said : str
        Origin: command-line option, formula or publication.
    """

    value: float
    low: float
    high: float
    kind: Kind
    said: str

    @property
    def source(self) -> str:
        """Source of the value as text for a vehicle file: kind, origin and range."""
        if self.low < self.high:
            return f"{self.kind.value}: {self.said}; range {self.low:.3g} to {self.high:.3g}"
        return f"{self.kind.value}: {self.said}"

    @property
    def spread(self) -> float:
        """Width of the range of uncertainty divided by the value, dimensionless."""
        return (self.high - self.low) / self.value if self.value else 0.0


def given(value: float, said: str) -> Estimate:
    """Make an `Estimate`, without range, of a value that the vehicle's owner has stated.

    `value` is in SI units. `said` describes the value's origin, such as the name of the
    command-line option.
    """
    return Estimate(value=value, low=value, high=value, kind=Kind.GIVEN, said=said)


def computed(value: float, formula: str) -> Estimate:
    """Make an `Estimate`, without range, of a value that follows from other values by a formula.

    `value` is in SI units. `formula` is the formula as text, the value's origin.
    """
    return Estimate(value=value, low=value, high=value, kind=Kind.COMPUTED, said=formula)


def estimated(value: float, said: str, low: float, high: float) -> Estimate:
    """Make an `Estimate` of a value that is uncertain within a given range.

    `value` is in SI units. `said` describes its origin, such as a formula or publication. `low` and
    `high` are the ends of the range, divided by the value.
    """
    return Estimate(value=value, low=low * value, high=high * value, kind=Kind.ESTIMATED, said=said)
