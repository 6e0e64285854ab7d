"""The saving by knowing the wind between buildings, over all directions from which it may blow.

    python -m tests.benchmarks fields [--minutes M]

The mission is that of `scenarios/street.toml`, with its goal and start as they are.  In the wind of
every direction it is planned with the field and with the field's mean, both with a risk of 0.01 in
light turbulence, and an autopilot flies the shortest clear way.  All three are flown in the field
many times, in the same turbulence, under the same controller.  A row is written as soon as it is
known, and what is there is not flown again: a run that was stopped goes on.
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
from pyomo_quad.flight.corridors import steady_power
from pyomo_quad.flight.risk import plan_at_risk
from pyomo_quad.model.wind import mean_wind
from pyomo_quad.scenario import load_scenario
from pyomo_quad.scenario.messages import PyomoQuadError
from pyomo_quad.scenario.wind import Intensity, Turbulence
from pyomo_quad.study.ensemble import fly_cruise_often, fly_plan_often
from tests.benchmarks.measuring import on_one_core
from tests.benchmarks.report import FOLDER, Table

TITLE = "A street in the wind of every direction"
FIGURE = "fields.svg"
# Flights of each plan, and how many of them must hold for a saving to be stated.
FLIGHTS, LEAST_HELD = 100, 95
# Seed of their winds; the margins of a plan are found in winds of other seeds.
FLOWN_SEED = 2026
# Risk that plans are asked to keep.
RISK = 0.01
ABOUT = (
    "The mission of `scenarios/street.toml` in the wind of each of the 18 directions of "
    "`scenarios/winds`, 6 m/s undisturbed, with light turbulence and a risk of 0.01. "
    "*Field*: planned with the wind field. *Mean*: planned with the mean of the field everywhere. "
    "*Straight*: the shortest clear way from rest to rest, as an autopilot flies it, at the ground "
    "speed of least energy per metre in the mean wind; it waits at the goal for the shortest time "
    f"with which {LEAST_HELD} of the {FLIGHTS} flights arrive. "
    f"Each is flown in the field {FLIGHTS} times under the same adaptive controller, in turbulence "
    "that its plan has not seen and that is the same for all three. *Energy*: the median of these "
    "flights. *Held*: how many arrive and keep all limits, and the limit that the others break "
    "most often. *Price*: what the margins of the plan with the field cost beside a plan without "
    "them. Plans have the accuracy `quick`, 0.1 % of energy. Savings are those of the flights of "
    "the plan with the field, wind by wind, the median over the winds; they are stated where at "
    f"least {LEAST_HELD} of the {FLIGHTS} flights of both ways hold."
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


@dataclass(frozen=True, kw_only=True)
class Flown:
    """How a mission was flown; energies in J: of the plan, without its margins, and of each flight.

    `predicted` is the risk that the plan states, and `broken` the limit that its flights break most
    often.
    """

    direction_deg: int
    way: str
    processor_s: float
    planned_J: float = nan
    paper_J: float = nan
    predicted: float = nan
    energies_J: tuple[float, ...] = ()
    held: int = 0
    broken: str = ""
    detail: str = ""

    @property
    def median(self):
        """Median energy of the flights; nan without flights."""
        return float(np.median(self.energies_J)) if self.energies_J else nan


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


def gusty(told):
    """Return a mission with light turbulence and the risk that plans are asked to keep."""
    wind = {"turbulence": Turbulence(intensity=Intensity.LIGHT)}
    return told.model_copy(
        update={
            "wind": told.wind.model_copy(update=wind),
            "mission": told.mission.model_copy(update={"risk": RISK}),
        }
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
    mean = load_scenario(written).wind.model_copy(update={"turbulence": told.wind.turbulence})
    return told.model_copy(update={"wind": mean})


def cheapest_speed(told, planner):
    """Return the ground speed of least energy per metre from start to goal in the mean wind."""
    way = np.subtract(told.mission.goal.position, told.mission.start.position)[:2]
    ground = SPEEDS_M_PER_S[:, None] * way / np.linalg.norm(way)
    airspeeds = np.linalg.norm(ground - mean_wind(told), axis=1)
    power = steady_power(planner.steady_flight(told))
    return float(SPEEDS_M_PER_S[np.argmin(power(airspeeds) / SPEEDS_M_PER_S)])


def fly(direction_deg, way, planner):
    """Plan a mission in one of the ways and fly it in the field, in many winds."""
    told, began, planned = gusty(street(direction_deg)), process_time(), {}
    often = {"planner": planner, "flights": FLIGHTS, "seed": FLOWN_SEED}
    try:
        if way == "straight":
            settings = told.baseline.cruise_settings(cheapest_speed(told, planner))
            flown = fly_cruise_often(told, settings, arriving=LEAST_HELD / FLIGHTS, **often)
        else:
            plan = plan_at_risk(told if way == "field" else in_mean_wind(told), planner)
            if plan.risk is None:
                return _lost(direction_deg, way, f"{plan.status}: {plan.message}", began)
            planned = {
                "planned_J": plan.energy,
                "paper_J": plan.risk.paper_energy_J,
                "predicted": plan.risk.predicted,
            }
            mission = plan.mission_flown.model_copy(update={"wind": told.wind})
            flown = fly_plan_often(mission, plan.trajectories, **often)
    except PyomoQuadError as error:
        return _lost(direction_deg, way, str(error), began)
    return Flown(
        direction_deg=direction_deg,
        way=way,
        processor_s=process_time() - began,
        energies_J=tuple(np.round(flown.of_flights("energy_J"), 2).tolist()),
        held=flown.succeeded.count,
        broken=next(iter(flown.broken), ""),
        **planned,
    )


def _lost(direction_deg, way, detail, began):
    spent = process_time() - began
    return Flown(direction_deg=direction_deg, way=way, detail=detail, processor_s=spent)


def finished(results=RESULTS):
    """Return the flights that a results file holds."""
    if not results.exists():
        return []
    lines = [json.loads(line) for line in results.read_text(encoding="utf-8").splitlines()]
    return [Flown(**line | {"energies_J": tuple(line["energies_J"])}) for line in lines]


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


def rows_of(flights):
    """Yield a row for each direction: energies, flights that held, and what the field saves."""
    by_key = {(flown.direction_deg, flown.way): flown for flown in flights}
    for direction in sorted({flown.direction_deg for flown in flights}):
        ways = [by_key.get((direction, way)) for way in WAYS]
        field = ways[0]
        has_plan = field is not None and not np.isnan(field.planned_J)
        yield [
            direction,
            f"{field.planned_J:.0f}" if has_plan else "-",
            f"{100.0 * (field.planned_J / field.paper_J - 1.0):.2f}" if has_plan else "-",
            *("-" if w is None or np.isnan(w.median) else f"{w.median:.0f}" for w in ways),
            *("-" if w is None else _ending(w) for w in ways),
            *(_saving(field, other) for other in ways[1:]),
        ]


def _ending(flown):
    if not flown.energies_J:
        return flown.detail
    return f"{flown.held}" + (f", {flown.broken}" if flown.broken else "")


def _saving(field, other):
    """Return the saving of the plan with the field over another way: the median over the winds."""
    if field is None or other is None or min(field.held, other.held) < LEAST_HELD:
        return "-"
    mine, theirs = np.array(field.energies_J), np.array(other.energies_J)
    return f"{100.0 * np.median(1.0 - mine / theirs):.1f}"


def draw(flights, folder=FOLDER):
    """Draw the energies over the direction of the undisturbed wind."""
    figure, axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    for way, marker in zip(WAYS, "os^", strict=True):
        told = sorted((f.direction_deg, f.median / 1e3) for f in flights if f.way == way)
        axes.plot(*zip(*told, strict=True), marker, label=way, fillstyle="none")
    axes.set(
        xlabel="Wind toward, from x counter-clockwise (deg)", ylabel="Median energy flown (kJ)"
    )
    axes.set(xlim=(-10, 350), xticks=range(0, 360, 40))
    figure.legend(loc="outside upper center", ncols=len(WAYS), frameon=False)
    figure.savefig(folder / FIGURE, metadata={"Date": None})
    plt.close(figure)


def measure(arguments):
    """Return tables of the directions flown and of the effort."""
    on_one_core()
    fly_all(arguments.minutes)
    flights = finished()
    draw(flights)
    header = ["wind toward deg", "plan J", "price %"]
    header += [f"{way} J" for way in WAYS] + [f"held, {way}" for way in WAYS]
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
