"""Missions flown by the declared vehicle and by RotorPy's, and the report of their differences."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from importlib.metadata import version
from math import ceil, dist
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.constants import g as standard_gravity

from pyomo_quad.collocation import Dynamics, SolveError
from pyomo_quad.flight import Flight, Plan, Planner
from pyomo_quad.flight.baselines import (
    fly_baseline,
    fly_open_loop,
    reference_path,
    start_state,
)
from pyomo_quad.flight.flight import AIR_FORCE, COLUMNS, POSITION_STATES, TIME, VELOCITY_STATES
from pyomo_quad.flight.outside_plant import (
    ACROSS,
    AS_IT_COMES,
    MASSLESS_ROTORS,
    PLANT,
    Habits,
    OutsidePlant,
    Pilot,
    fly_outside,
    fly_under,
    se3_law,
)
from pyomo_quad.flight.references import ReferencePath, Setpoint
from pyomo_quad.report import Figures
from pyomo_quad.report.document import REPORT_NAME, Drawing, save_drawings, wanted_drawings
from pyomo_quad.report.render import render_markdown
from pyomo_quad.report.style import LEGEND_COLUMNS, SERIES_STYLES, label_time, panel_grid
from pyomo_quad.report.tables import write_table
from pyomo_quad.scenario import Reference, Scenario, ScenarioError, load_scenario
from pyomo_quad.scenario.description import shipped_scenarios
from pyomo_quad.simulators.vehicles import NAMES, rotorpy_parameters, vehicle_fields
from pyomo_quad.study.comparison import has_arrived
from pyomo_quad.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TABLE_NAME = "flights.csv"

_EXACT = {"vehicle.attitude": "euler"}
_BREEZE = {
    "wind.use": "constant",
    "wind.speed": 3.0,
    "wind.direction": 1.0,
    "wind.coupling": "drag",
}
_DRAG = {
    "wind.coupling": "drag",
    "vehicle.drag_linear": 0.25,
    "vehicle.drag_quadratic": 0.02,
}

PRINTED, EXACT, BREEZE = "printed", "exact", "breeze"
LONGER, WINDIER = "breeze_longer", "breeze_windier"
#: Name of a case -> what it is, and the settings that make it of the paper's first mission.
CASES: Mapping[str, tuple[str, Mapping[str, Any]]] = MappingProxyType(
    {
        PRINTED: ("Euler rates equal to body rates, as the paper prints", {}),
        EXACT: ("exact kinematics and the rotors' yaw reaction", _EXACT),
        BREEZE: ("as exact, with drag, in 3 m/s of wind", _EXACT | _DRAG | _BREEZE),
        LONGER: (
            "as breeze, in twice the time",
            _EXACT | _DRAG | _BREEZE | {"mission.duration": 20.0},
        ),
        WINDIER: ("as breeze, in 6 m/s of wind", _EXACT | _DRAG | _BREEZE | {"wind.speed": 6.0}),
    }
)
#: Cases that show where the difference that the drag's place makes holds.
DRAG_CASES = (BREEZE, LONGER, WINDIER)
# Shaft power hardly prices the rotors' acceleration: a plan of light rotors to more digits takes
# minutes, and this one ends less than a tenth of a millimetre off.
_PRICED = {"power.model": "shaft", "solver.tolerance": 1e-3}
_GOAL, _DURATION = [3.0, 2.0, 1.5], 6.0
_NO_SLEW_LIMIT = {"limits.rotor_acceleration_max": 1e7}
_MOST_SAMPLES = 250
# Distances that are told apart [m].
_LEAST_SHOWN, _LEAST_LED = 1e-9, 1e-4
_CAUSES_ABREAST = 3

Track = tuple[np.ndarray, np.ndarray]
"""Times [s] and distances [m], shape (n,) each."""


class Plant(StrEnum):
    """What flew."""

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


#: What RotorPy does in each of its own ways, one by one and all at once.
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

#: What makes flights differ -> the case and the plant that show it.
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

#: Controllers made of SE3 that show why it misses or spends.
TOLD, STIFF, OUR_HEADING = "se3, told the air's force", "se3, stiffer", "se3, told our heading"
_STIFFNESS = 4.0


class Column(StrEnum):
    """Columns of the table of flights, in order."""

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


@dataclass(frozen=True, kw_only=True)
class OutsideStudy:
    """All flights, in the columns of `Column`, and how far those along plans were from them."""

    flights: pd.DataFrame
    tracks: Mapping[tuple[str, Plant, str], Track]
    lag_s: float
    """Of the motors of the paper's vehicle in RotorPy."""

    def row(
        self, case: str, plant: Plant, controller: str, followed: Reference = Reference.PLAN
    ) -> dict[str, Any]:
        """Return a flight's row; a flight that was lost has no numbers."""
        held = self.flights
        chosen = (
            (held[Column.CASE] == case)
            & (held[Column.PLANT] == plant)
            & (held[Column.CONTROLLER] == controller)
            & (held[Column.FOLLOWED] == followed)
        )
        return {str(name): value for name, value in held[chosen].iloc[0].items()}


class Arrivals(NamedTuple):
    """How many flights arrive, of those that both integrators confirm, and how many they do not."""

    arrived: int
    confirmed: int
    unconfirmed: int


def arrivals(flights: pd.DataFrame, controller: str) -> Arrivals:
    """Count the flights of a controller on every plant that is not declared, in `flights.csv`."""
    is_outside = (flights[Column.CONTROLLER] == controller) & (
        flights[Column.PLANT] != Plant.DECLARED
    )
    outside = flights[is_outside]
    is_confirmed = outside[Column.VERIFIED].astype(bool)
    return Arrivals(
        arrived=int(outside[Column.ARRIVED][is_confirmed].sum()),
        confirmed=int(is_confirmed.sum()),
        unconfirmed=int((~is_confirmed).sum()),
    )


def run_outside_study(planner: Planner | None = None) -> OutsideStudy:
    """Fly every case; a controller that loses its vehicle leaves a row without numbers."""
    planner = planner or Planner()
    paper = load_scenario(shipped_scenarios()["paper"])
    cases = {case: paper.with_values(settings) for case, (_, settings) in CASES.items()}
    cases |= {name: _small(paper, name) for name in NAMES}
    rows: list[dict[str, Any]] = []
    tracks: dict[tuple[str, Plant, str], Track] = {}
    for case, scenario in cases.items():
        plan = planner.solve(scenario)
        flights = _FLIGHTS_OF.get(case, _flights)
        for row, flight in _rows(case, flights(case, scenario, plan, planner)):
            rows.append(row)
            if flight is not None and row[Column.FOLLOWED] == Reference.PLAN:
                key = case, Plant(row[Column.PLANT]), row[Column.CONTROLLER]
                tracks[key] = _track(flight, plan)
    return OutsideStudy(
        flights=pd.DataFrame(rows, columns=[column.value for column in Column]),
        tracks=tracks,
        lag_s=1.0 / paper.baseline.gains.rotor,
    )


def _track(flight: Flight, plan: Plan) -> Track:
    """Return how far a flight is from its plan over time."""
    step = max(1, len(flight.frame) // _MOST_SAMPLES)
    shown = flight.frame.iloc[::step]
    t = shown[TIME].to_numpy()
    held = plan.trajectories
    columns = [held.state_names.index(name) for name in POSITION_STATES]
    flown = shown[[c.name for c in COLUMNS if c.component in POSITION_STATES]].to_numpy()
    return t, np.linalg.norm(flown - held.states_at(t)[:, columns], axis=1)


def _small(paper: Scenario, name: str) -> Scenario:
    """Return a short mission of a RotorPy vehicle, priced by what its rotors take."""
    said = {
        path.replace("fields.", "vehicle.", 1): value
        for path, (value, _) in vehicle_fields(name).items()
    }
    mission = {"mission.goal.position": _GOAL, "mission.duration": _DURATION}
    return paper.with_values(said | _EXACT | mission | _PRICED)


Flown = tuple[Plant, str, Reference, Callable[[], Flight]]


def _flights(case: str, scenario: Scenario, plan: Plan, planner: Planner) -> Iterator[Flown]:
    dynamics = planner.dynamics(scenario)
    alone, plant = Pilot.OPEN_LOOP, OutsidePlant(scenario, dynamics)
    yield Plant.DECLARED, alone, Reference.PLAN, partial(fly_open_loop, scenario, plan, dynamics)
    for reference in (Reference.QUINTIC, Reference.PLAN):
        ours = partial(fly_baseline, scenario, reference, dynamics=dynamics, plan=plan)
        yield Plant.DECLARED, Pilot.ADAPTIVE, reference, ours
        for pilot in (Pilot.ADAPTIVE, Pilot.SE3):
            theirs = partial(fly_outside, plant, pilot, reference, plan)
            yield Plant.ROTORPY, pilot, reference, theirs
    shown = {at for of, at in CAUSES.values() if of == case}
    for at in (which for which in HABITS if which in shown):
        flown = OutsidePlant(scenario, dynamics, habits=HABITS[at])
        yield at, alone, Reference.PLAN, partial(fly_outside, flown, alone, Reference.PLAN, plan)
        if at is not Plant.ROTORPY:
            followed = partial(fly_outside, flown, Pilot.ADAPTIVE, Reference.PLAN, plan)
            yield at, Pilot.ADAPTIVE, Reference.PLAN, followed
    if case == EXACT:
        yield from _leaps(scenario, plan, dynamics)
    if case == BREEZE:
        yield from _why_se3_misses(plant, plan)


def _leaps(scenario: Scenario, plan: Plan, dynamics: Dynamics) -> Iterator[Flown]:
    """Yield flights to a goal given all at once, their rotors within their limit and beyond it."""
    limited = OutsidePlant(scenario, dynamics)
    unlimited = OutsidePlant(scenario.with_values(_NO_SLEW_LIMIT), dynamics)
    ours = partial(fly_baseline, scenario, Reference.STEP, dynamics=dynamics, plan=plan)
    yield Plant.DECLARED, Pilot.ADAPTIVE, Reference.STEP, ours
    for pilot in (Pilot.ADAPTIVE, Pilot.SE3):
        for at, plant in ((Plant.ROTORPY, limited), (Plant.WITHOUT_SLEW_LIMIT, unlimited)):
            yield (
                at,
                pilot,
                Reference.STEP,
                partial(fly_outside, plant, pilot, Reference.STEP, plan),
            )


def _why_se3_misses(plant: OutsidePlant, plan: Plan) -> Iterator[Flown]:
    for reference in (Reference.QUINTIC, Reference.PLAN):
        path = reference_path(plant.scenario, reference, plan)
        stiffer = se3_law(plant, path, stiffness=_STIFFNESS)
        yield Plant.ROTORPY, STIFF, reference, partial(fly_under, plant, STIFF, stiffer, plan)
        if reference is Reference.QUINTIC:
            told = se3_law(plant, _against_the_air(path, plant))
            yield Plant.ROTORPY, TOLD, reference, partial(fly_under, plant, TOLD, told, plan)


def _against_the_air(path: ReferencePath, plant: OutsidePlant) -> ReferencePath:
    """Return a reference that also asks for what holds the vehicle against the air, level."""
    dynamics, mass = plant.dynamics, plant.scenario.vehicle.total_mass
    moving = [dynamics.state_names.index(name) for name in (*POSITION_STATES, *VELOCITY_STATES)]
    forces = tuple((name, None) for name in AIR_FORCE)

    def told(t: float) -> Setpoint:
        place, rate, acceleration = path(t)
        level = start_state(plant.scenario, dynamics)
        level[moving] = *place[:3], *rate[:3]
        controls = np.zeros((1, len(dynamics.control_names)))
        force = dynamics.table(forces, np.array([t]), level[None, :], controls)[0]
        return Setpoint(place, rate, [*(acceleration[:3] - force / mass), acceleration[3]])

    return told


def _flights_of_set(name: str, scenario: Scenario, plan: Plan, planner: Planner) -> Iterator[Flown]:
    """Yield flights of RotorPy's vehicle as it comes, beside the one made of its numbers."""
    dynamics = planner.dynamics(scenario)
    theirs = OutsidePlant(
        scenario,
        dynamics,
        parameters=rotorpy_parameters(name),
        frame=ACROSS,
        habits=MASSLESS_ROTORS,
    )
    followed, outside = Reference.PLAN, Plant.WITHOUT_ROTOR_INERTIA
    alone = partial(fly_open_loop, scenario, plan, dynamics)
    yield Plant.DECLARED, Pilot.OPEN_LOOP, followed, alone
    ours = partial(fly_baseline, scenario, followed, dynamics=dynamics, plan=plan)
    yield Plant.DECLARED, Pilot.ADAPTIVE, followed, ours
    for pilot in Pilot:
        yield outside, pilot, followed, partial(fly_outside, theirs, pilot, followed, plan)
    path = reference_path(scenario, followed, plan)

    def turned(t: float) -> Setpoint:
        place, rate, acceleration = path(t)
        return Setpoint([*place[:3], place[3] - theirs.turn], rate, acceleration)

    law = se3_law(theirs, turned)
    yield outside, OUR_HEADING, followed, partial(fly_under, theirs, OUR_HEADING, law, plan)


def _flights_by_drag(_: str, scenario: Scenario, plan: Plan, planner: Planner) -> Iterator[Flown]:
    """Yield the flights along a plan that tell RotorPy's drag from the declared one."""
    dynamics, followed = planner.dynamics(scenario), Reference.PLAN
    plant = OutsidePlant(scenario, dynamics)
    ours = {
        Pilot.OPEN_LOOP: partial(fly_open_loop, scenario, plan, dynamics),
        Pilot.ADAPTIVE: partial(fly_baseline, scenario, followed, dynamics=dynamics, plan=plan),
    }
    for pilot, fly in ours.items():
        yield Plant.DECLARED, pilot, followed, fly
        yield Plant.ROTORPY, pilot, followed, partial(fly_outside, plant, pilot, followed, plan)


_FLIGHTS_OF = dict.fromkeys((LONGER, WINDIER), _flights_by_drag) | dict.fromkeys(
    NAMES, _flights_of_set
)


def _rows(case: str, flights: Iterator[Flown]) -> Iterator[tuple[dict[str, Any], Flight | None]]:
    """Yield a row for each flight, against that of the declared vehicle flown before it."""
    declared: dict[tuple[str, Reference], Flight] = {}
    for plant, pilot, followed, fly in flights:
        named: dict[str, Any] = {
            Column.CASE: case,
            Column.PLANT: plant.value,
            Column.CONTROLLER: str(pilot),
            Column.FOLLOWED: followed.value,
        }
        try:
            flight = fly()
        except (SolveError, ScenarioError):
            yield named | {Column.ARRIVED: False, Column.VERIFIED: False}, None
            continue
        if plant is Plant.DECLARED:
            declared[pilot, followed] = flight
        ours = declared.get((pilot, followed)) or declared.get((Pilot.ADAPTIVE, followed))
        told: dict[str, Any] = {
            Column.ENERGY: flight.energy_J,
            Column.ENERGY_DIFFERENCE: _percent(flight, ours),
            Column.MISS: flight.terminal_miss_m,
            Column.ARRIVED: has_arrived(flight),
            Column.APART: _apart(flight, ours),
            Column.VERIFIED: flight.is_verified,
        }
        yield named | told, flight


def _percent(flight: Flight, ours: Flight | None) -> float:
    return np.nan if ours is None else 100.0 * (flight.energy_J / ours.energy_J - 1.0)


def _apart(flight: Flight, ours: Flight | None) -> float:
    if ours is None:
        return np.nan
    here, there = ([f.terminal_miss[name] for name in POSITION_STATES] for f in (flight, ours))
    return dist(here, there)


def draw_causes(study: OutsideStudy) -> "Figure":
    """Draw how far flights are from their plan over time, by what makes them differ."""
    # The labels are long, so that the legend takes more lines than usual.
    lines = ceil(len(CAUSES) / _CAUSES_ABREAST)
    figure, (panels,) = panel_grid(1, 2, panel_height=2.6, legend_entries=lines * LEGEND_COLUMNS)
    for axes, pilot, title, least in (
        (panels[0], Pilot.OPEN_LOOP, "Without feedback: distance from the plan (m)", _LEAST_SHOWN),
        (panels[1], Pilot.ADAPTIVE, "Under our controller: distance from the plan (m)", _LEAST_LED),
    ):
        for (cause, (case, plant)), style in zip(CAUSES.items(), SERIES_STYLES, strict=True):
            track = study.tracks.get((case, plant, pilot))
            if track is not None:
                t, distance = track
                axes.plot(t, np.maximum(distance, least), label=cause, **style.line)
        axes.set_yscale("log")
        axes.set_title(title)
    label_time(panels, max(t[-1] for t, _ in study.tracks.values()))
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=_CAUSES_ABREAST)
    return figure


def write_outside_report(folder: Path, study: OutsideStudy, figures: Figures = Figures.SVG) -> None:
    """Write the table and `report.md` into an existing folder."""
    write_table(study.flights, folder / TABLE_NAME)
    drawing = Drawing(
        name="causes",
        title="Over time",
        caption="How far each flight is from its plan, one cause at a time; what is nearer than "
        f"{_LEAST_SHOWN:g} m, or {_LEAST_LED:g} m under feedback, is drawn there.",
        draw=lambda: draw_causes(study),
    )
    drawings = wanted_drawings([drawing], figures)
    save_drawings(drawings, folder)
    text = render_markdown(
        "simulators/outside_plant.md.j2",
        study=study,
        drawings=drawings,
        causes=CAUSES,
        drag_cases=DRAG_CASES,
        arrivals={pilot: arrivals(study.flights, pilot) for pilot in (Pilot.ADAPTIVE, Pilot.SE3)},
        pilot=Pilot,
        plant=Plant,
        reference=Reference,
        breeze=BREEZE,
        exact=EXACT,
        told=TOLD,
        stiff=STIFF,
        our_heading=OUR_HEADING,
        stiffness=_STIFFNESS,
        lag_ms=1e3 * study.lag_s,
        rows=study.flights.to_dict("records"),
        column=Column,
        cases=CASES,
        sets=NAMES,
        TABLE_NAME=TABLE_NAME,
        version=__version__,
        version_of_rotorpy=version(PLANT),
    )
    (folder / REPORT_NAME).write_text(text, encoding="utf-8")
