"""The paper's two experiments as scenarios."""

from collections.abc import Mapping
from enum import IntEnum
from typing import Any

from pyomo_quad.scenario import Scenario, scenario_from_mapping

__all__ = ["PAPER_CELL", "PHANTOM_PACK", "Experiment", "paper_scenario"]

#: Names of the two batteries in the library.
PAPER_CELL = "paper_cell"
PHANTOM_PACK = "phantom_2_pack"

_WIND = {1: "calm", 2: "paper_table_2"}
_NAME = {1: "paper_calm", 2: "paper_wind"}


class Experiment(IntEnum):
    """The tests of the paper's section IV."""

    CALM = 1
    WIND = 2


def paper_scenario(experiment: Experiment, values: Mapping[str, Any] | None = None) -> Scenario:
    """Return an experiment of the paper, with fields changed.

    Parameters
    ----------
    experiment : Experiment
        Calm air or the wind of Table 2.
    values : mapping, optional
        Dotted field -> value.

    Returns
    -------
    Scenario
        From the origin to (6, 7, 8) m in 10 s, hover to hover.
    """
    scenario = scenario_from_mapping(
        {
            "name": _NAME[experiment],
            "vehicle": {"use": "dji_phantom_2"},
            "wind": {"use": _WIND[experiment]},
            "mission": {"duration": 10.0, "goal": {"position": [6.0, 7.0, 8.0], "yaw": 0.0}},
        },
        source=f"experiment {experiment.value} of the paper",
    )
    return scenario.with_values(values) if values else scenario
