"""Cautions beside the numbers of a plan: what was wrong with the mission, what the plan left."""

from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.flight.columns import ROTORS
from pyomo_quad.scenario import PowerModel, Scenario
from pyomo_quad.study.diagnosis import diagnose

if TYPE_CHECKING:
    from pyomo_quad.flight import Plan, Planner

__all__ = ["plan_cautions"]

_TORQUE = "rotors.motor_torque"
_EFFICIENCY = "power.efficiency_polynomial"


def plan_cautions(plan: "Plan", *, planner: "Planner | None" = None) -> tuple[str, ...]:
    """Say what stands between a plan and its being taken at its word.

    Parameters
    ----------
    plan : Plan
        As the planner made it, with its equations.
    planner : Planner, optional
        What made the plan.

    Returns
    -------
    tuple of str
        One line for each caution.
    """
    findings = diagnose(plan.scenario, planner=planner)
    told = tuple(finding.message for finding in findings)
    solved = () if plan.solution is None else plan.solution.warnings
    return (*told, *solved, *_efficiency_map_cautions(plan.scenario, plan))


def _efficiency_map_cautions(scenario: Scenario, plan: "Plan") -> tuple[str, ...]:
    is_read = scenario.power.model is PowerModel.EFFICIENCY and plan.dynamics.has(_EFFICIENCY)
    if not is_read:
        return ()
    held = plan.trajectories
    times = held.node_times[1:]
    keys = tuple((name, rotor) for name in (_TORQUE, _EFFICIENCY) for rotor in ROTORS)
    values = plan.dynamics.table(keys, times, held.states[1:], held.controls)
    torque, efficiency = np.hsplit(values, 2)
    floors = scenario.power
    outside = (torque < floors.torque_floor) | (efficiency < floors.efficiency_floor)
    if not outside.any():
        return ()
    caution = (
        f"power.model efficiency: {100 * outside.mean():.0f} % of the plan's rotor states lie "
        f"outside f_r's sound range (torque below {floors.torque_floor:g} N m or f_r below "
        f"{floors.efficiency_floor:g}); the energy there is that of the floors, not of the paper."
    )
    return (caution,)
