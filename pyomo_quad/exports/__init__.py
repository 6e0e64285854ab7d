"""Export of plans to autopilots, swarms, simulators and ROS, with the error of each export."""

from pyomo_quad.exports.formats import Export, Format, export_plan
from pyomo_quad.exports.motion import Motion, PolynomialTrajectory

__all__ = ["Export", "Format", "Motion", "PolynomialTrajectory", "export_plan"]
