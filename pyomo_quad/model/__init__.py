"""The continuous-time Pyomo model of a mission, in which every equation is declared once."""

from pyomo_quad.model.build import (
    ask_for_least_time,
    build_in_turbulence,
    build_model,
    build_remaining,
    load_builder,
    model_builder,
    parameter_values,
    structure_key,
)
from pyomo_quad.model.screening import ModelInspection, inspect_model

__all__ = [
    "ModelInspection",
    "ask_for_least_time",
    "build_in_turbulence",
    "build_model",
    "build_remaining",
    "inspect_model",
    "load_builder",
    "model_builder",
    "parameter_values",
    "structure_key",
]
