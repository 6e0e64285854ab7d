"""Errors that a user's input can cause: one line each, naming the field and what is allowed."""

__all__ = ["FeasibilityError", "OutputError", "PyomoQuadError", "ScenarioError"]


class PyomoQuadError(Exception):
    """Base of every error that pyomo_quad raises on purpose."""


class ScenarioError(PyomoQuadError, ValueError):
    """A scenario, library or wind file says something that is not allowed."""


class FeasibilityError(PyomoQuadError, ValueError):
    """A valid scenario asks for something that the vehicle cannot physically do."""


class OutputError(PyomoQuadError, RuntimeError):
    """The results cannot be written where they were asked for."""
