"""Missions flown by the declared vehicle and by RotorPy's, and the report of their differences."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from importlib.metadata import version
from math import dist
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd

from pyomo_quad.collocation import SolveError
from pyomo_quad.flight import Flight, Plan, Planner
from pyomo_quad.flight.baselines import fly_baseline, fly_open_loop
from pyomo_quad.flight.flight import POSITION_STATES
from pyomo_quad.flight.outside_plant import ACROSS, PLANT, OutsidePlant, Pilot, fly_outside
from pyomo_quad.report.render import render_markdown, rough
from pyomo_quad.report.report import REPORT_NAME
from pyomo_quad.report.tables import write_table
from pyomo_quad.scenario import Reference, Scenario, ScenarioError, load_scenario
from pyomo_quad.scenario.shipped import shipped_scenarios
from pyomo_quad.simulators.vehicles import NAMES, rotorpy_parameters, vehicle_fields
from pyomo_quad.study.comparison import has_arrived
from pyomo_quad.version import __version__

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
#: Name of a case -> what it is, and the settings that make it of the paper's first mission.
CASES: Mapping[str, tuple[str, Mapping[str, Any]]] = MappingProxyType(
    {
        PRINTED: ("Euler rates equal to body rates, as the paper prints", {}),
        EXACT: ("exact kinematics and the rotors' yaw reaction", _EXACT),
        BREEZE: ("as exact, with drag, in 3 m/s of wind", _EXACT | _DRAG | _BREEZE),
    }
)
# Shaft power hardly prices the rotors' acceleration: a plan of light rotors to more digits takes
# minutes, and this one ends less than a tenth of a millimetre off.
_PRICED = {"power.model": "shaft", "solver.tolerance": 1e-3}
_GOAL, _DURATION = [3.0, 2.0, 1.5], 6.0


class Plant(StrEnum):
    """What flew."""

    DECLARED = "declared"
    ROTORPY = "rotorpy"
    WITHOUT_ROTOR_INERTIA = "rotorpy, rotors without inertia"


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
    """All flights, in the columns of `Column`, and the plans' energies by case [J]."""

    flights: pd.DataFrame
    planned: dict[str, float]

    def apart(self, case: str, plant: Plant, controller: Pilot = Pilot.OPEN_LOOP) -> float:
        """Return how far a flight along the plan ends from that of the declared vehicle [m]."""
        held = self.flights
        chosen = (
            (held[Column.CASE] == case)
            & (held[Column.PLANT] == plant)
            & (held[Column.CONTROLLER] == controller)
            & (held[Column.FOLLOWED] == Reference.PLAN)
        )
        return float(held.loc[chosen, Column.APART].iloc[0])


def run_outside_study(planner: Planner | None = None) -> OutsideStudy:
    """Fly every case; a controller that loses its vehicle leaves a row without numbers."""
    planner = planner or Planner()
    paper = load_scenario(shipped_scenarios()["paper"])
    rows: list[dict[str, Any]] = []
    planned = {}
    for case, (_, settings) in CASES.items():
        scenario = paper.with_values(settings)
        plan = planner.solve(scenario)
        planned[case] = plan.energy
        rows += _rows(case, _flights(scenario, plan, planner))
    for name in NAMES:
        scenario = _small(paper, name)
        plan = planner.solve(scenario)
        planned[name] = plan.energy
        rows += _rows(name, _flights_of_set(name, scenario, plan, planner))
    return OutsideStudy(
        flights=pd.DataFrame(rows, columns=[column.value for column in Column]), planned=planned
    )


def _small(paper: Scenario, name: str) -> Scenario:
    """Return a short mission of a RotorPy vehicle, priced by what its rotors take."""
    said = {
        path.replace("fields.", "vehicle.", 1): value
        for path, (value, _) in vehicle_fields(name).items()
    }
    mission = {"mission.goal.position": _GOAL, "mission.duration": _DURATION}
    return paper.with_values(said | _EXACT | mission | _PRICED)


Flown = tuple[Plant, Pilot, Reference, Callable[[], Flight]]


def _flights(scenario: Scenario, plan: Plan, planner: Planner) -> Iterator[Flown]:
    dynamics = planner.dynamics(scenario)
    plant = OutsidePlant(scenario, dynamics)
    bare = OutsidePlant(scenario, dynamics, has_rotor_inertia=False)
    alone, followed = Pilot.OPEN_LOOP, Reference.PLAN
    yield Plant.DECLARED, alone, followed, partial(fly_open_loop, scenario, plan, dynamics)
    for outside, flown in ((Plant.ROTORPY, plant), (Plant.WITHOUT_ROTOR_INERTIA, bare)):
        yield outside, alone, followed, partial(fly_outside, flown, alone, followed, plan)
    for reference in (Reference.QUINTIC, Reference.PLAN):
        ours = partial(fly_baseline, scenario, reference, dynamics=dynamics, plan=plan)
        yield Plant.DECLARED, Pilot.ADAPTIVE, reference, ours
        for pilot in (Pilot.ADAPTIVE, Pilot.SE3):
            yield (
                Plant.ROTORPY,
                pilot,
                reference,
                partial(fly_outside, plant, pilot, reference, plan),
            )


def _flights_of_set(name: str, scenario: Scenario, plan: Plan, planner: Planner) -> Iterator[Flown]:
    """Yield flights of RotorPy's vehicle as it comes, beside the one made of its numbers."""
    dynamics = planner.dynamics(scenario)
    theirs = OutsidePlant(
        scenario,
        dynamics,
        parameters=rotorpy_parameters(name),
        frame=ACROSS,
        has_rotor_inertia=False,
    )
    followed = Reference.PLAN
    alone = partial(fly_open_loop, scenario, plan, dynamics)
    yield Plant.DECLARED, Pilot.OPEN_LOOP, followed, alone
    ours = partial(fly_baseline, scenario, followed, dynamics=dynamics, plan=plan)
    yield Plant.DECLARED, Pilot.ADAPTIVE, followed, ours
    for pilot in Pilot:
        flown = partial(fly_outside, theirs, pilot, followed, plan)
        yield Plant.WITHOUT_ROTOR_INERTIA, pilot, followed, flown


def _rows(case: str, flights: Iterator[Flown]) -> Iterator[dict[str, Any]]:
    """Yield a row for each flight, against that of the declared vehicle flown before it."""
    declared: dict[tuple[Pilot, Reference], Flight] = {}
    for plant, pilot, followed, fly in flights:
        named = {
            Column.CASE: case,
            Column.PLANT: plant.value,
            Column.CONTROLLER: pilot.value,
            Column.FOLLOWED: followed.value,
        }
        try:
            flight = fly()
        except (SolveError, ScenarioError):
            yield named | {Column.ARRIVED: False, Column.VERIFIED: False}
            continue
        if plant is Plant.DECLARED:
            declared[pilot, followed] = flight
        ours = declared.get((pilot, followed)) or declared.get((Pilot.ADAPTIVE, followed))
        yield named | {
            Column.ENERGY: flight.energy_J,
            Column.ENERGY_DIFFERENCE: _percent(flight, ours),
            Column.MISS: flight.terminal_miss_m,
            Column.ARRIVED: has_arrived(flight),
            Column.APART: _apart(flight, ours),
            Column.VERIFIED: flight.is_verified,
        }


def _percent(flight: Flight, ours: Flight | None) -> float:
    return np.nan if ours is None else 100.0 * (flight.energy_J / ours.energy_J - 1.0)


def _apart(flight: Flight, ours: Flight | None) -> float:
    if ours is None:
        return np.nan
    here, there = ([f.terminal_miss[name] for name in POSITION_STATES] for f in (flight, ours))
    return dist(here, there)


def write_outside_report(folder: Path, study: OutsideStudy) -> None:
    """Write the table and `report.md` into an existing folder."""
    write_table(study.flights, folder / TABLE_NAME)
    apart = {case: study.apart(case, Plant.ROTORPY) for case in (PRINTED, EXACT, BREEZE)}
    apart["bare"] = study.apart(EXACT, Plant.WITHOUT_ROTOR_INERTIA)
    apart |= {name: study.apart(name, Plant.WITHOUT_ROTOR_INERTIA) for name in NAMES}
    text = render_markdown(
        "simulators/outside_plant.md.j2",
        apart={cause: rough(distance) for cause, distance in apart.items()},
        rows=study.flights.to_dict("records"),
        column=Column,
        cases=CASES,
        sets=NAMES,
        TABLE_NAME=TABLE_NAME,
        version=__version__,
        version_of_rotorpy=version(PLANT),
    )
    (folder / REPORT_NAME).write_text(text, encoding="utf-8")
