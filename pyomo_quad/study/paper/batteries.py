"""What the paper's cell and the vehicle's real pack hold and deliver."""

from dataclasses import dataclass
from itertools import product

from pyomo_quad.flight import Planner
from pyomo_quad.flight.steady import battery_shortfalls
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
    planner = Planner()
    return tuple(
        _facts(planner, model, name, cells) for model, (name, cells) in product(models, _PACKS)
    )


def _facts(planner: Planner, model: PowerModel, name: str, cells: dict[str, int]) -> PackFacts:
    scenario = paper_scenario(Experiment.CALM, {"power.model": model, "battery.use": name} | cells)
    steady = planner.steady_flight(scenario)
    at_hover = steady.hover
    return PackFacts(
        battery=name,
        cells_series=scenario.battery.cells_series,
        cells_parallel=scenario.battery.cells_parallel,
        power_model=model,
        stored_energy_J=steady.stored_energy(_DEEPEST_DISCHARGE, _SAMPLES),
        hover_power_W=at_hover.power_W,
        greatest_power_W=at_hover.greatest_battery_power_W,
        hover_energy_J=at_hover.power_W * scenario.mission.duration,
        shortfalls=battery_shortfalls(scenario, steady),
    )
