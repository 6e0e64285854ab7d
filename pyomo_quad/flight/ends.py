"""Both ends of a mission as states of the vehicle: where a flight starts and should end."""

import numpy as np
from numpy.typing import NDArray

from pyomo_quad.collocation import Dynamics
from pyomo_quad.flight.flight import POSITION_STATES
from pyomo_quad.flight.plan import Plan
from pyomo_quad.scenario import Scenario, ScenarioError
from pyomo_quad.scenario.mission import Hover

__all__ = ["declared_start", "start_state", "wanted_at_goal"]

FloatArray = NDArray[np.float64]

_RIGID_BODY = "rigid_body."
_ROTOR_SPEED = "rotors.omega["
_YAW = "rigid_body.psi"
_CHARGE_DRAWN = "battery.charge_drawn"
_STATE_OF_CHARGE = "battery.state_of_charge"


def start_state(scenario: Scenario, dynamics: Dynamics, plan: Plan | None = None) -> FloatArray:
    """Return the state in which a flight starts: that of the plan, or hover as declared.

    Parameters
    ----------
    scenario : Scenario
        Gives the place and the state of charge.
    dynamics : Dynamics
        The vehicle to be flown.
    plan : Plan, optional
        Its first state is taken where there is one.

    Returns
    -------
    ndarray, shape (n_states,)
        In the order of the dynamics.

    Raises
    ------
    ScenarioError
        If a model of the user's own has a state that only a plan could give a value.
    """
    if plan is not None:
        held = plan.trajectories
        known = dict(zip(held.state_names, held.states[0].tolist(), strict=True))
    else:
        known = declared_start(scenario, dynamics)
    unknown = next((name for name in dynamics.state_names if name not in known), None)
    if unknown is not None:
        raise ScenarioError(
            f"{scenario.name}: nothing says where state {unknown} of the model starts; fly it "
            "with a plan."
        )
    return np.array([known[name] for name in dynamics.state_names])


def declared_start(scenario: Scenario, dynamics: Dynamics) -> dict[str, float]:
    """Return the states that the mission gives at the start: hover, and the charge of the pack."""
    known = _hovering(scenario, scenario.mission.start, dynamics)
    if _CHARGE_DRAWN in dynamics.state_names and dynamics.has(_STATE_OF_CHARGE):
        known[_CHARGE_DRAWN] = _charge_drawn(scenario, dynamics)
    return known


def wanted_at_goal(scenario: Scenario, dynamics: Dynamics) -> dict[str, float]:
    """Return the final values that the mission wants: hover at the goal.

    Parameters
    ----------
    scenario : Scenario
        Gives the goal.
    dynamics : Dynamics
        The vehicle flown.

    Returns
    -------
    dict
        State name -> value, of rigid body and rotors.
    """
    return _hovering(scenario, scenario.mission.goal, dynamics)


def _hovering(scenario: Scenario, place: Hover, dynamics: Dynamics) -> dict[str, float]:
    names = dynamics.state_names
    hover_speed = scenario.vehicle.hover_speed(scenario.gravity)
    states = {name: 0.0 for name in names if name.startswith(_RIGID_BODY)}
    states |= {name: hover_speed for name in names if name.startswith(_ROTOR_SPEED)}
    return states | dict(zip((*POSITION_STATES, _YAW), (*place.position, place.yaw), strict=True))


def _charge_drawn(scenario: Scenario, dynamics: Dynamics) -> float:
    """Return the charge at which the declared state of charge, linear in it, is the initial one."""
    states = np.zeros((2, len(dynamics.state_names)))
    states[1, dynamics.state_names.index(_CHARGE_DRAWN)] = 1.0
    controls = np.zeros((2, len(dynamics.control_names)))
    full, less = dynamics.evaluate(_STATE_OF_CHARGE, np.zeros(2), states, controls).tolist()
    return (scenario.battery.initial_state_of_charge - full) / (less - full)
