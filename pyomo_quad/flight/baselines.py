"""The flights that an optimum is compared with: a reference under feedback, the plan without.

All fly the vehicle that the optimiser flew, through the same declared equations, in the wind that
really blows.  The controller is not told that wind.  The optimiser was told the forecast, which is
the true wind where a scenario gives none, and the plan carries what it expects of the air: a
controller that follows the plan adapts to the rest.
"""

from math import nan
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from pyomo_quad.collocation import Dynamics
from pyomo_quad.flight.allocation import mixer_matrix
from pyomo_quad.flight.closed_loop import ClosedLoopFlight, Integrator, fly
from pyomo_quad.flight.columns import flight_frame
from pyomo_quad.flight.controller import MEASURED_STATES, AdaptiveController
from pyomo_quad.flight.ends import start_state, wanted_at_goal
from pyomo_quad.flight.flight import POSITION_STATES, Flight, Flown
from pyomo_quad.flight.plan import Plan
from pyomo_quad.flight.plant import fly_controls
from pyomo_quad.flight.references import (
    ReferencePath,
    SampledPath,
    minimum_snap,
    quintic,
    step,
)
from pyomo_quad.flight.verification import (
    BALANCE_TOLERANCE,
    ENERGY_TOLERANCE,
    MISS_TOLERANCE,
    battery_imbalance,
)
from pyomo_quad.scenario import Scenario, ScenarioError
from pyomo_quad.scenario.baseline import Reference

__all__ = [
    "OPEN_LOOP",
    "baseline_name",
    "fly_baseline",
    "fly_open_loop",
    "fly_reference",
    "reference_path",
]

FloatArray = NDArray[np.float64]

OPEN_LOOP = "open_loop/plan"

_PATHS = {
    Reference.STEP: step,
    Reference.QUINTIC: quintic,
    Reference.MINIMUM_SNAP: minimum_snap,
}
# Samples of a flight's table per second of flight.
_RATE_HZ = 100.0
# Samples of the plan per second between which its reference is interpolated.
_PLAN_RATE_HZ = 5.0
# Place, its rate and the rate of that, as the declared model names them.
_PLACE = (*POSITION_STATES, "rigid_body.psi")
_RATE = ("rigid_body.vx", "rigid_body.vy", "rigid_body.vz", "rigid_body.r")
_ACCELERATION = tuple(name.replace("body.", "body.d") + "_dt" for name in _RATE)
_AIR_FORCE = tuple(f"aerodynamics.force_{axis}" for axis in "xyz")


def baseline_name(reference: Reference) -> str:
    """Return the name of a controlled flight.

    Parameters
    ----------
    reference : Reference
        What the controller followed.

    Returns
    -------
    str
        As in the comparison's first columns.
    """
    return f"adaptive/{reference.value}"


def fly_baseline(
    scenario: Scenario, reference: Reference, *, dynamics: Dynamics, plan: Plan | None = None
) -> Flight:
    """Fly a mission under the adaptive controller.

    Parameters
    ----------
    scenario : Scenario
        Mission, gains, and the vehicle that the controller believes in.
    reference : Reference
        What the controller follows.
    dynamics : Dynamics
        The vehicle in the wind that really blows, of `Planner.dynamics`.
    plan : Plan, optional
        Gives the start; needed to follow `Reference.PLAN`.

    Returns
    -------
    Flight
        Named by `baseline_name`.  It is verified when a flight by another integrator, which
        shares no code with the first, ends at the same place and has spent the same energy,
        within the tolerances that plans are held to, and the battery can give its power.

    Raises
    ------
    ScenarioError
        If the plan is to be followed and there is none, or the model is not a quadrotor's.
    SolveError
        If the flight is out of control.
    """
    began = perf_counter()
    first = fly_reference(scenario, reference, dynamics=dynamics, plan=plan)
    second = fly_reference(
        scenario,
        reference,
        dynamics=dynamics,
        plan=plan,
        integrator=Integrator.MULTISTEP,
        rate_hz=0.0,
    )
    return _flight(
        baseline_name(reference),
        scenario,
        dynamics,
        first.flown,
        plan,
        is_verified=_agree(dynamics, first.flown, second.flown),
        wall_s=perf_counter() - began,
    )


def fly_reference(
    scenario: Scenario,
    reference: Reference,
    *,
    dynamics: Dynamics,
    plan: Plan | None = None,
    integrator: Integrator = Integrator.RUNGE_KUTTA,
    rate_hz: float = _RATE_HZ,
) -> ClosedLoopFlight:
    """Fly once, and keep the controller's own states; see `fly_baseline`.

    Parameters
    ----------
    scenario : Scenario
    reference : Reference
    dynamics : Dynamics
    plan : Plan, optional
    integrator : Integrator, optional
    rate_hz : float, optional
        Samples per second; both ends are always kept.

    Returns
    -------
    ClosedLoopFlight
        Sampled at an even rate.
    """
    _refuse_other_vehicles(scenario, dynamics)
    duration = scenario.mission.duration
    return fly(
        dynamics=dynamics,
        controller=AdaptiveController(scenario, mixer_matrix(dynamics)),
        reference=reference_path(scenario, reference, plan),
        initial_state=start_state(scenario, dynamics, plan),
        times=_even_times(0.0, duration, rate_hz),
        integrator=integrator,
    )


def reference_path(
    scenario: Scenario, reference: Reference, plan: Plan | None = None
) -> ReferencePath:
    """Return where the controller should be at each time.

    Parameters
    ----------
    scenario : Scenario
        Gives the mission.
    reference : Reference
        What to follow.
    plan : Plan, optional
        Needed for `Reference.PLAN`.

    Returns
    -------
    callable
        Time in s -> Setpoint.

    Raises
    ------
    ScenarioError
        If the plan is to be followed and there is none.
    """
    if reference in _PATHS:
        return _PATHS[reference](scenario.mission)
    if plan is None:
        raise ScenarioError(
            f"{scenario.name}: reference {reference.value!r} needs a plan; solve the scenario "
            "first."
        )
    return _planned_path(plan)


def fly_open_loop(scenario: Scenario, plan: Plan, dynamics: Dynamics) -> Flight:
    """Fly the plan's own rotor accelerations without feedback.

    Parameters
    ----------
    scenario : Scenario
        Its mission says where the flight should end.
    plan : Plan
        Made for the wind that the optimiser was told.
    dynamics : Dynamics
        The vehicle in the wind that really blows.

    Returns
    -------
    Flight
        Named `OPEN_LOOP`; verified as `fly_baseline` says.
    """
    began = perf_counter()
    held = plan.trajectories
    start = start_state(scenario, dynamics, plan)
    first, second = (
        fly_controls(dynamics, held.mesh, held.controls, start, held.horizon, method=method.value)
        for method in Integrator
    )
    return _flight(
        OPEN_LOOP,
        scenario,
        dynamics,
        first,
        plan,
        is_verified=_agree(dynamics, first, second),
        wall_s=perf_counter() - began,
    )


def _flight(
    name: str,
    scenario: Scenario,
    dynamics: Dynamics,
    flown: Flown,
    plan: Plan | None,
    *,
    is_verified: bool,
    wall_s: float,
) -> Flight:
    final = dict(zip(dynamics.state_names, flown.states[-1].tolist(), strict=True))
    # The costates of a flight through another wind price another mission's end.
    is_told = scenario.wind.forecast is None
    return Flight.from_flown(
        name,
        dynamics,
        flown,
        wanted_at_goal(scenario, dynamics),
        flight_frame(dynamics, flown.t, flown.states, flown.controls, flown.energy),
        is_verified=is_verified and battery_imbalance(dynamics, flown) <= BALANCE_TOLERANCE,
        wall_s=wall_s,
        owed_energy_J=plan.owed_energy(final) if plan is not None and is_told else nan,
    )


def _planned_path(plan: Plan) -> SampledPath:
    """Return the plan as a reference, with accelerations and air of the equations it obeys."""
    held = plan.trajectories
    times = _even_times(*held.horizon, _PLAN_RATE_HZ)
    flown = times, held.states_at(times), held.controls_at(times)
    keys = tuple((name, None) for name in (*_PLACE, *_RATE, *_ACCELERATION))
    rows = plan.dynamics.table(keys, *flown)
    air = np.zeros((len(times), len(_PLACE)))
    if all(plan.dynamics.has(name) for name in _AIR_FORCE):
        forces = plan.dynamics.table(tuple((name, None) for name in _AIR_FORCE), *flown)
        air[:, : len(_AIR_FORCE)] = forces / plan.scenario.vehicle.total_mass
    values, rates, accelerations = np.split(rows, 3, axis=1)
    return SampledPath(times, values, rates, accelerations, air)


def _agree(dynamics: Dynamics, first: Flown, second: Flown) -> bool:
    columns = [dynamics.state_names.index(name) for name in POSITION_STATES]
    apart = np.linalg.norm(first.states[-1, columns] - second.states[-1, columns])
    energy, other = first.energy[-1], second.energy[-1]
    is_same_energy = abs(energy - other) <= ENERGY_TOLERANCE * max(1.0, abs(energy))
    return bool(apart <= MISS_TOLERANCE and is_same_energy)


def _refuse_other_vehicles(scenario: Scenario, dynamics: Dynamics) -> None:
    missing = next((name for name in MEASURED_STATES if name not in dynamics.state_names), None)
    if missing is not None:
        raise ScenarioError(
            f"{scenario.name}: the model has no state {missing}; the controller flies only models "
            "with the states of the declared quadrotor."
        )


def _even_times(start: float, end: float, rate_hz: float) -> FloatArray:
    return np.linspace(start, end, max(2, round((end - start) * rate_hz) + 1))
