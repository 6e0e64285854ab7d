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
        Ends of the range of uncertainty. For most vehicles of this size, the property lies in this
        range. For a given or computed value, `low` and `high` equal the value.
    kind : Kind
        Whether the value was given, computed, estimated or measured.
    said : str
        Description of the origin: command-line option, formula or publication.
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

    Parameters
    ----------
    value : float
        The value, in SI units.
    said : str
        Description of the value's origin, such as the name of the command-line option.
    """
    return Estimate(value=value, low=value, high=value, kind=Kind.GIVEN, said=said)


def computed(value: float, formula: str) -> Estimate:
    """Make an `Estimate`, without range, of a value that follows from other values.

    Parameters
    ----------
    value : float
        The value, in SI units.
    formula : str
        Formula as text.
    """
    return Estimate(value=value, low=value, high=value, kind=Kind.COMPUTED, said=formula)


def estimated(value: float, said: str, low: float, high: float) -> Estimate:
    """Make an `Estimate` of a value that is uncertain within a given range.

    Parameters
    ----------
    value : float
        Best value, in SI units.
    said : str
        Description of the estimate.
    low, high : float
        Ends of the range, divided by the value.
    """
    return Estimate(value=value, low=low * value, high=high * value, kind=Kind.ESTIMATED, said=said)
