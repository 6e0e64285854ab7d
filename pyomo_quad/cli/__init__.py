"""The command line."""

from pyomo_quad.cli.app import main

__all__ = ["main"]
