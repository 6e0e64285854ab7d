"""Export of plans to autopilots, swarms, simulators and ROS; import of missions."""

from pyomo_quad.exports.formats import Export, Format, export_plan
from pyomo_quad.exports.ground_missions import ImportedMission, read_mission
from pyomo_quad.exports.motion import Motion, PolynomialTrajectory

__all__ = [
    "Export",
    "Format",
    "ImportedMission",
    "Motion",
    "PolynomialTrajectory",
    "export_plan",
    "read_mission",
]
