"""Campaign: missions repeated on one or more charges of a battery.

On one charge, each flight starts with the state of charge, relaxation voltage and temperature that
the battery has at the end of the flight before it. The battery neither rests between flights nor
ages.

The flights on one charge end when the next flight has no plan. It would, for example, leave less
charge than the reserve, or the voltage would fall below its limit. The battery is then recharged,
and all charges begin in the same state.
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
# Samples of a plan from which its lowest voltage is taken.
_SAMPLES = 400
#: Largest number of flights on one charge: a mission that uses less charge is not meant seriously.
MOST_FLIGHTS = 1000
_FULL = 100.0

CHARGE_RESERVE = "charge reserve"
"""Ending of a charge on which the next flight would leave less charge than the reserve."""


class CampaignColumn(TableColumn):
    """Columns of the table of a campaign's flights, one row for each flight.

    A campaign is a series of missions repeated on one or more battery charges.
    """

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
    """One flight of a campaign.

    Attributes
    ----------
    charge : int
        Number of the battery charge that the flight uses, from 1.
    number : int
        Number of the flight on this charge, from 1.
    plan : Plan
        Plan of the flight.
    charge_at_start, charge_at_end : float
        State of charge at the start and at the end of the flight [percent].
    lowest_voltage_V : float
        Lowest voltage of the battery during the flight.
    """

    charge: int
    number: int
    plan: Plan
    charge_at_start: float
    charge_at_end: float
    lowest_voltage_V: float


@dataclass(frozen=True, kw_only=True, repr=False)
class Campaign(Summarised):
    """Flights of a campaign, a series of missions repeated on one or more battery charges.

    Attributes
    ----------
    missions : tuple of Scenario
        Missions, flown in this order, again and again.
    charges : int
        Number of battery charges.
    flights : tuple of CampaignFlight
        All flights, in order.
    endings : tuple of str
        Reason in words why the flights on each charge ended: why the next flight had no plan, or
        that the number of flights reached `MOST_FLIGHTS`.
    """

    missions: tuple[Scenario, ...]
    charges: int
    flights: tuple[CampaignFlight, ...]
    endings: tuple[str, ...]

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of flights on each battery charge."""
        numbers = [flight.charge for flight in self.flights]
        return tuple(numbers.count(charge) for charge in range(1, self.charges + 1))

    @property
    def name(self) -> str:
        """Names of the missions, joined by "+"."""
        return "+".join(mission.name for mission in self.missions)

    @property
    def summary(self) -> dict[str, str]:
        """Summary of the campaign, as a mapping from the name of a result to its value as text."""
        plans = [flight.plan for flight in self.flights]
        return {
            "missions": self.name,
            "flights": ", ".join(map(str, self.counts)),
            "ended by": "; ".join(self.endings),
            "time": f"{sum(plan.duration_s for plan in plans):.6g} s",
            "energy": f"{sum(plan.energy for plan in plans):.2f} J",
        }

    def table(self) -> "pd.DataFrame":
        """Return the flights as a table: one row per flight, columns `CampaignColumn`."""
        return CampaignColumn.of_objects(self.flights)


def fly_campaign(
    missions: Sequence[Scenario], planners: Sequence[Planner], *, charges: int = 1
) -> Campaign:
    """Plan missions in turn, again and again, until the battery allows no further flight.

    `planners` has one planner for each mission. ScenarioError is raised if the missions have
    different batteries, or if a mission has a user's own model (scenario field `model`). Such a
    model may lack the state of charge.
    """
    _refuse_other_packs(missions)
    turns = cycle(range(len(missions)))
    turn, known = next(turns), dict[int, Plan]()
    flights: list[CampaignFlight] = []
    endings: list[str] = []
    for charge in range(1, charges + 1):
        # A recharged battery has the initial state of charge of the first mission. It has rested:
        # relaxation voltage and temperature start as in the scenario. The first flight is the
        # mission that had no plan on the charge before.
        left = {"battery.initial_state_of_charge": missions[0].battery.initial_state_of_charge}
        for number in range(1, MOST_FLIGHTS + 1):
            present = missions[turn].with_values(left)
            plan = _planned(present, known.get(turn), planners[turn])
            if isinstance(plan, str):
                endings.append(plan)
                break
            known[turn], turn = plan, next(turns)
            flights.append(_flight(charge, number, plan))
            left = {"battery.initial_state_of_charge": flights[-1].charge_at_end}
            left |= fields_after(present, _ended(plan))
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


def _planned(present: Scenario, last: Plan | None, planner: Planner) -> Plan | str:
    """Return the plan of a campaign's next flight, or the reason in words if there is none.

    `present` has the present state of the battery. `last` is the mission's previous plan.
    """
    if last is not None:
        before = last.scenario.battery.initial_state_of_charge
        used = before - _flight(1, 1, last).charge_at_end
        if present.battery.initial_state_of_charge - used < _FULL * present.limits.least_charge:
            return CHARGE_RESERVE
    # The previous plan of the mission is the initial guess.
    plan = planner.solve(present, warm_start=last)
    if not plan.is_flyable:
        return _obstacle(present, last, planner) or plan.message
    if _flight(1, 1, plan).charge_at_end < _FULL * present.limits.least_charge:
        return CHARGE_RESERVE
    return plan


def _ended(plan: Plan) -> dict[str, float]:
    """Return the values of all states at the end of a plan, by state name.

    The states include those of the battery.
    """
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


def _obstacle(present: Scenario, last: Plan | None, planner: Planner) -> str:
    """Return the limits that a mission's previous plan would break on the remaining charge.

    The result is text, empty if no limit is broken or `last` is None.
    """
    return "" if last is None else ", ".join(_broken(present, last, planner))


def _broken(present: Scenario, last: Plan, planner: Planner) -> Iterator[str]:
    again = present.lasting(last.duration_s, last.passing_times_s)
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
