"""The declared equations of the mission, each written once in Pyomo."""

from pyomo_quad.model.build import build_model, parameter_values, structure_key

__all__ = ["build_model", "parameter_values", "structure_key"]
