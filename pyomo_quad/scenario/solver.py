"""Settings of the collocation and of Ipopt."""

from pyomo_quad.scenario.fields import Number, Part, WholeNumber, quantity

__all__ = ["Solver"]


class Solver(Part):
    """First mesh, tolerance and bounds on the effort."""

    tolerance: Number = quantity("1", "relative error of states asked for", 1e-6, gt=0, le=1e-1)
    elements: WholeNumber = quantity("1", "elements of the first mesh", 10, ge=1, le=100_000)
    degree: WholeNumber = quantity("1", "degree of each element of the first mesh", 4, ge=1, le=20)
    max_iterations: WholeNumber = quantity("1", "Ipopt iterations per mesh", 150, ge=1)
    max_refinements: WholeNumber = quantity("1", "mesh refinements", 20, ge=0, le=100)
