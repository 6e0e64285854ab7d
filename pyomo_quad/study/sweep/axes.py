"""Axes of a study: which scenario field varies, and over which values."""

import math
from typing import Any, Self

import numpy as np
from pydantic import field_validator, model_validator
from scipy.special import ndtri

from pyomo_quad.scenario.fields import Number, Part, Text, WholeNumber, quantity

__all__ = ["Axis", "NormalSpread", "Spacing", "UniformSpread", "kind_of"]

_MOST_VALUES = 100_000
# Values are stored, hashed and printed in decimal: 12 digits keep 0.3 from becoming
# 0.30000000000000004, and are finer than any tolerance of a solve.
_SIGNIFICANT_DIGITS = 12


class Spacing(Part):
    """Values from the first to the last, both included."""

    first: Number = quantity(
        "",
        "first value, in the unit of the field",
        other_names=("start", "begin", "from", "low", "min", "lower"),
    )
    last: Number = quantity(
        "",
        "last value, in the unit of the field",
        other_names=("stop", "end", "to", "high", "max", "upper"),
    )
    count: WholeNumber = quantity(
        "1",
        "number of values",
        ge=1,
        le=_MOST_VALUES,
        other_names=("n", "num", "number", "steps", "points", "size"),
    )


class UniformSpread(Part):
    """A uniform distribution."""

    low: Number = quantity(
        "",
        "lower end, in the unit of the field",
        other_names=("first", "start", "begin", "from", "min", "lower", "a"),
    )
    high: Number = quantity(
        "",
        "upper end, in the unit of the field",
        other_names=("last", "stop", "end", "to", "max", "upper", "b"),
    )

    def at(self, probabilities: np.ndarray) -> np.ndarray:
        """Return the values below which the distribution has the given probabilities."""
        return self.low + (self.high - self.low) * probabilities


class NormalSpread(Part):
    """A normal distribution."""

    mean: Number = quantity(
        "",
        "mean, in the unit of the field",
        other_names=("mu", "average", "center", "centre", "loc"),
    )
    standard_deviation: Number = quantity(
        "",
        "standard deviation, in the unit of the field",
        gt=0,
        other_names=("std", "stdev", "sigma", "sd", "deviation", "scale"),
    )

    def at(self, probabilities: np.ndarray) -> np.ndarray:
        """Return the values below which the distribution has the given probabilities."""
        return self.mean + self.standard_deviation * ndtri(probabilities)


_KINDS = ("values", "linear", "logarithmic", "uniform", "normal")


class Axis(Part):
    """One scenario field and the values it takes, given in exactly one way."""

    path: Text = quantity("", "dotted path of a scenario field", min_length=1, max_length=200)
    group: Text | None = quantity("", "axes of one group advance together", None, max_length=60)
    values: tuple[Any, ...] | None = quantity("", "the values themselves", None, min_length=1)
    linear: Spacing | None = quantity("", "equal steps", None)
    logarithmic: Spacing | None = quantity("", "equal ratios", None)
    uniform: UniformSpread | None = quantity("", "drawn from a uniform distribution", None)
    normal: NormalSpread | None = quantity("", "drawn from a normal distribution", None)

    @field_validator("values")
    @classmethod
    def _plain_values(cls, values: tuple[Any, ...] | None) -> tuple[Any, ...] | None:
        if any(kind_of(value) is None for value in values or ()):
            raise ValueError("must hold finite numbers, texts, booleans or lists of these")
        return values

    @model_validator(mode="after")
    def _given_once(self) -> Self:
        given = [kind for kind in _KINDS if getattr(self, kind) is not None]
        if len(given) != 1:
            raise ValueError(f"must have exactly one of {', '.join(_KINDS)}")
        ratio = self.logarithmic
        if ratio is not None and not (ratio.first > 0 and ratio.last > 0):
            raise ValueError("a logarithmic axis must have first and last > 0")
        if self.uniform is not None and not self.uniform.low < self.uniform.high:
            raise ValueError("a uniform axis must have low < high")
        if self.is_random and self.group is not None:
            raise ValueError("random axes are drawn together and must have no group")
        return self

    @property
    def is_random(self) -> bool:
        """Whether the values are drawn from a distribution."""
        return self.uniform is not None or self.normal is not None

    @property
    def count(self) -> int:
        """Number of values of an axis that is not random."""
        spacing = self.linear or self.logarithmic
        return spacing.count if spacing is not None else len(self.values or ())

    def spaced_values(self) -> tuple[Any, ...]:
        """Return the values of an axis that is not random.

        Returns
        -------
        tuple
            In the order of the study file.
        """
        if self.linear is not None:
            spacing = self.linear
            return rounded(np.linspace(spacing.first, spacing.last, spacing.count))
        if self.logarithmic is not None:
            spacing = self.logarithmic
            return rounded(np.geomspace(spacing.first, spacing.last, spacing.count))
        return self.values or ()

    def drawn_values(self, probabilities: np.ndarray) -> tuple[float, ...]:
        """Return the values of a random axis.

        Parameters
        ----------
        probabilities : ndarray, shape (n,)
            Draws from the unit interval.

        Returns
        -------
        tuple of float
            One value for each draw.
        """
        spread = self.uniform or self.normal
        return rounded(spread.at(probabilities)) if spread is not None else ()


def rounded(numbers: np.ndarray) -> tuple[float, ...]:
    """Round numbers to the digits in which axis values are kept.

    Parameters
    ----------
    numbers : ndarray, shape (n,)
        Any finite numbers.

    Returns
    -------
    tuple of float
        The numbers to twelve significant digits.
    """
    return tuple(float(f"{number:.{_SIGNIFICANT_DIGITS}g}") for number in numbers)


def kind_of(value: object) -> type | None:
    """Return the kind of a plain value, bool, float, str or list; None for anything else."""
    if isinstance(value, bool | str):
        return type(value)
    if isinstance(value, int | float):
        return float if math.isfinite(value) else None
    is_list = isinstance(value, list) and all(kind_of(part) not in {None, list} for part in value)
    return list if is_list else None
