"""What knowing the wind between buildings saves, over all directions from which it may blow.

    python -m tests.benchmarks fields [--minutes M]

The mission is that of `scenarios/street.toml`, with its goal and start as they are.  In the wind of
every direction it is planned with the field and with the field's mean, and an autopilot flies the
shortest clear way.  All three are flown in the field, under the same controller.  A row is written
as soon as it is known, and what is there is not flown again: a run that was stopped goes on.
"""

import json
import tomllib
from dataclasses import asdict, dataclass
from math import atan2, hypot, nan
from pathlib import Path
from time import perf_counter, process_time

import numpy as np

from pyomo_quad.flight import Planner
from pyomo_quad.flight.baselines import fly_baseline
from pyomo_quad.polar.polar import mean_wind
from pyomo_quad.scenario import load_scenario
from pyomo_quad.scenario.messages import PyomoQuadError
from pyomo_quad.scenario.tables import Reference
from pyomo_quad.study.autopilot import fly_cruise
from pyomo_quad.study.comparison import has_arrived
from tests.benchmarks.report import FOLDER, Table

TITLE = "A street in the wind of every direction"
FIGURE = "fields.svg"
ABOUT = (
    "The mission of `scenarios/street.toml` in the wind of each of the 18 directions of "
    "`scenarios/winds`, 6 m/s undisturbed; the directions are those flown so far. *Field*: planned "
    "with the wind field. *Mean*: planned with the mean of the field everywhere. *Straight*: the "
    "shortest clear way from rest to rest, as an autopilot flies it at 10 m/s over ground. Each is "
    "flown in the field under the same adaptive controller; energies are those of these flights, in "
    "J. Plans to the accuracy `quick`, 0.1 % of energy. Limits are those of the scenario, which "
    f"leave a controller no reserve. A plan counts only where it was verified.\n\n![{TITLE}]({FIGURE})"
)
SCENARIO = Path(__file__).parents[2] / "scenarios" / "street.toml"
# Neighbours lie far apart in this order, so that a run that was stopped has directions all round.
DIRECTIONS_DEG = (40, 220, 120, 300, 0, 180, 80, 260, 160, 340, 20, 200, 100, 280, 60, 240,
                  140, 320)  # fmt: skip
WAYS = ("field", "mean", "straight")
RESULTS = FOLDER / "fields.jsonl"
STRAIGHT_SPEED_M_PER_S = 10.0
LONGEST_SOLVE_S = 300


@dataclass(frozen=True)
class Flown:
    """How a mission was flown; energies in J, those of the plan where there is one."""

    direction_deg: int
    way: str
    planned_J: float
    flown_J: float
    duration_s: float
    has_arrived: bool
    broken: str
    detail: str
    processor_s: float


def street(direction_deg, accuracy="quick"):
    """Return the scenario in the wind of a direction."""
    field = SCENARIO.parent / "winds" / f"street_{direction_deg:03d}.nc"
    return load_scenario(
        SCENARIO,
        [
            f"wind.field='{field}'",
            f"solver.accuracy='{accuracy}'",
            f"solver.time_limit={LONGEST_SOLVE_S}",
        ],
    )


def in_mean_wind(told):
    """Return a mission with the mean of its wind field everywhere."""
    x, y = mean_wind(told)
    written = tomllib.loads(SCENARIO.read_text(encoding="utf-8"))
    written["wind"] = {
        "use": "constant",
        "speed": hypot(x, y),
        "direction": atan2(y, x),
        "coupling": told.wind.coupling.value,
    }
    return told.model_copy(update={"wind": load_scenario(written).wind})


def fly(direction_deg, way, planner):
    """Plan a mission in one of the ways and fly it in the field."""
    told, began, planned = street(direction_deg), process_time(), nan
    try:
        if way == "straight":
            settings = told.baseline.cruise_settings(STRAIGHT_SPEED_M_PER_S)
            flight = fly_cruise(told, settings, None, planner)
        else:
            plan = planner.solve(told if way == "field" else in_mean_wind(told))
            if not plan.is_verified:
                return _lost(direction_deg, way, f"{plan.status}: {plan.message}", began)
            planned = plan.energy
            flown = plan.mission_flown.model_copy(update={"wind": told.wind})
            flight = fly_baseline(
                flown, Reference.PLAN, dynamics=planner.dynamics(flown), plan=plan
            )
    except PyomoQuadError as error:
        return _lost(direction_deg, way, str(error), began)
    return Flown(
        direction_deg=direction_deg,
        way=way,
        planned_J=planned,
        flown_J=flight.energy_J,
        duration_s=flight.duration_s,
        has_arrived=has_arrived(flight),
        broken="; ".join(flight.broken_limits),
        detail=flight.doubt,
        processor_s=process_time() - began,
    )


def _lost(direction_deg, way, detail, began):
    return Flown(direction_deg, way, nan, nan, nan, False, "", detail, process_time() - began)


def finished(results=RESULTS):
    """Return the flights that a results file holds."""
    if not results.exists():
        return []
    return [Flown(**json.loads(line)) for line in results.read_text(encoding="utf-8").splitlines()]


def fly_all(minutes, results=RESULTS):
    """Fly what the results do not hold, and write each flight down as it ends."""
    known = {(flown.direction_deg, flown.way) for flown in finished(results)}
    deadline = perf_counter() + 60.0 * (np.inf if minutes is None else minutes)
    results.parent.mkdir(parents=True, exist_ok=True)
    planner = Planner()
    for asked in ((direction, way) for direction in DIRECTIONS_DEG for way in WAYS):
        if asked in known:
            continue
        if perf_counter() > deadline:
            break
        flown = fly(*asked, planner)
        with results.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(flown)) + "\n")
