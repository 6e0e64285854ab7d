"""Flights: plans, their verification by simulation with SciPy, controllers and reference paths."""

from pyomo_quad.flight.columns import COLUMNS, flight_frame
from pyomo_quad.flight.flight import Flight
from pyomo_quad.flight.plan import Plan, PlanStatus
from pyomo_quad.flight.planning import Planner, solve_scenario
from pyomo_quad.flight.verification import Verification

__all__ = [
    "COLUMNS",
    "Flight",
    "Plan",
    "PlanStatus",
    "Planner",
    "Verification",
    "flight_frame",
    "solve_scenario",
]
