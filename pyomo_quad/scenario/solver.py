"""Settings of the collocation and of Ipopt."""

from typing import Self

from pydantic import model_validator

from pyomo_quad.scenario.fields import Number, Part, Sound, WholeNumber, quantity

__all__ = ["Solver"]


# Points of the first mesh that a machine of 8 GB solves on; a thousand take about 0.1 GB.
_MOST_POINTS = 50_000


class Solver(Part):
    """First mesh, tolerance and bounds on the effort."""

    tolerance: Number = quantity(
        "1",
        "relative error of states asked for",
        1e-6,
        gt=0,
        le=1e-1,
        sound=Sound(1e-11, 0.1, "sums of thousands of terms are rounded by about 1e-12"),
    )
    elements: WholeNumber = quantity("1", "elements of the first mesh", 10, ge=1, le=100_000)
    degree: WholeNumber = quantity("1", "degree of each element of the first mesh", 4, ge=1, le=20)
    max_iterations: WholeNumber = quantity("1", "Ipopt iterations per mesh", 150, ge=1, le=100_000)
    time_limit: Number = quantity(
        "s",
        "time after which a solve, its fallbacks and its diagnosis are given up",
        300.0,
        gt=0,
        le=1e6,
    )
    max_refinements: WholeNumber = quantity("1", "mesh refinements", 20, ge=0, le=100)

    @model_validator(mode="after")
    def _fits_into_memory(self) -> Self:
        points = self.elements * self.degree
        if points > _MOST_POINTS:
            raise ValueError(
                f"elements = {self.elements} of degree = {self.degree} make {points} points; must "
                f"make at most {_MOST_POINTS}: more do not fit into memory, and refinement adds "
                "elements where they are wanted"
            )
        return self
