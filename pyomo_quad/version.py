"""Version number of the package pyomo_quad."""

__version__ = "0.2.0"
