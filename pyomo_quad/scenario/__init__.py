"""Scenarios: complete descriptions of missions, read from TOML files and validated.

A scenario holds vehicle, battery, wind, mission, airspace, limits and settings of the solver.
Values that the file leaves out come from a library of vehicles, batteries and winds.
"""

from pyomo_quad.scenario.description import FieldDescription, describe_fields, field_unit
from pyomo_quad.scenario.loader import load_scenario, scenario_from_mapping
from pyomo_quad.scenario.messages import (
    FeasibilityError,
    OutputError,
    PyomoQuadError,
    ScenarioError,
)
from pyomo_quad.scenario.resolution import LIBRARY_KINDS, LibraryEntry, library_entry, library_names
from pyomo_quad.scenario.schema import Scenario
from pyomo_quad.scenario.tables import (
    PowerModel,
    Reference,
)
from pyomo_quad.scenario.vehicle import Attitude, Vehicle
from pyomo_quad.scenario.wind import FrequencyUnit, Wind, WindAxis, WindCoupling

__all__ = [
    "LIBRARY_KINDS",
    "Attitude",
    "FeasibilityError",
    "FieldDescription",
    "FrequencyUnit",
    "LibraryEntry",
    "OutputError",
    "PowerModel",
    "PyomoQuadError",
    "Reference",
    "Scenario",
    "ScenarioError",
    "Vehicle",
    "Wind",
    "WindAxis",
    "WindCoupling",
    "describe_fields",
    "field_unit",
    "library_entry",
    "library_names",
    "load_scenario",
    "scenario_from_mapping",
]
