"""Attitude, thrust and power in logged flights, computed from the vehicle's model.

Method: see docs/theory/identification.md, eq. (1).

Airspeed and acceleration come from the log. For each row of the log, the equations of the vehicle's
model are solved for the attitude and the rotor speed that produce the acceleration. The same
equations then give the power.
"""

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import Dynamics, Instants
from pyomo_quad.flight import Planner
from pyomo_quad.flight.flight import VELOCITY_STATES
from pyomo_quad.identification.columns import (
    AIR_VELOCITY,
    DENSITY,
    FLIGHT,
    PAYLOAD,
    TIME,
    VELOCITY,
)
from pyomo_quad.scenario import PowerModel, Scenario, ScenarioError, scenario_from_mapping

_MASS, _DENSITY = "vehicle.mass", "power.air_density"
_TURNED = ("rigid_body.phi", "rigid_body.theta")
_ROTOR = "rotors.omega["
_ACCELERATIONS = tuple((f"rigid_body.dv{axis}_dt", None) for axis in "xyz")
_POWER = (("power.total", None),)
# Steps of the difference quotients: radians, and fractions of the rotor speed.
_STEP = 1e-6
# Newton's method takes a few iterations if there is a solution.
_MOST_ITERATIONS = 30
# Tolerance of the acceleration, m/s^2.
_ACCURACY = 1e-8
_STEEPEST = 1.2  # rad, bound on roll and pitch during the iterations
# Test value of a parameter, and rows of the log, by which the program finds out whether the motion
# depends on the parameter.
_OTHER_VALUE, _FEW = 1.7, slice(0, 50)


def vehicle_scenario(base: str, model: PowerModel = PowerModel.MOMENTUM) -> Scenario:
    """Make a scenario for the identification of a vehicle: a short mission in calm air.

    `base` is a vehicle of the library or the path of a vehicle file (.toml). If there is no such
    vehicle, or if it is incomplete, a ScenarioError is raised.
    """
    file = Path(base)
    tables = {
        "name": "logs",
        "vehicle": {"use": file.name if file.suffix == ".toml" else base},
        # In calm air, the velocity over ground can be set to the logged velocity through the air.
        "wind": {"use": "calm", "coupling": "drag"},
        "power": {"model": model},
        # Every scenario needs a mission; this one is not flown.
        "mission": {"goal": {"position": [1.0, 0.0, 0.0]}, "duration": 10.0},
    }
    folder = file.parent if file.suffix == ".toml" else None
    return scenario_from_mapping(tables, source="vehicle", folder=folder)


class LoggedMotion:
    """Motion of a vehicle in each row of a log, from which the power is computed.

    Parameters
    ----------
    scenario : Scenario
        Scenario with the vehicle, from `vehicle_scenario`.
    frame : DataFrame
        Rows of the flights, from `read_logs`.
    """

    def __init__(self, scenario: Scenario, frame: pd.DataFrame) -> None:
        self.frame = frame
        self._dynamics: Dynamics = Planner().dynamics(scenario)
        names = list(self._dynamics.state_names)
        start = self._dynamics.initial_states()
        self._states = np.tile([start[name] for name in names], (len(frame), 1))
        self._angles = [names.index(name) for name in _TURNED]
        self._rotors = [k for k, name in enumerate(names) if name.startswith(_ROTOR)]
        vehicle = scenario.vehicle
        air = frame[list(AIR_VELOCITY)].to_numpy() * vehicle.anemometer_factor
        # The model's air is calm, so that its velocity must be the velocity through the air.
        velocity = np.column_stack([air, frame[VELOCITY[2]]])
        self._states[:, [names.index(name) for name in VELOCITY_STATES]] = velocity
        self._wanted = _accelerations(frame)
        self._payload, self._mass = frame[PAYLOAD].to_numpy(), vehicle.mass
        self._densities = {_DENSITY: frame[DENSITY].to_numpy()}
        self._solved: dict[tuple[tuple[str, float], ...], Instants] = {}

    def power(self, numbers: Mapping[str, float] | None = None) -> FloatArray:
        """Compute the power in each row of the log, shape (n_rows,) [W].

        `numbers` has changed parameters by full name, such as ``vehicle.drag_linear``. If no
        attitude and thrust produce a logged acceleration, a ScenarioError is raised.
        """
        changed = dict(numbers or {})
        deciding = {name: value for name, value in changed.items() if name not in self._power_only}
        own = {name: value for name, value in changed.items() if name in self._power_only}
        return self._instants(deciding).table(_POWER, own)[:, 0]

    @cached_property
    def _power_only(self) -> frozenset[str]:
        """Names of the parameters that affect the power only, not the motion.

        If only these parameters change, the attitude and rotor speed of each row stay the same.
        """
        self._instants({})
        states = self._states_found[_FEW]

        def motion(numbers: Mapping[str, float]) -> FloatArray:
            rates, _, algebraics, _, _ = self._evaluate(states, _FEW, numbers).inputs
            return np.column_stack([rates[:, : len(VELOCITY_STATES)], algebraics])

        known = motion({})
        return frozenset(
            name
            for name in self._dynamics.parameter_names
            if name.startswith("power.") and np.array_equal(motion({name: _OTHER_VALUE}), known)
        )

    def _instants(self, numbers: Mapping[str, float]) -> Instants:
        key = tuple(sorted(numbers.items()))
        if key not in self._solved:
            if len(self._solved) > 1:
                self._solved.pop(next(reversed(self._solved)))
            self._states_found = self._trimmed(numbers)
            self._solved[key] = self._evaluate(self._states_found, slice(None), numbers)
        return self._solved[key]

    def _evaluate(
        self, states: FloatArray, rows: slice | NDArray[np.bool_], numbers: Mapping[str, float]
    ) -> Instants:
        own = dict(numbers)
        mass = own.pop(_MASS, self._mass) + self._payload[rows]
        told = {name: column[rows] for name, column in self._densities.items()}
        controls = np.zeros((len(states), len(self._dynamics.control_names)))
        times = np.full(len(states), self._dynamics.start)
        return self._dynamics.solved(times, states, controls, {_MASS: mass, **told, **own})

    def _trimmed(self, numbers: Mapping[str, float]) -> FloatArray:
        """Return the states that produce the logged accelerations, shape (n_rows, n_states).

        `numbers` has changed model parameters by full name. A row without solution, for example
        after a jump in the logged velocity, raises a ScenarioError.
        """
        states = self._states.copy()
        open_rows = np.ones(len(states), dtype=bool)
        for _ in range(_MOST_ITERATIONS):
            at, wanted = states[open_rows], self._wanted[open_rows]
            missing = wanted - self._acceleration(at, open_rows, numbers)
            is_done = np.max(np.abs(missing), axis=1) <= _ACCURACY
            if np.all(is_done):
                # Initial guess of the next call.
                self._states = states
                return states
            still = np.flatnonzero(open_rows)[~is_done]
            open_rows = np.zeros(len(states), dtype=bool)
            open_rows[still] = True
            at, missing = at[~is_done], missing[~is_done]
            slopes = [
                (self._acceleration(moved, open_rows, numbers) - (wanted[~is_done] - missing))
                / _STEP
                for moved in self._moved(at)
            ]
            try:
                steps = np.linalg.solve(np.stack(slopes, axis=2), missing[:, :, None])[:, :, 0]
            except np.linalg.LinAlgError:
                break  # singular: the acceleration of a row is independent of its state
            # Newton's method changes roll, pitch and rotor speed; the velocity is the logged one.
            for column, step in zip(self._angles, steps.T, strict=False):
                at[:, column] = np.clip(at[:, column] + step, -_STEEPEST, _STEEPEST)
            at[:, self._rotors] *= np.clip(1.0 + steps[:, 2:], 0.5, 2.0)
            states[still] = at
        flight, time = (self.frame[name].iloc[still[0]] for name in (FLIGHT, TIME))
        raise ScenarioError(
            f"logs: no attitude and thrust of this vehicle give the acceleration at {time:g} s of "
            f"flight {flight}; look at the velocities there."
        )

    def _moved(self, states: FloatArray) -> list[FloatArray]:
        moved = [states.copy() for _ in range(3)]
        for column, copy in zip(self._angles, moved, strict=False):
            copy[:, column] += _STEP
        moved[2][:, self._rotors] *= 1.0 + _STEP
        return moved

    def _acceleration(
        self, states: FloatArray, rows: NDArray[np.bool_], numbers: Mapping[str, float]
    ) -> FloatArray:
        return self._evaluate(states, rows, numbers).table(_ACCELERATIONS)


def _accelerations(frame: pd.DataFrame) -> FloatArray:
    """Return the acceleration north, east and up [m/s²] in each row of a log, shape (n_rows, 3).

    It is the finite difference of the velocity over ground.
    """
    found = np.zeros((len(frame), len(VELOCITY)))
    # No finite difference spans two flights.
    for rows in frame.groupby(FLIGHT, sort=False).indices.values():
        times = frame[TIME].to_numpy()[rows]
        velocity = frame[list(VELOCITY)].to_numpy()[rows]
        found[rows] = np.gradient(velocity, times, axis=0)
    return found
