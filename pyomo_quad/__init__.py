"""Minimum-energy quadrotor flight in wind, declared, solved, verified and compared."""

from pyomo_quad.version import __version__

__all__ = ["__version__"]
