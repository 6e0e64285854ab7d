"""summary.json of one flight."""

from collections.abc import Mapping
from typing import Any

from pyomo_quad.flight.flight import Flight
from pyomo_quad.scenario import Scenario

__all__ = ["flight_summary"]


def flight_summary(
    scenario: Scenario,
    flight: Flight,
    *,
    hover_energy_J: float,
    arrived: bool,
    wall_s: Mapping[str, float],
) -> dict[str, Any]:
    """Summarise a flight.

    Parameters
    ----------
    scenario : Scenario
        The mission flown.
    flight : Flight
        Controlled or not.
    hover_energy_J : float
        Energy of hovering for the same time.
    arrived : bool
        Whether it ends at the goal.
    wall_s : mapping
        Seconds of each phase.

    Returns
    -------
    dict
        Only what JSON can hold.
    """
    return {
        "scenario": scenario.name,
        "flight": flight.name,
        "verified": flight.is_verified,
        "arrived": arrived,
        "energy_J": flight.energy_J,
        "hover_energy_J": hover_energy_J,
        "terminal_miss_m": flight.terminal_miss_m,
        "terminal_miss": dict(flight.terminal_miss),
        "max_violation": flight.max_violation,
        "worst_constraint": flight.worst_constraint,
        "broken_limits": list(flight.broken_limits),
        "wall_s": {**wall_s, "fly": flight.wall_s},
        "scenario_resolved": scenario.model_dump(mode="json"),
    }
