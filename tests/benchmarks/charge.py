"""Least charge against least energy on ten random missions, brisk ones, where power swings.

python -m tests.benchmarks charge
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from pyomo_quad.flight import Planner
from pyomo_quad.scenario import scenario_from_mapping
from pyomo_quad.study.aims import charge_drawn
from tests.benchmarks.report import Table

TITLE = "Least charge against least energy"
ABOUT = (
    "Ten random missions of one seed, each planned twice: for the least energy and, with "
    '`mission.aim = "charge"`, for the least charge drawn from the pack, its own loss included. '
    "Goals lie 5 to 40 m away; every third mission chooses its time, the others have 1.7 to 2.4 "
    "times that of accelerating at 7 m/s² half the way and braking the other half. The pack "
    "of the Matrice 100 and some of the Phantom 2's are equivalent circuits, with a slow voltage "
    "drop and a temperature. All plans are verified to 1e-6."
)
MISSIONS, SEED = 10, 32
BRISK_M_PER_S2, PACES = 7.0, (1.7, 2.4)
DISTANCES_M = (5.0, 40.0)
VEHICLES = (("dji_phantom_2", "motor"), ("dji_matrice_100", "momentum"))
CIRCUIT = {
    "relaxation": {"resistance": 0.006, "time_constant": 15.0},
    "thermal": {"heat_capacity": 110.0, "cooling": 0.05, "activation_energy": 2.3e4},
}


@dataclass(frozen=True, kw_only=True)
class Pair:
    """A mission and its two plans."""

    name: str
    least_energy: object
    least_charge: object

    @property
    def beyond(self):
        """Share by which the plan of least energy draws more than the least charge."""
        return charge_drawn(self.least_energy) / charge_drawn(self.least_charge) - 1.0


def missions(count=MISSIONS, seed=SEED):
    """Draw missions as the tables of a scenario; equal seeds give equal missions."""
    random = np.random.default_rng(seed)
    for number in range(count):
        vehicle, power = VEHICLES[number % len(VEHICLES)]
        course, climb = random.uniform(0.0, 2 * np.pi), random.uniform(-0.1, 0.2)
        distance = random.uniform(*DISTANCES_M)
        here = np.array([0.0, 0.0, 10.0])
        goal = here + distance * np.array([np.cos(course), np.sin(course), climb])
        lasting = random.uniform(*PACES) * 2 * sqrt(distance / BRISK_M_PER_S2)
        yield {
            "name": f"charge_{number}",
            "vehicle": {"use": vehicle},
            "battery": CIRCUIT if number % 4 == 2 else {},
            "wind": {"use": "calm", "coupling": "drag"},
            "power": {"model": power},
            "mission": {
                "start": {"position": here.tolist()},
                "goal": {"position": goal.round(3).tolist()},
                "duration": "free" if number % 3 == 2 else round(lasting, 3),
            },
            "solver": {"accuracy": "proof", "max_refinements": 12},
        }


def pairs(told=None):
    """Plan missions for either aim."""
    planner = Planner()
    for tables in missions() if told is None else told:
        plans = [
            planner.solve(
                scenario_from_mapping(tables | {"mission": tables["mission"] | {"aim": aim}})
            )
            for aim in ("energy", "charge")
        ]
        yield Pair(name=tables["name"], least_energy=plans[0], least_charge=plans[1])


def _has_circuit(plan):
    return "no" if plan.scenario.battery.relaxation is None else "yes"


def measure(_arguments):
    """Return the table of energies and charges by aim."""
    header = ["mission", "vehicle", "circuit", "time (s)", "least energy (J)", "its charge (mAh)"]
    header += ["energy (J)", "least charge (mAh)", "charge more (%)", "energy less (%)"]
    rows = []
    for told, pair in zip(missions(), pairs(), strict=True):
        energy, charge = pair.least_energy, pair.least_charge
        rows.append(
            [
                *(pair.name, told["vehicle"]["use"], _has_circuit(energy)),
                told["mission"]["duration"],
                *(f"{energy.energy:.2f}", f"{1e3 * charge_drawn(energy):.3f}"),
                *(f"{charge.energy:.2f}", f"{1e3 * charge_drawn(charge):.3f}"),
                f"{100 * pair.beyond:.4f}",
                f"{100 * (1 - energy.energy / charge.energy):.4f}",
            ]
        )
    return [Table(name="charge", title="Either aim", header=header, rows=rows)]
