"""Plans as autopilots, swarms, simulators and ROS read them, each within a stated error."""

from pyomo_quad.exports.formats import Export, Format, export_plan
from pyomo_quad.exports.motion import Motion, PolynomialTrajectory

__all__ = ["Export", "Format", "Motion", "PolynomialTrajectory", "export_plan"]
