"""Campaign: repeated missions on one battery charge until it is at its limit.

Each flight is planned with the state of charge, the slow voltage drop and the temperature at which
the flight before it ended, from the plan that its mission had last.  A charge ends before the first
flight that has no plan: it would leave less charge than the pack must keep, or the voltage would
fall below its limit.  No pack rests between two flights, or ages.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.collocation import EngineError, Summarised
from pyomo_quad.flight import Plan, Planner
from pyomo_quad.flight.baselines import broken_under_control, declared_start, start_state
from pyomo_quad.flight.columns import column_of
from pyomo_quad.flight.verification import BALANCE_TOLERANCE, fly_controls, shares_lacking
from pyomo_quad.model.battery import CHARGE_STATE
from pyomo_quad.model.battery_circuit import CIRCUIT_STATES, fields_after
from pyomo_quad.scenario import Scenario, ScenarioError
from pyomo_quad.study.tables import TableColumn

if TYPE_CHECKING:
    import pandas as pd

_CHARGE, _VOLTAGE = (column_of(f"battery.{name}").name for name in ("state_of_charge", "voltage"))
# Samples of a plan in which its lowest voltage is looked for.
_SAMPLES = 400
#: Flights of a charge after which a campaign ends: a mission that uses so little is no mission.
MOST_FLIGHTS = 1000
_FULL = 100.0

CHARGE_RESERVE = "charge reserve"
"""What ends a charge whose next flight would leave less than the pack must keep."""


class CampaignColumn(TableColumn):
    """Columns of a campaign, one row for each flight, in order."""

    CHARGE = "charge", lambda flight: flight.charge
    FLIGHT = "flight", lambda flight: flight.number
    MISSION = "mission", lambda flight: flight.plan.scenario.name
    DURATION = "duration_s", lambda flight: flight.plan.duration_s
    ENERGY = "energy_J", lambda flight: flight.plan.energy
    CHARGE_AT_START = "charge_at_start_percent", lambda flight: flight.charge_at_start
    CHARGE_AT_END = "charge_at_end_percent", lambda flight: flight.charge_at_end
    LOWEST_VOLTAGE = "lowest_voltage_V", lambda flight: flight.lowest_voltage_V


@dataclass(frozen=True, kw_only=True)
class CampaignFlight:
    """Flight of a campaign: number of charge, number on the charge, and plan."""

    charge: int
    number: int
    plan: Plan
    charge_at_start: float
    """Per cent of the capacity, as below."""
    charge_at_end: float
    lowest_voltage_V: float


@dataclass(frozen=True, kw_only=True, repr=False)
class Campaign(Summarised):
    """Flights of a campaign on one or more battery charges.

    Attributes
    ----------
    missions : tuple of Scenario
        Flown in this order, again and again.
    charges : int
    flights : tuple of CampaignFlight
    endings : tuple of str
        What ended each charge.
    """

    missions: tuple[Scenario, ...]
    charges: int
    flights: tuple[CampaignFlight, ...]
    endings: tuple[str, ...]

    @property
    def counts(self) -> tuple[int, ...]:
        """Flights of each charge."""
        numbers = [flight.charge for flight in self.flights]
        return tuple(numbers.count(charge) for charge in range(1, self.charges + 1))

    @property
    def name(self) -> str:
        """The names of the missions."""
        return "+".join(mission.name for mission in self.missions)

    @property
    def summary(self) -> dict[str, str]:
        """Missions, flights of each charge, what ended them, and their time and energy."""
        plans = [flight.plan for flight in self.flights]
        return {
            "missions": self.name,
            "flights": ", ".join(map(str, self.counts)),
            "ended by": "; ".join(self.endings),
            "time": f"{sum(plan.duration_s for plan in plans):.6g} s",
            "energy": f"{sum(plan.energy for plan in plans):.2f} J",
        }

    def table(self) -> "pd.DataFrame":
        """Return one row per flight, with the columns of `CampaignColumn`."""
        return CampaignColumn.of_objects(self.flights)


def fly_campaign(
    missions: Sequence[Scenario], planners: Sequence[Planner], *, charges: int = 1
) -> Campaign:
    """Plan missions in a row until the pack is at its limit, on so many charges.

    Parameters
    ----------
    missions : sequence of Scenario
        With one and the same battery and vehicle; each charge begins with that of the first.
    planners : sequence of Planner
        One for each mission.

    Raises
    ------
    ScenarioError
        If the missions have different packs, or a model has no battery.
    """
    _refuse_other_packs(missions)
    turns = cycle(range(len(missions)))
    turn, known = next(turns), dict[int, Plan]()
    flights: list[CampaignFlight] = []
    endings: list[str] = []
    for charge in range(1, charges + 1):
        # A pack that was charged has rested: its circuit starts as the scenario says.
        left = {"battery.initial_state_of_charge": missions[0].battery.initial_state_of_charge}
        for number in range(1, MOST_FLIGHTS + 1):
            told = missions[turn].with_values(left)
            plan = _planned(told, known.get(turn), planners[turn])
            if isinstance(plan, str):
                endings.append(plan)
                break
            known[turn], turn = plan, next(turns)
            flights.append(_flight(charge, number, plan))
            left = {"battery.initial_state_of_charge": flights[-1].charge_at_end}
            left |= fields_after(told, _ended(plan))
        else:
            endings.append(f"{MOST_FLIGHTS} flights, after which a campaign is not continued")
    return Campaign(
        missions=tuple(missions), charges=charges, flights=tuple(flights), endings=tuple(endings)
    )


def _refuse_other_packs(missions: Sequence[Scenario]) -> None:
    first = missions[0]
    for mission in missions:
        if mission.model is not None:
            raise ScenarioError(
                f"{mission.name}: model = {mission.model!r}; a campaign reads the charge of the "
                "declared battery; leave model out."
            )
        packs = (one.battery.model_copy(update={"title": ""}) for one in (first, mission))
        if len({pack.model_dump_json() for pack in packs}) > 1:
            raise ScenarioError(
                f"{mission.name}: battery.use = {mission.battery.use!r} differs from the battery "
                f"of {first.name}, {first.battery.use!r}; missions in a row need one pack: give "
                "all the same [battery], or run a campaign for each."
            )


def _planned(told: Scenario, last: Plan | None, planner: Planner) -> Plan | str:
    """Return the plan of a flight, or what keeps the pack from it."""
    if last is not None:
        before = last.scenario.battery.initial_state_of_charge
        used = before - _flight(1, 1, last).charge_at_end
        if told.battery.initial_state_of_charge - used < _FULL * told.limits.least_charge:
            return CHARGE_RESERVE
    plan = planner.solve(told, warm_start=last)
    if not plan.is_flyable:
        return _obstacle(told, last, planner) or plan.message
    if _flight(1, 1, plan).charge_at_end < _FULL * told.limits.least_charge:
        return CHARGE_RESERVE
    return plan


def _ended(plan: Plan) -> dict[str, float]:
    """Return the state of a vehicle at the end of a plan, by state name."""
    held = plan.trajectories
    return dict(zip(held.state_names, held.states[-1].tolist(), strict=True))


def _flight(charge: int, number: int, plan: Plan) -> CampaignFlight:
    columns = plan.columns(np.linspace(*plan.trajectories.horizon, _SAMPLES))
    return CampaignFlight(
        charge=charge,
        number=number,
        plan=plan,
        charge_at_start=float(columns[_CHARGE][0]),
        charge_at_end=float(columns[_CHARGE][-1]),
        lowest_voltage_V=float(columns[_VOLTAGE].min()),
    )


def _obstacle(told: Scenario, last: Plan | None, planner: Planner) -> str:
    """Return the limits that the last plan breaks on the charge that is left; "" if none."""
    return "" if last is None else ", ".join(_broken(told, last, planner))


def _broken(told: Scenario, last: Plan, planner: Planner) -> Iterator[str]:
    again = told.lasting(last.duration_s, last.passing_times_s)
    dynamics, held = planner.dynamics(again), last.trajectories
    start = start_state(again, dynamics, last)
    begun = declared_start(again, dynamics)
    for k, name in enumerate(dynamics.state_names):
        if name in (CHARGE_STATE, *CIRCUIT_STATES):
            start[k] = begun[name]
    try:
        flown = fly_controls(dynamics, held.mesh, held.controls, start, held.horizon)
    except EngineError:
        yield "power of the pack"
        return
    breaches = dynamics.violations(flown.t, flown.states, flown.controls)
    yield from broken_under_control(again, dynamics, flown, breaches)
    if max(shares_lacking(dynamics, flown)) > BALANCE_TOLERANCE:
        yield "power of the pack"
