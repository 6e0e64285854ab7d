"""The flights of a run in the order and style in which every figure and table shows them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import pandas as pd

from pyomo_quad.flight.baselines import baseline_name
from pyomo_quad.report.style import LineStyle, flight_styles
from pyomo_quad.scenario.baseline import Reference
from pyomo_quad.study.comparison import settled_energy

if TYPE_CHECKING:
    from pyomo_quad.flight import Flight, Plan

__all__ = ["FAIR_BASELINE", "StyledFlight", "fair_pair", "plan_flight", "styled_flights"]

FAIR_BASELINE = baseline_name(Reference.QUINTIC)
_FAILED_PLAN = "best iterate"


@dataclass(frozen=True, kw_only=True, eq=False)
class StyledFlight:
    """A flight with the look that it keeps in every figure; its energy is with what it owes."""

    name: str
    frame: pd.DataFrame
    duration_s: float
    energy_J: float
    style: LineStyle


def plan_flight(plan: "Plan") -> "Flight":
    """Return a plan as a flight whose name says when it is none.

    Parameters
    ----------
    plan : Plan
        Of any status.

    Returns
    -------
    Flight
        Named "best iterate" if the solve failed.
    """
    return plan.flight() if plan.verification is not None else plan.flight(_FAILED_PLAN)


def styled_flights(flights: Sequence["Flight"]) -> tuple[StyledFlight, ...]:
    """Give each flight its style.

    Parameters
    ----------
    flights : sequence of Flight
        The run's flights, the optimum first.

    Returns
    -------
    tuple of StyledFlight
        In the same order.
    """
    styles = flight_styles(tuple(flight.name for flight in flights))
    return tuple(
        StyledFlight(
            name=flight.name,
            frame=flight.frame,
            duration_s=flight.duration_s,
            energy_J=settled_energy(flight),
            style=styles[flight.name],
        )
        for flight in flights
    )


def fair_pair(flights: Sequence[StyledFlight]) -> tuple[StyledFlight, ...]:
    """Return the optimum and the baseline that flies the same mission smoothly.

    Parameters
    ----------
    flights : sequence of StyledFlight
        All flights, the optimum first.

    Returns
    -------
    tuple of StyledFlight
        The optimum alone when that baseline was not flown.
    """
    return tuple(
        flight for index, flight in enumerate(flights) if index == 0 or flight.name == FAIR_BASELINE
    )
