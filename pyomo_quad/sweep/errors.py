"""Errors of sweeps: one line each, saying what to do."""

from pyomo_quad.scenario.messages import OutputError, PyomoQuadError, ScenarioError


class StudyError(ScenarioError):
    """A study file says something that is not allowed."""


class StoreError(OutputError):
    """A result store cannot be used for what was asked."""


class ClusterError(PyomoQuadError, RuntimeError):
    """A Dask cluster cannot be reached or was lost; finished cases are kept."""
