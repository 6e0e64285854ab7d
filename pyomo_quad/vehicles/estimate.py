"""Number of a vehicle with its range and its origin: given, computed, estimated or measured."""

from dataclasses import dataclass
from enum import StrEnum


class Kind(StrEnum):
    """Origin of a vehicle's number: given by the owner, computed, estimated or measured."""

    GIVEN = "given"
    COMPUTED = "computed"
    ESTIMATED = "estimated"
    MEASURED = "fitted to the hover measurement"


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Number of a vehicle, with the range in which it may lie and its origin.

    Attributes
    ----------
    value : float
        Best value, in SI units.
    low, high : float
        Range that covers vehicles of this kind, by the source in `said`. For a given or computed
        number both equal the value.
    kind : Kind
        Whether the number was given, computed, estimated or measured.
    said : str
        Description of the origin: option, formula or publication.
    """

    value: float
    low: float
    high: float
    kind: Kind
    said: str

    @property
    def source(self) -> str:
        """Source of the number as text for a vehicle file: kind, origin and range."""
        if self.low < self.high:
            return f"{self.kind.value}: {self.said}; range {self.low:.3g} to {self.high:.3g}"
        return f"{self.kind.value}: {self.said}"

    @property
    def spread(self) -> float:
        """Width of the number's range relative to its value."""
        return (self.high - self.low) / self.value if self.value else 0.0


def given(value: float, said: str) -> Estimate:
    """Make the number that the vehicle's owner has stated, without range.

    Parameters
    ----------
    value : float
        The number, in SI units.
    said : str
        Description of its origin, such as the option.
    """
    return Estimate(value=value, low=value, high=value, kind=Kind.GIVEN, said=said)


def computed(value: float, formula: str) -> Estimate:
    """Make a number that follows from other numbers, without range.

    Parameters
    ----------
    value : float
        The number, in SI units.
    formula : str
        Formula as text.
    """
    return Estimate(value=value, low=value, high=value, kind=Kind.COMPUTED, said=formula)


def estimated(value: float, said: str, low: float, high: float) -> Estimate:
    """Make an estimated number with its range.

    Parameters
    ----------
    value : float
        Best value, in SI units.
    said : str
        Description of the estimate.
    low, high : float
        Ends of the range, as factors on the value.
    """
    return Estimate(value=value, low=low * value, high=high * value, kind=Kind.ESTIMATED, said=said)
