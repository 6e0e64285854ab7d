"""The report of a sweep: tables and figures from its rows, without solving again."""

from pyomo_quad.report.sweep.sweep_report import write_sweep_report

__all__ = ["write_sweep_report"]
