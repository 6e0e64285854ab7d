"""Margins of a plan: amounts by which limits are tightened, to let a controller correct errors.

A margin applies to one field of the scenario, such as "airspace.floor", and has the unit of this
field. The fields are parameters of the compiled problem. The problem can therefore be solved with
other margins without compiling it again.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pyomo_quad.collocation.limits import LimitValues
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.mission import Waypoint

# Limit of the declared model, without its index -> the scenario fields that set its upper and its
# lower bound. Moments and rotor accelerations need no margin: the controller never commands more
# than the limit.
FIELDS: Mapping[str, tuple[str, str]] = {
    "limits.roll_limit": ("limits.roll_max", "limits.roll_max"),
    "limits.pitch_limit": ("limits.pitch_max", "limits.pitch_max"),
    "limits.rotor_speed_limit": ("limits.rotor_speed_max", ""),
    "limits.thrust_limit": ("limits.thrust_max", ""),
    "limits.speed_limit": ("limits.speed_max", ""),
    "limits.state_of_charge_limit": ("", "limits.state_of_charge_min"),
    "limits.battery_current_limit": ("limits.battery_current_max", ""),
    "limits.battery_voltage_limit": ("", "limits.battery_voltage_min"),
    "airspace.floor_limit": ("", "airspace.floor"),
    "airspace.ceiling_limit": ("airspace.ceiling", ""),
    "airspace.keep_out": ("", "airspace.clearance"),
}
# Fields whose value a margin increases; a margin on any other field decreases its value.
_RAISED = {
    "limits.state_of_charge_min",
    "limits.battery_voltage_min",
    "airspace.floor",
    "airspace.clearance",
}
#: Margin in time on a hover at a waypoint [s]: the plan starts the hover earlier by this time.
HOLD = "mission.hold"
#: Margins on a waypoint's radius [m] and on the speed at a waypoint [m/s].
RADIUS, SPEED = "mission.radius", "mission.speed_max"
#: Margin on the duration [s]: increase of the least duration of a plan with free duration.
DURATION = "mission.duration_min"
#: Fields of the limits on rotor speed and thrust. The controller keeps its commands within these
#: limits, so that no flight under feedback breaks them. Margins on them serve only to leave a
#: reserve. They are hard limits in re-planning, which uses the reserve.
KEPT_BY_CONTROLLER = ("limits.rotor_speed_max", "limits.thrust_max")
#: Fields that limit thrust and tilt; margins on them leave the controller a reserve to follow the
#: plan.
AUTHORITY = (*KEPT_BY_CONTROLLER, "limits.roll_max", "limits.pitch_max")
# Largest margin as a fraction of the range from hover to the limit: with more, a plan could hardly
# leave its start.
_MOST_OF_AUTHORITY = 0.8
# Distance between a place of the mission and a wall that a margin leaves [m].
_LEFT_OF_ROOM = 0.01
# Fraction of the largest speed at a waypoint that a margin leaves.
_LEFT_OF_SPEED = 0.1


#: Warning on a plan without margins.
PAPER_PLAN = (
    "No margins: the plan may fly exactly at its limits, and gusts or a wrong wind forecast would "
    "break them; mission.risk asks for a plan with margins."
)


@dataclass(frozen=True, kw_only=True)
class RiskTaken:
    """Record of the risk for which a plan was made: margins, prediction and test flights.

    The risk is the probability that a flight in turbulence breaks any limit. Test flights are
    simulations in turbulence. `risk.plan_at_risk` searches for the margins. It takes faster gains
    of the controller if no margins suffice with the default gains.

    Attributes
    ----------
    asked : float
        Allowed risk.
    predicted : float
        Risk predicted by a linear model; 1 if `flown` is 0, because the search ended early.
    failed, flown : int
        Number of test flights of this plan that broke a limit, and number of all its test flights.
        The plan's margins were computed before these flights, from a linear model and from test
        flights of earlier plans.
    is_satisfied : bool
        Whether the fraction of failed test flights is at most the allowed risk.
    margins : mapping
        Scenario field -> amount by which its limit was tightened, in the unit of the field.
    paper_energy_J : float
        Energy of the plan without margins, a plan on paper only [J].
    limiting : tuple of str
        Limits that flights break most, in words, the most frequent first.
    least : float
        Estimated lower bound on the risk of any plan: fraction of simulated hovers at the goal that
        end too far away or too fast. Zero if it was not computed.
    advice : str
        Possible remedies if the risk cannot be reached.
    stopped : str
        Reason why the search for margins ended early; empty if it was completed.
    gains : mapping
        Field of ``baseline.gains`` -> value, if the plan is for faster gains than the default.
        Otherwise empty.
    """

    asked: float
    predicted: float
    failed: int
    flown: int
    is_satisfied: bool
    margins: Mapping[str, float] = field(default_factory=dict)
    paper_energy_J: float
    limiting: tuple[str, ...] = ()
    least: float = 0.0
    advice: str = ""
    stopped: str = ""
    gains: Mapping[str, float] = field(default_factory=dict)

    def price(self, energy: float) -> tuple[float, float]:
        """Return the energy that the margins cost, in J and in % of the plan without margins.

        Margins are the amounts by which limits were tightened for the plan. `energy` is the energy
        of the plan with margins [J].
        """
        more = energy - self.paper_energy_J
        return more, 100.0 * more / self.paper_energy_J

    def words(self, energy: float) -> str:
        """Return a sentence on the risk, the test flights and the energy that the margins cost.

        `energy` is the energy of the plan with margins [J].
        """
        joules, percent = self.price(energy)
        price = f"the margins cost {joules:.3g} J ({percent:.2g} %)"
        seen = (
            f"{self.failed} of {self.flown} test flights, which planning did not use, broke a limit"
        )
        if self.gains:
            changed = ", ".join(f"{name} = {value:g}" for name, value in self.gains.items())
            price += (
                "; flights with the default gains of the controller break limits more often, so "
                f"these are for baseline.gains = {{ {changed} }}"
            )
        most = f", most often {self.limiting[0]}" if self.limiting else ""
        if self.is_satisfied:
            return f"Risk at most {self.asked:g}: {seen}; {price}."
        if not self.flown:
            return f"No flight confirms a risk of {self.asked:g}: {self.stopped}; {price}."
        if self.stopped:
            return (
                f"A risk of {self.asked:g} is not reached: {self.stopped}; {seen}{most}; {price}."
            )
        hovering, plan = "", "the plan of least risk"
        if self.least > self.asked:
            hovering = (
                f"gusts carry {100.0 * self.least:.0f} % of vehicles that only hover at the goal "
                "farther off, or faster, than allowed on arrival, whatever the plan; "
            )
            plan = "this plan"
        return (
            f"A risk of {self.asked:g} cannot be reached: {hovering}"
            f"with {plan}, {seen}{most}"
            f"; possible remedies: {self.advice}; {price}."
        )


def tightened(scenario: Scenario, margins: Mapping[str, float]) -> Scenario:
    """Return the scenario with its limits tightened by margins.

    `margins` maps the full name of a scenario field, such as "airspace.floor", to the amount by
    which its limit is tightened, in the unit of the field. A field without a limit (None) stays
    None.
    """
    told = scenario.mission
    mission: dict[str, Any] = {
        "waypoints": tuple(_narrowed(waypoint, margins) for waypoint in told.waypoints)
    }
    if margins.get(DURATION):
        mission["duration_min"] = told.duration_limits[0] + margins[DURATION]
    tables = {"mission": mission}
    for name, margin in margins.items():
        table, _, key = name.partition(".")
        if table == "mission":
            continue
        number = getattr(getattr(scenario, table), key)
        if number is not None and margin:
            side = 1.0 if name in _RAISED else -1.0
            tables.setdefault(table, {})[key] = number + side * margin
    changed = {
        table: getattr(scenario, table).model_copy(update=values)
        for table, values in tables.items()
    }
    return scenario.model_copy(update=changed)


def used_up(planned: LimitValues, flown: LimitValues) -> Iterator[tuple[str, float]]:
    """Yield how much nearer a flight comes to each bound of a limit than its plan.

    Each result has the scenario field of the bound, and the maximum over time of a difference:
    flown - planned for an upper bound, planned - flown for a lower bound.
    """
    fields = FIELDS.get(planned.name.partition("[")[0], ("", ""))
    for side, name in zip((1.0, -1.0), fields, strict=True):
        if name:
            yield name, float((side * (flown.values - planned.values)).max())


def _narrowed(waypoint: Waypoint, margins: Mapping[str, float]) -> Waypoint:
    """Return a waypoint whose limits are tightened by margins.

    Of `margins`, the keys `RADIUS` [m], `SPEED` [m/s] and `HOLD` [s] are used.
    """
    changed: dict[str, float] = {}
    if waypoint.radius:
        least = min(waypoint.radius, _LEFT_OF_ROOM)
        changed["radius"] = max(waypoint.radius - margins.get(RADIUS, 0.0), least)
    if waypoint.speed_max is not None:
        least = _LEFT_OF_SPEED * waypoint.speed_max
        changed["speed_max"] = max(waypoint.speed_max - margins.get(SPEED, 0.0), least)
    # The hover begins earlier and ends at the same time.
    lead = margins.get(HOLD, 0.0)
    if waypoint.hold and lead:
        changed["hold"] = waypoint.hold + lead
        if waypoint.at is not None:
            changed["at"] = waypoint.at - lead
    return waypoint.model_copy(update=changed)


def passing_times(scenario: Scenario, planned: Sequence[float], lead: float) -> tuple[float, ...]:
    """Return the times [s] at which flights that follow a plan must be at the waypoints.

    `planned` has the times [s] at which the plan reaches the waypoints. The plan begins each hover
    earlier than required, by the margin `lead` [s]. The result is therefore `planned`, plus `lead`
    at waypoints with a hover.
    """
    return tuple(
        at + (lead if waypoint.hold else 0.0)
        for waypoint, at in zip(scenario.mission.waypoints, planned, strict=True)
    )


def greatest_margin(scenario: Scenario, name: str) -> float:
    """Return the largest margin on a scenario field that leaves room for the mission.

    A plan may use only the share 1 - `limits.reserve` of rotor speed and thrust. For these two, the
    result is 0.8 (limit - value in hover / (1 - `limits.reserve`)). For other fields of `limits`,
    it is 80 % of the limit. For floor, ceiling and clearance, start, waypoints and goal stay 1 cm
    within the tightened limit.
    """
    # With a larger margin, start, goal or a waypoint would lie outside the tightened limit, or the
    # vehicle could hardly hover. Even with a smaller margin, the mission may be infeasible.
    told, limits, mission = scenario.airspace, scenario.limits, scenario.mission
    if name == "airspace.floor" and told.floor is not None:
        heights = told.height_above_ground(mission.positions)
        return max(float(heights.min()) - told.floor - _LEFT_OF_ROOM, 0.0)
    if name == "airspace.ceiling" and told.ceiling is not None:
        heights = told.height_above_ground(mission.positions, -1)
        return max(told.ceiling - float(heights.max()) - _LEFT_OF_ROOM, 0.0)
    if name == "airspace.clearance":
        rooms = [
            -float(zone.depth(place)) - told.clearance
            for zone in told.keep_out
            for place in mission.positions
        ]
        return max(min(rooms, default=0.0) - _LEFT_OF_ROOM, 0.0)
    table, _, key = name.partition(".")
    number = float(getattr(getattr(scenario, table), key))
    hovering = {
        "limits.rotor_speed_max": scenario.vehicle.hover_speed(scenario.gravity),
        "limits.thrust_max": scenario.vehicle.total_mass * scenario.gravity,
    }
    share = 1.0 - limits.reserve if name in hovering else 1.0
    return max(_MOST_OF_AUTHORITY * (number - hovering.get(name, 0.0) / share), 0.0)
