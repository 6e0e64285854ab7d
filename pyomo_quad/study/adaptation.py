"""What adaptation is worth: the same flight with it and without."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pyomo_quad.collocation import Dynamics
from pyomo_quad.flight import Planner
from pyomo_quad.flight.baselines import fly_reference, reference_path
from pyomo_quad.flight.closed_loop import ClosedLoopFlight
from pyomo_quad.flight.columns import TIME
from pyomo_quad.flight.controller import CONTROLLER_STATES
from pyomo_quad.flight.flight import POSITION_STATES
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.baseline import Reference

__all__ = ["ERROR_WITH", "ERROR_WITHOUT", "ESTIMATED", "TRUE", "adaptation_study"]

FloatArray = NDArray[np.float64]

ERROR_WITH = "position_error_with_adaptation_m"
ERROR_WITHOUT = "position_error_without_adaptation_m"
ESTIMATED = tuple(f"estimated_disturbance_{axis}_m_per_s2" for axis in "xyz")
TRUE = tuple(f"true_disturbance_{axis}_m_per_s2" for axis in "xyz")

_ESTIMATES = tuple(f"disturbance_{axis}_m_per_s2" for axis in "xyz")
_FORCES = tuple(f"aerodynamics.force_{axis}" for axis in "xyz")


def adaptation_study(
    scenario: Scenario,
    reference: Reference = Reference.QUINTIC,
    *,
    dynamics: Dynamics | None = None,
) -> pd.DataFrame:
    """Fly a mission under the adaptive controller, with adaptation and without.

    Parameters
    ----------
    scenario : Scenario
        The mission, in its wind, which the controller is not told.
    reference : Reference, optional
        What the controller follows; any but the plan.
    dynamics : Dynamics, optional
        The vehicle in that wind, built when not given.

    Returns
    -------
    DataFrame
        `TIME`, the distance from the reference `ERROR_WITH` and `ERROR_WITHOUT` adaptation, and
        the disturbance per mass, `ESTIMATED` and `TRUE`, of the flight with adaptation.
    """
    vehicle = Planner().dynamics(scenario) if dynamics is None else dynamics
    with_it, without_it = (
        fly_reference(
            scenario.with_values({"baseline.adaptation": adapts}), reference, dynamics=vehicle
        )
        for adapts in (True, False)
    )
    flown = with_it.flown
    keys = tuple((force, None) for force in _FORCES)
    forces = vehicle.table(keys, flown.t, flown.states, flown.controls)
    columns = [CONTROLLER_STATES.index(name) for name in _ESTIMATES]
    table = {
        TIME: flown.t,
        ERROR_WITH: _error(scenario, reference, vehicle, with_it),
        ERROR_WITHOUT: _error(scenario, reference, vehicle, without_it),
    }
    table |= dict(zip(ESTIMATED, with_it.controller_states[:, columns].T, strict=True))
    table |= dict(zip(TRUE, forces.T / scenario.vehicle.total_mass, strict=True))
    return pd.DataFrame(table)


def _error(
    scenario: Scenario, reference: Reference, vehicle: Dynamics, flight: ClosedLoopFlight
) -> FloatArray:
    path = reference_path(scenario, reference)
    wanted = np.array([path(t).place[:3] for t in flight.flown.t])
    columns = [vehicle.state_names.index(name) for name in POSITION_STATES]
    return np.linalg.norm(flight.flown.states[:, columns] - wanted, axis=1)
