"""The saving by knowing the wind between buildings, over all directions from which it may blow.

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

import matplotlib.pyplot as plt
import numpy as np

from pyomo_quad.flight import Planner
from pyomo_quad.flight.baselines import fly_baseline
from pyomo_quad.flight.corridors import steady_power
from pyomo_quad.model.wind import mean_wind
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
    "shortest clear way from rest to rest, as an autopilot flies it, at the ground speed of least "
    "energy per metre in the mean wind. Each is flown in the field under the same adaptive "
    "controller; energies are those of these flights. "
    "Plans have the accuracy `quick`, 0.1 % of energy. Limits are those of the scenario, which "
    "leave a controller no reserve, so that a plan flown under it ends some decimetres off; a "
    "flight within 0.05 m of the goal has arrived. A plan counts only where it was verified: its "
    "controls alone, flown in the wind it was made for, keep all limits. Savings are those of the "
    "plan with the "
    "field over flights that arrive and keep all limits."
    f"\n\n![{TITLE}]({FIGURE})"
)
SCENARIO = Path(__file__).parents[2] / "scenarios" / "street.toml"
# Neighbours lie far apart in this order, so that a run that was stopped has directions all round.
DIRECTIONS_DEG = (40, 220, 120, 300, 0, 180, 80, 260, 160, 340, 20, 200, 100, 280, 60, 240,
                  140, 320)  # fmt: skip
WAYS = ("field", "mean", "straight")
RESULTS = FOLDER / "fields.jsonl"
# Ground speeds among which an autopilot chooses, m/s.
SPEEDS_M_PER_S = np.arange(4.0, 19.0)
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
    miss_m: float
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


def cheapest_speed(told, planner):
    """Return the ground speed of least energy per metre from start to goal in the mean wind."""
    way = np.subtract(told.mission.goal.position, told.mission.start.position)[:2]
    ground = SPEEDS_M_PER_S[:, None] * way / np.linalg.norm(way)
    airspeeds = np.linalg.norm(ground - mean_wind(told), axis=1)
    power = steady_power(planner.steady_flight(told))
    return float(SPEEDS_M_PER_S[np.argmin(power(airspeeds) / SPEEDS_M_PER_S)])


def fly(direction_deg, way, planner):
    """Plan a mission in one of the ways and fly it in the field."""
    told, began, planned = street(direction_deg), process_time(), nan
    try:
        if way == "straight":
            settings = told.baseline.cruise_settings(cheapest_speed(told, planner))
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
        miss_m=flight.terminal_miss_m,
        broken="; ".join(flight.broken_limits),
        detail=flight.doubt,
        processor_s=process_time() - began,
    )


def _lost(direction_deg, way, detail, began):
    return Flown(direction_deg, way, nan, nan, nan, False, nan, "", detail, process_time() - began)


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


def is_sound(flown):
    """Return whether a flight arrived and kept all limits."""
    return flown.has_arrived and not flown.broken


def rows_of(flights):
    """Yield a row for each direction: energies, limits, and what the field saves."""
    by_key = {(flown.direction_deg, flown.way): flown for flown in flights}
    for direction in sorted({flown.direction_deg for flown in flights}):
        ways = [by_key.get((direction, way)) for way in WAYS]
        energies = ["-" if w is None or np.isnan(w.flown_J) else f"{w.flown_J:.0f}" for w in ways]
        limits = ["-" if w is None else _ending(w) for w in ways]
        planned = ways[0].planned_J if ways[0] else nan
        savings = [_saving(planned, other) for other in ways[1:]]
        yield [
            direction,
            "-" if np.isnan(planned) else f"{planned:.0f}",
            *energies,
            *limits,
            *savings,
        ]


def _ending(flown):
    if np.isnan(flown.flown_J):
        return flown.detail
    return ("" if flown.has_arrived else f"ends {flown.miss_m:.2g} m off; ") + (
        flown.broken or "kept"
    )


def _saving(planned_J, other):
    """Return the share of a sound flight's energy that the plan with the field saves."""
    if np.isnan(planned_J) or other is None or not is_sound(other):
        return "-"
    return f"{100.0 * (1.0 - planned_J / other.flown_J):.1f}"


def draw(flights, folder=FOLDER):
    """Draw the energies over the direction of the undisturbed wind."""
    figure, axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    for way, marker in zip(WAYS, "os^", strict=True):
        told = sorted((f.direction_deg, f.flown_J / 1e3) for f in flights if f.way == way)
        axes.plot(*zip(*told, strict=True), marker, label=way, fillstyle="none")
    axes.set(xlabel="Wind toward, from x counter-clockwise (deg)", ylabel="Energy flown (kJ)")
    axes.legend(frameon=False)
    figure.savefig(folder / FIGURE, metadata={"Date": None})
    plt.close(figure)


def measure(arguments):
    """Return tables of the directions flown and of the effort."""
    fly_all(arguments.minutes)
    flights = finished()
    draw(flights)
    header = ["wind toward deg", "plan J"]
    header += [f"{way} J" for way in WAYS] + [f"limits, {way}" for way in WAYS]
    header += [f"saved over {way} %" for way in WAYS[1:]]
    seconds = [
        [way, len(spent), f"{np.median(spent):.0f}", f"{max(spent):.0f}"]
        for way in WAYS
        if (spent := [f.processor_s for f in flights if f.way == way])
    ]
    effort = ["way", "flights", "median s", "longest s"]
    return [
        Table(name="fields", title="Energies flown", header=header, rows=list(rows_of(flights))),
        Table(name="fields_effort", title="Effort, plan and flights", header=effort, rows=seconds),
    ]
