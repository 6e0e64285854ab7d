"""Study of missions flown in the simulator RotorPy, and of the causes of differences.

The argument `case` is the name of a mission. It is a key of `CASES`, or the name of a vehicle of
RotorPy (a parameter set), which flies a short mission of its own.

Each mission is flown in the package's own model (the "declared" vehicle) and in RotorPy's model. In
both, flights have the package's controller or no feedback. RotorPy also flies its controller SE3.

RotorPy's model differs in several features, such as rotors without gyroscopic moment. Each feature
is changed alone, to find its effect on the flight.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property, partial
from math import dist
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.constants import g as standard_gravity

from pyomo_quad.collocation import Dynamics, SolveError
from pyomo_quad.flight import Flight, Plan, Planner
from pyomo_quad.flight.baselines import fly_baseline, fly_open_loop, reference_path, start_state
from pyomo_quad.flight.columns import COLUMNS, TIME
from pyomo_quad.flight.flight import AIR_FORCE, POSITION_STATES, VELOCITY_STATES
from pyomo_quad.flight.outside_plant import (
    ACROSS,
    AS_IT_COMES,
    MASSLESS_ROTORS,
    Habits,
    OutsidePlant,
    Pilot,
    fly_outside,
    fly_under,
    se3_law,
)
from pyomo_quad.flight.references import ReferencePath, Setpoint
from pyomo_quad.scenario import Reference, Scenario, ScenarioError, load_scenario
from pyomo_quad.scenario.description import shipped_scenarios
from pyomo_quad.simulators.vehicles import NAMES, rotorpy_parameters, vehicle_fields
from pyomo_quad.study.comparison import has_arrived
from pyomo_quad.study.tables import TableColumn

_EXACT = {"vehicle.attitude": "euler"}
_BREEZE = {"wind.use": "constant", "wind.speed": 3.0, "wind.direction": 1.0}
_DRAG = {"wind.coupling": "drag", "vehicle.drag_linear": 0.25, "vehicle.drag_quadratic": 0.02}
_IN_AIR = _EXACT | _DRAG | _BREEZE

PRINTED, EXACT, BREEZE = "printed", "exact", "breeze"
LONGER, WINDIER = "breeze_longer", "breeze_windier"
#: Missions of the study: for each name the description, and the changes to the paper's mission.
CASES: Mapping[str, tuple[str, Mapping[str, Any]]] = MappingProxyType(
    {
        PRINTED: ("Euler rates equal to body rates, as the paper prints", {}),
        EXACT: ("exact kinematics and the rotors' yaw reaction", _EXACT),
        BREEZE: ("as exact, with drag, in 3 m/s of wind", _IN_AIR),
        LONGER: (
            "as breeze, in twice the time",
            _IN_AIR | {"mission.duration": 20.0},
        ),
        WINDIER: ("as breeze, in 6 m/s of wind", _IN_AIR | {"wind.speed": 6.0}),
    }
)
#: Cases that show how the difference between drag at the rotors (RotorPy) and drag at the centre of
#: mass (the package) depends on duration and wind.
DRAG_CASES = (BREEZE, LONGER, WINDIER)
# Settings for RotorPy's small vehicles. Shaft power hardly penalises the acceleration of light
# rotors: a tighter tolerance takes minutes, and with this one the flight ends within 0.1 mm of its
# plan.
_PRICED = {"power.model": "shaft", "solver.tolerance": 1e-3}
# Goal [m] and duration [s] of the mission of RotorPy's small vehicles.
_GOAL, _DURATION = [3.0, 2.0, 1.5], 6.0
# Limit of rotor acceleration that is larger than any commanded acceleration [rad/s²].
_NO_SLEW_LIMIT = {"limits.rotor_acceleration_max": 1e7}
# Samples of a flight in the figure.
_MOST_SAMPLES = 250

Track = tuple[np.ndarray, np.ndarray]
"""Distance of a flight from its plan over time: n times [s] and n distances [m]."""


class Plant(StrEnum):
    """Simulated vehicle of a flight: the package's own model, or a variant of RotorPy's model.

    `DECLARED` is the package's model, `AS_IT_COMES` RotorPy with its defaults. `ROTORPY` is RotorPy
    with the equations of `DECLARED`, except that its attitude equations are always exact and its
    linear drag acts at the rotors. Each other member differs from `ROTORPY` in the feature that its
    value names.
    """

    DECLARED = "declared"
    ROTORPY = "rotorpy"
    WITHOUT_GYROSCOPIC_MOMENT = "rotorpy, no gyroscopic moment"
    WITHOUT_YAW_REACTION = "rotorpy, no yaw reaction"
    WITHOUT_ROTOR_INERTIA = "rotorpy, rotors without inertia"
    STANDARD_GRAVITY = "rotorpy, standard gravity"
    AT_500_HZ = "rotorpy, commands at 500 Hz"
    AT_100_HZ = "rotorpy, commands at 100 Hz"
    LOOSE = "rotorpy, tolerance of 1e-3"
    AS_IT_COMES = "rotorpy, as it comes"
    WITHOUT_SLEW_LIMIT = "rotorpy, rotors as fast as asked"


#: Settings of each variant of RotorPy's vehicle: each of its peculiarities alone, and all at once.
HABITS: Mapping[Plant, Habits] = MappingProxyType(
    {
        Plant.ROTORPY: Habits(),
        Plant.WITHOUT_GYROSCOPIC_MOMENT: Habits(has_gyroscopic_moment=False),
        Plant.WITHOUT_YAW_REACTION: Habits(has_yaw_reaction=False),
        Plant.WITHOUT_ROTOR_INERTIA: MASSLESS_ROTORS,
        Plant.STANDARD_GRAVITY: Habits(gravity=standard_gravity),
        Plant.AT_500_HZ: Habits(command_rate_hz=500.0),
        Plant.AT_100_HZ: Habits(command_rate_hz=100.0),
        Plant.LOOSE: Habits(tolerance=AS_IT_COMES.tolerance),
        Plant.AS_IT_COMES: AS_IT_COMES,
    }
)

#: Causes of differences between flights, each with the mission and the vehicle that show it.
CAUSES: Mapping[str, tuple[str, Plant]] = MappingProxyType(
    {
        "nothing: attitude and rotors agree": (EXACT, Plant.ROTORPY),
        "Euler rates equal to body rates": (PRINTED, Plant.WITHOUT_YAW_REACTION),
        "the same, and no yaw reaction": (PRINTED, Plant.ROTORPY),
        "no gyroscopic moment": (EXACT, Plant.WITHOUT_GYROSCOPIC_MOMENT),
        "no yaw reaction": (EXACT, Plant.WITHOUT_YAW_REACTION),
        "rotors without inertia: neither": (EXACT, Plant.WITHOUT_ROTOR_INERTIA),
        "gravity of 9.80665, not 9.81 m/s²": (EXACT, Plant.STANDARD_GRAVITY),
        "commands held, 500 a second": (EXACT, Plant.AT_500_HZ),
        "commands held, 100 a second": (EXACT, Plant.AT_100_HZ),
        "integrated to 1e-3": (EXACT, Plant.LOOSE),
        "RotorPy as it comes": (EXACT, Plant.AS_IT_COMES),
        "linear drag at the rotors": (BREEZE, Plant.ROTORPY),
    }
)

#: Names of variants of RotorPy's controller SE3, which show why it misses the goal or uses energy.
TOLD, STIFF, OUR_HEADING = "se3, told the air's force", "se3, stiffer", "se3, told our heading"
#: Factor on the gains of the stiffer variant.
STIFFNESS = 4.0


class OutsideColumn(TableColumn):
    """Columns of the study's table of flights in RotorPy and in the package's own model."""

    CASE = "case"
    PLANT = "plant"
    CONTROLLER = "controller"
    FOLLOWED = "followed"
    ENERGY = "energy_J"
    ENERGY_DIFFERENCE = "energy_difference_percent"
    MISS = "terminal_miss_m"
    ARRIVED = "arrived"
    APART = "end_apart_from_declared_m"
    VERIFIED = "verified"


# Case, plant, controller and reference, which identify a flight.
_IDENTITY = list(OutsideColumn)[:4]


@dataclass(frozen=True, kw_only=True)
class OutsideStudy:
    """Results of the comparison with the simulator RotorPy.

    Attributes
    ----------
    flights : DataFrame
        One row for each flight, columns of `OutsideColumn`.
    tracks : mapping
        Times [s] and distances from the plan [m] of each flight that follows a plan, by mission,
        vehicle and controller. Flights out of control are left out.
    lag_s : float
        Time constant of RotorPy's motors for the vehicle of Yacef et al. [s].
    """

    flights: pd.DataFrame
    tracks: Mapping[tuple[str, Plant, str], Track]
    lag_s: float

    def row(
        self, case: str, plant: Plant, controller: str, followed: Reference = Reference.PLAN
    ) -> dict[str, Any]:
        """Return the table row of one flight of the study, by column name.

        `case` is the name of the mission: a key of `CASES`, or of RotorPy's vehicle that flies it.
        `controller` is a name such as "adaptive", and `followed` the reference trajectory. If the
        flight went out of control, its energy is NaN. IndexError is raised if the study has no
        flight with these arguments.
        """
        is_it = (self.flights[_IDENTITY] == [case, plant, controller, followed]).all(axis=1)
        return {str(name): value for name, value in self.flights[is_it].iloc[0].items()}


class Arrivals(NamedTuple):
    """Counts of a controller's flights in RotorPy, by their outcome.

    A flight is confirmed if a simulation by a second integrator gives the same result.

    Attributes
    ----------
    arrived : int
        Confirmed flights that end near the goal and nearly at rest.
    confirmed : int
        All confirmed flights.
    unconfirmed : int
        Flights that are not confirmed, or went out of control.
    """

    arrived: int
    confirmed: int
    unconfirmed: int


def arrivals(flights: pd.DataFrame, controller: str) -> Arrivals:
    """Count the flights of one controller in RotorPy, by their outcome.

    `flights` is the table `OutsideStudy.flights`.
    """
    is_own = flights[OutsideColumn.CONTROLLER] == controller
    outside = flights[is_own & (flights[OutsideColumn.PLANT] != Plant.DECLARED)]
    is_confirmed = outside[OutsideColumn.VERIFIED].astype(bool)
    return Arrivals(
        arrived=int(outside[OutsideColumn.ARRIVED][is_confirmed].sum()),
        confirmed=int(is_confirmed.sum()),
        unconfirmed=int((~is_confirmed).sum()),
    )


class Flown(NamedTuple):
    """Description of a flight of the study, with the function that simulates the flight.

    Attributes
    ----------
    plant : Plant
        Simulated vehicle.
    controller : str
        Name of the controller in the result table, such as "adaptive" or "se3".
    followed : Reference
        Reference trajectory that the controller follows.
    fly : callable
        Function without arguments that simulates and returns the flight.
    """

    plant: Plant
    controller: str
    followed: Reference
    fly: Callable[[], Flight]


@dataclass(frozen=True)
class _Mission:
    """Planned mission of the comparison with RotorPy, with methods that describe its flights.

    `case` is the name of the mission: a key of `CASES`, or the name of RotorPy's vehicle that flies
    it.
    """

    case: str
    scenario: Scenario
    planner: Planner
    plan: Plan

    @cached_property
    def dynamics(self) -> Dynamics:
        return self.planner.dynamics(self.scenario)

    def declared(self, pilot: Pilot, followed: Reference = Reference.PLAN) -> Flown:
        """Describe a flight of the package's own ("declared") vehicle model, to be simulated later.

        `pilot` is the adaptive controller, or `OPEN_LOOP` for the plan's controls without feedback.
        """
        fly: Callable[[], Flight] = partial(
            fly_baseline, self.scenario, followed, dynamics=self.dynamics, plan=self.plan
        )
        if pilot is Pilot.OPEN_LOOP:
            fly = partial(fly_open_loop, self.scenario, self.plan, self.dynamics)
        return Flown(Plant.DECLARED, pilot, followed, fly)

    def outside(
        self,
        at: Plant,
        plant: OutsidePlant,
        pilot: Pilot,
        followed: Reference = Reference.PLAN,
    ) -> Flown:
        """Describe a flight in RotorPy under a given controller, to be simulated later.

        `plant` is the simulated vehicle, and `at` its name in the result table. `followed` is the
        reference trajectory.
        """
        return Flown(at, pilot, followed, partial(fly_outside, plant, pilot, followed, self.plan))

    def under(
        self,
        at: Plant,
        plant: OutsidePlant,
        name: str,
        path: ReferencePath,
        followed: Reference,
        stiffness: float = 1.0,
    ) -> Flown:
        """Describe a flight in RotorPy under a variant of its controller SE3, for later simulation.

        `plant` is the simulated vehicle, and `at` its name in the result table. The variant of SE3
        follows `path`, with gains multiplied by `stiffness`. In the result table, `name` is the
        name of the variant, and `followed` the name of the reference trajectory.
        """
        law = se3_law(plant, path, stiffness=stiffness)
        return Flown(at, name, followed, partial(fly_under, plant, name, law, self.plan))

    def path(self, followed: Reference) -> ReferencePath:
        """Return a reference trajectory of the mission as a function of time.

        `followed` selects the trajectory, for example the plan or a smooth path to the goal.
        """
        return reference_path(self.scenario, followed, self.plan)


def run_outside_study(planner: Planner | None = None) -> OutsideStudy:
    """Simulate all flights of the comparison with RotorPy.

    In the table of flights, a flight that goes out of control has a row without numbers.
    ScenarioError is raised if RotorPy is not installed.
    """
    planner = planner or Planner()
    paper = load_scenario(shipped_scenarios()["paper"])
    cases = {case: paper.with_values(settings) for case, (_, settings) in CASES.items()}
    cases |= {name: _small(paper, name) for name in NAMES}
    rows: list[dict[str, Any]] = []
    tracks: dict[tuple[str, Plant, str], Track] = {}
    for case, scenario in cases.items():
        plan = planner.solve(scenario)
        flights = _FLIGHTS_OF.get(case, _flights)
        for row, flown, flight in _rows(case, flights(_Mission(case, scenario, planner, plan))):
            rows.append(row)
            if flight is not None and flown.followed is Reference.PLAN:
                tracks[case, flown.plant, str(flown.controller)] = _track(flight, plan)
    return OutsideStudy(
        flights=OutsideColumn.of_rows(rows),
        tracks=tracks,
        lag_s=1.0 / paper.baseline.gains.rotor,
    )


def _track(flight: Flight, plan: Plan) -> Track:
    """Return fewer than 500 times of a flight [s], and its distances from the plan at these [m]."""
    step = max(1, len(flight.frame) // _MOST_SAMPLES)
    shown = flight.frame.iloc[::step]
    t = shown[TIME].to_numpy()
    held = plan.trajectories
    columns = [held.state_names.index(name) for name in POSITION_STATES]
    flown = shown[[c.name for c in COLUMNS if c.component in POSITION_STATES]].to_numpy()
    return t, np.linalg.norm(flown - held.states_at(t)[:, columns], axis=1)


def _small(paper: Scenario, name: str) -> Scenario:
    """Return a short mission of a small vehicle of RotorPy, to be planned for least shaft energy.

    `name` is RotorPy's parameter set of the vehicle. The result is `paper`, the mission of Yacef et
    al., with another vehicle, goal, duration, power model and solver tolerance.
    """
    said = {
        path.replace("fields.", "vehicle.", 1): value
        for path, (value, _) in vehicle_fields(name).items()
    }
    mission = {"mission.goal.position": _GOAL, "mission.duration": _DURATION}
    return paper.with_values(said | _EXACT | mission | _PRICED)


def _flights(mission: _Mission) -> Iterator[Flown]:
    plant = OutsidePlant(mission.scenario, mission.dynamics)
    yield mission.declared(Pilot.OPEN_LOOP)
    for reference in (Reference.QUINTIC, Reference.PLAN):
        yield mission.declared(Pilot.ADAPTIVE, reference)
        for pilot in (Pilot.ADAPTIVE, Pilot.SE3):
            yield mission.outside(Plant.ROTORPY, plant, pilot, reference)
    shown = {at for case, at in CAUSES.values() if case == mission.case}
    for at in (which for which in HABITS if which in shown):
        flown = OutsidePlant(mission.scenario, mission.dynamics, habits=HABITS[at])
        yield mission.outside(at, flown, Pilot.OPEN_LOOP)
        if at is not Plant.ROTORPY:
            yield mission.outside(at, flown, Pilot.ADAPTIVE)
    if mission.case == EXACT:
        yield from _leaps(mission, plant)
    if mission.case == BREEZE:
        yield from _why_se3_misses(mission, plant)


def _leaps(mission: _Mission, limited: OutsidePlant) -> Iterator[Flown]:
    """Describe flights whose commanded position jumps from start to goal, to be simulated later.

    The vehicle `limited` has the scenario's limit on the rotor acceleration. Each flight in RotorPy
    is described with and without this limit, to show its effect.
    """
    unlimited = OutsidePlant(mission.scenario.with_values(_NO_SLEW_LIMIT), mission.dynamics)
    yield mission.declared(Pilot.ADAPTIVE, Reference.STEP)
    for pilot in (Pilot.ADAPTIVE, Pilot.SE3):
        yield mission.outside(Plant.ROTORPY, limited, pilot, Reference.STEP)
        yield mission.outside(Plant.WITHOUT_SLEW_LIMIT, unlimited, pilot, Reference.STEP)


def _why_se3_misses(mission: _Mission, plant: OutsidePlant) -> Iterator[Flown]:
    """Describe flights that show why controller SE3 misses the goal in wind.

    The flights are simulated later. In them, SE3 has larger gains, or a feedforward of the
    aerodynamic force.
    """
    for followed in (Reference.QUINTIC, Reference.PLAN):
        path = mission.path(followed)
        yield mission.under(Plant.ROTORPY, plant, STIFF, path, followed, STIFFNESS)
        if followed is Reference.QUINTIC:
            path = _against_the_air(path, plant)
            yield mission.under(Plant.ROTORPY, plant, TOLD, path, followed)


def _against_the_air(path: ReferencePath, plant: OutsidePlant) -> ReferencePath:
    """Return a reference path with a feedforward of the aerodynamic force on the vehicle.

    The acceleration is a - F / m: a is that of `path`, m the mass, F the force on the level vehicle
    at the velocity of `path`.
    """
    dynamics, mass = plant.dynamics, plant.scenario.vehicle.total_mass
    moving = [dynamics.state_names.index(name) for name in (*POSITION_STATES, *VELOCITY_STATES)]
    forces = tuple((name, None) for name in AIR_FORCE)

    def told(t: float) -> Setpoint:
        # The rates of roll and pitch (`tilting`) of `path` are left out.
        place, rate, acceleration, _ = path(t)
        level = start_state(plant.scenario, dynamics)
        level[moving] = *place[:3], *rate[:3]
        controls = np.zeros((1, len(dynamics.control_names)))
        force = dynamics.table(forces, np.array([t]), level[None, :], controls)[0]
        return Setpoint(place, rate, [*(acceleration[:3] - force / mass), acceleration[3]])

    return told


def _flights_of_set(mission: _Mission) -> Iterator[Flown]:
    """Describe flights of one of RotorPy's vehicles in both models, to be simulated later.

    All flights follow the plan of `mission`, a mission of the vehicle.
    """
    theirs = OutsidePlant(
        mission.scenario,
        mission.dynamics,
        parameters=rotorpy_parameters(mission.case),
        frame=ACROSS,
        habits=MASSLESS_ROTORS,
    )
    yield mission.declared(Pilot.OPEN_LOOP)
    yield mission.declared(Pilot.ADAPTIVE)
    for pilot in Pilot:
        yield mission.outside(Plant.WITHOUT_ROTOR_INERTIA, theirs, pilot)
    # Under SE3 once more, with the heading turned by the angle between the body axes of the models.
    path = mission.path(Reference.PLAN)

    def turned(t: float) -> Setpoint:
        place, rate, acceleration, _ = path(t)
        return Setpoint([*place[:3], place[3] - theirs.turn], rate, acceleration)

    yield mission.under(Plant.WITHOUT_ROTOR_INERTIA, theirs, OUR_HEADING, turned, Reference.PLAN)


def _flights_by_drag(mission: _Mission) -> Iterator[Flown]:
    """Describe flights that show the effect of the point at which drag acts, to be simulated later.

    In RotorPy drag acts at the rotors, in the declared vehicle at the centre of mass.
    """
    plant = OutsidePlant(mission.scenario, mission.dynamics)
    for pilot in (Pilot.OPEN_LOOP, Pilot.ADAPTIVE):
        yield mission.declared(pilot)
        yield mission.outside(Plant.ROTORPY, plant, pilot)


_FLIGHTS_OF = dict.fromkeys((LONGER, WINDIER), _flights_by_drag) | dict.fromkeys(
    NAMES, _flights_of_set
)


def _rows(
    case: str, flights: Iterator[Flown]
) -> Iterator[tuple[dict[str, Any], Flown, Flight | None]]:
    """Simulate flights; yield each flight's table row, its description, and the flight itself.

    `case` names the mission in the rows. A flight that went out of control is None. Rows compare a
    flight with the declared vehicle's earlier flight along the same reference, if any.
    """
    declared: dict[tuple[str, Reference], Flight] = {}
    for flown in flights:
        identity = case, flown.plant.value, str(flown.controller), flown.followed.value
        row: dict[str, Any] = dict(zip(_IDENTITY, identity, strict=True))
        try:
            flight = flown.fly()
        except (SolveError, ScenarioError):
            yield row | {OutsideColumn.ARRIVED: False, OutsideColumn.VERIFIED: False}, flown, None
            continue
        key = flown.controller, flown.followed
        # A declared flight is compared with itself: its differences are 0.
        if flown.plant is Plant.DECLARED:
            declared[key] = flight
        # Without a declared flight under the same controller, compare with the adaptive one.
        ours = declared.get(key) or declared.get((Pilot.ADAPTIVE, flown.followed))
        row |= {
            OutsideColumn.ENERGY: flight.energy_J,
            OutsideColumn.MISS: flight.terminal_miss_m,
            OutsideColumn.ARRIVED: has_arrived(flight),
            OutsideColumn.VERIFIED: flight.is_verified,
        }
        if ours is not None:
            ends = ([f.terminal_miss[name] for name in POSITION_STATES] for f in (flight, ours))
            percent = 100.0 * (flight.energy_J / ours.energy_J - 1.0)
            row |= {OutsideColumn.ENERGY_DIFFERENCE: percent, OutsideColumn.APART: dist(*ends)}
        yield row, flown, flight
