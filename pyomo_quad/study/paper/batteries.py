"""What the paper's cell and the vehicle's real pack hold and deliver."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from pyomo_quad.model import battery_shortfalls
from pyomo_quad.model.evaluation import convert, number
from pyomo_quad.model.hover import SteadyFlight
from pyomo_quad.scenario import PowerModel
from pyomo_quad.study.paper.missions import PAPER_CELL, PHANTOM_PACK, Experiment, paper_scenario

__all__ = ["PackFacts", "pack_facts"]

_DEEPEST_DISCHARGE = 0.99
_SAMPLES = 400
# The cell as printed, cells in series as the library puts them, and the vehicle's pack.
_PACKS: tuple[tuple[str, dict[str, int]], ...] = (
    (PAPER_CELL, {"battery.cells_series": 1, "battery.cells_parallel": 1}),
    (PAPER_CELL, {}),
    (PHANTOM_PACK, {}),
)


@dataclass(frozen=True, kw_only=True)
class PackFacts:
    """A pack, and the hover that it is asked for.

    Attributes
    ----------
    stored_energy_J : float
        Down to one hundredth of the charge, without load.
    shortfalls : tuple of str
        What the pack lacks for hovering through the mission, one line each.
    """

    battery: str
    cells_series: int
    cells_parallel: int
    power_model: PowerModel
    stored_energy_J: float
    hover_power_W: float
    greatest_power_W: float
    hover_energy_J: float
    shortfalls: tuple[str, ...]


def pack_facts() -> tuple[PackFacts, ...]:
    """Return the packs under the motor's power and under f_r.

    Returns
    -------
    tuple of PackFacts
        By power model and pack.
    """
    models = (PowerModel.MOTOR, PowerModel.EFFICIENCY)
    return tuple(_facts(model, name, cells) for model, (name, cells) in product(models, _PACKS))


def _facts(model: PowerModel, name: str, cells: dict[str, int]) -> PackFacts:
    scenario = paper_scenario(Experiment.CALM, {"power.model": model, "battery.use": name} | cells)
    steady = SteadyFlight(scenario)
    at_hover = steady.hover()
    return PackFacts(
        battery=name,
        cells_series=scenario.battery.cells_series,
        cells_parallel=scenario.battery.cells_parallel,
        power_model=model,
        stored_energy_J=_stored_energy(steady),
        hover_power_W=at_hover.power_W,
        greatest_power_W=at_hover.greatest_battery_power_W,
        hover_energy_J=at_hover.power_W * scenario.mission.duration,
        shortfalls=battery_shortfalls(scenario),
    )


def _stored_energy(steady: SteadyFlight) -> float:
    battery, start = steady.model.battery, steady.model.time.first()
    capacity = number(battery.pack_capacity)
    drawn = np.linspace(0.0, _DEEPEST_DISCHARGE * capacity, _SAMPLES)
    voltage = []
    for charge in drawn:
        battery.charge_drawn[start].set_value(charge)
        voltage.append(number(battery.open_circuit_voltage[start]))
    watt_hours = float(np.trapezoid(voltage, drawn))
    return convert(watt_hours, "watt_hour", "joule")
