"""Seconds of whole plans: free times, waypoints, orders, zones and long flights.

    python -m tests.benchmarks missions

Each is solved to the scenario's tolerance and verified by flight, in a process of its own.
"""

import sys

from tests.benchmarks.measuring import in_own_process, report, seconds
from tests.benchmarks.report import Table

TITLE = "Plans of missions"
ABOUT = (
    "From a scenario to its verified plan: build, compile, every route and order that is tried, "
    "refinement and flight. Processor seconds of one thread, without imports; beside them what "
    "`pyomo-quad check` estimates."
)

SIX = [(4, 0, 3), (8, 3, 4), (8, 8, 5), (4, 10, 6), (0, 8, 5), (-2, 3, 4)]
EIGHT = [(6, -9, 4), (14, 9, 6), (22, 0, 5), (6, 9, 4), (14, -9, 6), (21, 7, 8), (21, -7, 8)]
EIGHT += [(14, 0, 9)]
BACK = {"mission.duration": "free", "mission.goal.position": [0.0, 0.0, 2.0]}
THERE = {"mission.duration": "free", "mission.goal.position": [20.0, 0.0, 2.0]}
PILLARS = [
    {"name": f"pillar_{k}", "shape": "cylinder", "centre": [4.0 * k, y], "radius": 1.2}
    | {"bottom": 0.0, "top": 9.0}
    for k, y in enumerate((0.3, -0.4, 0.2, -0.1), start=1)
]
FAR = {
    "vehicle": {"use": "dji_matrice_100", "attitude": "euler"},
    "battery": {"use": "matrice_100_pack"},
    "power": {"model": "momentum"},
    "wind.coupling": "drag",
    "mission.goal.position": [1000.0, 0.0, 0.0],
}
MISSIONS = {
    "the paper's first mission, 10 s": ("paper_calm", {}),
    "the same with free duration": ("paper_free", {}),
    "six waypoints, free duration": (
        "paper_free",
        BACK | {"mission.waypoints": [{"position": list(map(float, at))} for at in SIX]},
    ),
    "eight places round a building in the best order, in wind (`inspection.toml`)": (
        "inspection",
        {},
    ),
    "eight places in the best order, 30 s": (
        "paper_free",
        BACK
        | {
            "mission.duration": 30.0,
            "mission.order": "best",
            "mission.waypoints": [{"position": list(map(float, at))} for at in EIGHT],
        },
    ),
    "four keep-outs, all ways round them, free duration": (
        "paper_free",
        THERE | {"airspace.keep_out": PILLARS, "mission.start.position": [0.0, 0.0, 2.0]},
    ),
    "80 m past a church (`parcel.toml`)": ("parcel", {}),
    "there with a parcel and back (`delivery.toml`)": ("delivery", {}),
    "1 km, momentum, 80 s": ("paper_calm", FAR | {"mission.duration": 80.0}),
    "1 km, momentum, free duration": ("paper_calm", FAR | {"mission.duration": "free"}),
}


def solve(label):
    from pyomo_quad.flight import Planner
    from pyomo_quad.model import build_model
    from pyomo_quad.model.screening import inspect_model
    from pyomo_quad.scenario import load_scenario
    from pyomo_quad.study.effort import estimate_effort

    name, changes = MISSIONS[label]
    scenario = load_scenario(f"scenarios/{name}.toml").with_values(changes)
    started = seconds()
    plan = Planner().solve(scenario)
    spent = seconds() - started
    inspection = inspect_model(build_model(scenario))
    unknowns = len(inspection.states) + len(inspection.other_variables)
    report(
        total_s=spent,
        estimated_s=estimate_effort(scenario, unknowns).seconds,
        status=plan.status.value,
        energy_J=plan.energy,
        duration_s=plan.duration_s,
        routes=len(plan.routes),
        meshes=len(plan.history),
    )


def measure(_arguments):
    """Return the table of missions."""
    rows = []
    for label in MISSIONS:
        found = in_own_process(__spec__.name, label)
        rows.append(
            [
                label,
                f"{found['total_s']:.1f}",
                f"{found['estimated_s']:.0f}",
                found["status"],
                found["meshes"],
                found["routes"] or "-",
                f"{found['duration_s']:.3f}",
                f"{found['energy_J']:.2f}",
            ]
        )
    header = [
        "mission",
        "s",
        "estimated s",
        "ended",
        "meshes",
        "ways tried",
        "flight s",
        "energy J",
    ]
    return [Table(name="missions", title="From scenario to plan", header=header, rows=rows)]


if __name__ == "__main__":
    solve(sys.argv[2])
