"""Table `mission` of a scenario: start, goal, waypoints, and fixed or free duration."""

from collections.abc import Sequence
from enum import StrEnum
from itertools import pairwise
from typing import Annotated, Literal, NamedTuple, Self

from pydantic import Field, model_validator

from pyomo_quad.scenario.earth import Frame, GeodeticOrigin
from pyomo_quad.scenario.fields import (
    Number,
    Part,
    Sound,
    Triple,
    late_quantity,
    not_negative,
    positive,
    quantity,
)
from pyomo_quad.scenario.messages import ScenarioError

_FAR = Sound(-1e5, 1e5, "coordinates lie within 100 km of the origin")
_TURNS = Sound(-1e4, 1e4, "headings are in radians, a turn is 6.283")
_ALOFT = Sound(1e-3, 86_400, "flights last from 1 ms to one day")
_NEAR = "distances within a mission"
FREE = "free"
#: Largest number of waypoints whose best order is searched for.
MOST_ORDERED = 30


class Hover(Part):
    """Position and heading at which the vehicle hovers: start or goal of a mission."""

    position: Triple = quantity(
        "m", "position x, y, z in world axes, z up", example="[6.0, 7.0, 8.0]", sound=_FAR
    )
    yaw: Number = quantity("rad", "yaw angle", 0.0, sound=_TURNS)


class Aim(StrEnum):
    """Quantity that a plan minimises: energy, battery charge or time."""

    ENERGY = "energy"
    CHARGE = "charge"
    TIME = "time"


class Order(StrEnum):
    """Order in which the waypoints are passed: the given order, or the order of least energy."""

    GIVEN = "given"
    BEST = "best"


class Yaw(StrEnum):
    """Constraint on the heading in flight: free to change, or kept constant."""

    FREE = "free"
    KEPT = "kept"


class Waypoint(Part):
    """Place that the flight must pass between start and goal.

    A waypoint may prescribe the largest distance at which it counts as passed, a time of hovering,
    a heading, a largest speed, a time of passing and a release of payload.
    """

    position: Triple = quantity(
        "m", "position x, y, z to pass, in world axes", example="[3.0, 0.0, 2.0]", sound=_FAR
    )
    radius: Number = quantity(
        "m",
        "largest distance at which the waypoint counts as passed",
        0.0,
        sound=not_negative(1e4, _NEAR),
    )
    hold: Number = quantity(
        "s",
        "time of hovering at the waypoint",
        0.0,
        sound=not_negative(_ALOFT.high, _ALOFT.because),
    )
    yaw: Number | None = quantity(
        "rad", "heading at the waypoint, free when absent", None, sound=_TURNS
    )
    speed_max: Number | None = quantity(
        "m/s",
        "largest speed at the waypoint, no limit when absent",
        None,
        sound=positive(1e-3, 1e3, "rotorcraft fly below 340 m/s, the speed of sound"),
    )
    at: Number | None = quantity(
        "s", "time of passing, chosen by the plan when absent", None, gt=0, sound=_ALOFT
    )
    release: Number = quantity(
        "kg",
        "payload released at the waypoint",
        0.0,
        sound=not_negative(1e4, "payloads weigh at most 10 t"),
    )


class ReturnFlight(Part):
    """Steady return flight to a landing place, for which a plan must keep battery charge.

    The table states an extra charge to keep, as a fraction of the charge that the return takes. It
    also states the airspeed, the rate of climb over terrain, and the battery current in level
    flight and in climb.
    """

    margin: Number = quantity(
        "1",
        "extra charge kept for the return, over the charge that the return takes",
        0.2,
        sound=not_negative(10, "a larger reserve is probably a typing error"),
    )
    airspeed: Number | None = quantity(
        "m/s",
        "airspeed of the return; when absent, the airspeed of least charge per metre against the "
        "wind",
        None,
        sound=positive(1e-3, 1e3, "rotorcraft fly below 340 m/s, the speed of sound"),
    )
    current: Number | None = quantity(
        "A",
        "current of the pack during the return; when absent, the current of steady flight at the "
        "airspeed of the return",
        None,
        sound=positive(1e-3, 1e4, "packs give at most 10 kA"),
    )
    climb_rate: Number = quantity(
        "m/s",
        "rate at which the return climbs above the terrain on its way",
        2.0,
        sound=positive(1e-2, 1e2, "rotorcraft climb at less than 100 m/s"),
    )
    climb_current: Number | None = quantity(
        "A",
        "current of the pack in that climb; when absent, that of steady flight",
        None,
        sound=positive(1e-3, 1e4, "packs give at most 10 kA"),
    )


class NamedDuration(NamedTuple):
    """Duration, and the scenario field that prescribes the duration.

    Attributes
    ----------
    field : str
        Dotted path of the scenario field, for use in error messages.
    value : float
        Duration [s].
    """

    field: str
    value: float


class Mission(Part):
    """Start, goal, waypoints and duration of a flight, and the quantity that the plan minimises."""

    frame: Frame = late_quantity(
        "", "directions of the world axes, enu: x east, y north, z up from the origin", Frame.ENU
    )
    origin: GeodeticOrigin | None = late_quantity(
        "",
        "where x = y = z = 0 lies on earth, so that places may be given by latitude and longitude",
        None,
    )
    start: Hover = quantity(
        "",
        "where the flight starts",
        Hover(position=(0.0, 0.0, 0.0)),
        other_names=("from", "begin"),
    )
    goal: Hover = quantity(
        "", "where the flight ends", other_names=("end", "target", "destination")
    )
    duration: Annotated[Number, Field(gt=0)] | Literal["free"] = quantity(
        "s",
        'duration of the flight; "free" lets the plan choose it',
        example="10.0",
        other_names=("time", "t_final", "final_time", "seconds"),
        sound=_ALOFT,
    )
    duration_min: Number | None = late_quantity(
        "s", "least duration if duration is free, no limit when absent", None, gt=0, sound=_ALOFT
    )
    duration_max: Number | None = late_quantity(
        "s",
        "greatest duration if duration is free; when absent the end of wind.file, or no limit",
        None,
        gt=0,
        sound=_ALOFT,
    )
    price_of_time: Number = late_quantity(
        "W",
        "price of a second of a free duration, added to the energy",
        0.0,
        sound=not_negative(1e9, "for the least time regardless of energy, set mission.aim"),
    )
    aim: Aim = late_quantity(
        "",
        "quantity that the plan minimises: energy; charge drawn from the pack, with the pack's "
        "own losses; or time, if the duration is free",
        Aim.ENERGY,
    )

    waypoints: tuple[Waypoint, ...] = late_quantity(
        "", "places to pass between start and goal", (), max_length=64
    )
    order: Order = late_quantity(
        "",
        f"order of the waypoints: as given, or of least energy (at most {MOST_ORDERED} waypoints)",
        Order.GIVEN,
    )
    yaw: Yaw | None = late_quantity(
        "",
        "whether the heading may change in flight; when absent, it is kept under power.model "
        "momentum if start, waypoints and goal have the same heading",
        None,
    )

    rally: tuple[Triple, ...] = late_quantity(
        "m", "alternative places to land, x, y, z, besides the start", (), max_length=16, sound=_FAR
    )
    return_reserve: bool = late_quantity(
        "",
        "whether the charge must suffice at every moment for a return in the wind to the start or "
        "to the nearest place of rally",
        False,
    )
    return_flight: ReturnFlight = late_quantity(
        "", "return flight for which charge is kept", ReturnFlight()
    )
    risk: Number | None = late_quantity(
        "1",
        "largest allowed probability that a flight of the plan under feedback breaks a limit; no "
        "bound when 1; when absent 0.01 where the duration is free, else no bound",
        None,
        gt=0,
        le=1,
    )

    @property
    def positions(self) -> tuple[tuple[float, float, float], ...]:
        """Positions x, y, z of start, waypoints and goal, in order [m]."""
        between = (waypoint.position for waypoint in self.waypoints)
        return (self.start.position, *between, self.goal.position)

    @property
    def named_positions(self) -> tuple[tuple[str, tuple[float, float, float]], ...]:
        """Dotted field path and position x, y, z [m] of start, each waypoint and goal, in order."""
        waypoints = (f"waypoints[{k}]" for k in range(len(self.waypoints)))
        names = ("start", *waypoints, "goal")
        fields = (f"mission.{name}.position" for name in names)
        return tuple(zip(fields, self.positions, strict=True))

    @property
    def released(self) -> float:
        """Total payload released at waypoints [kg]."""
        return sum(waypoint.release for waypoint in self.waypoints)

    @property
    def is_turning(self) -> bool:
        """Whether the prescribed headings of start, waypoints and goal differ."""
        asked = [waypoint.yaw for waypoint in self.waypoints if waypoint.yaw is not None]
        return any(yaw != self.start.yaw for yaw in (*asked, self.goal.yaw))

    def paced(self, legs: Sequence[float]) -> tuple[float, ...]:
        """Return the times at which waypoints are reached and left, and the end time [s].

        `legs` are the desired flight times from start to goal, from one place to the next [s].
        Prescribed times are the start time 0, the times `at` of waypoints, and a fixed end time.
        Legs between two prescribed times are multiplied by one factor, so that both times are met.
        Times of hovering, and legs after the last prescribed time, stay unchanged.
        """
        goal = self.fixed_duration if not self.is_free else None
        given = (*(waypoint.at for waypoint in self.waypoints), goal)
        holds = (*(waypoint.hold for waypoint in self.waypoints), 0.0)
        times: list[float] = []
        first = 0
        while first < len(legs):
            last = next((k for k in range(first, len(legs)) if given[k] is not None), len(legs) - 1)
            began = times[-1] if times else 0.0
            end = given[last]
            waiting, moving = sum(holds[first:last]), sum(legs[first : last + 1])
            pace = 1.0 if end is None else (end - began - waiting) / moving
            for k in range(first, last + 1):
                reached = (times[-1] if times else 0.0) + pace * legs[k]
                times += [reached, reached + holds[k]]
            first = last + 1
        return tuple(times[:-1])

    @property
    def is_free(self) -> bool:
        """Whether the duration is free, so that the optimiser chooses it."""
        return self.duration == FREE

    @property
    def fixed_duration(self) -> float:
        """Prescribed duration [s] of a mission whose duration is not free.

        For a mission with free duration, first call `Scenario.lasting`, which returns a copy of the
        scenario with a fixed duration.

        Raises
        ------
        ScenarioError
            If the duration is free.
        """
        if isinstance(self.duration, str):
            raise ScenarioError(
                'mission.duration = "free"; without a plan it must be a number in s; give one.'
            )
        return self.duration

    @property
    def duration_limits(self) -> tuple[float, float]:
        """Least and greatest allowed duration [s], which are equal if the duration is fixed.

        The limits of a free duration are by default 0.001 s and 86400 s.
        """
        if not isinstance(self.duration, str):
            return self.duration, self.duration
        return (
            _ALOFT.low if self.duration_min is None else self.duration_min,
            _ALOFT.high if self.duration_max is None else self.duration_max,
        )

    @property
    def longest(self) -> NamedDuration:
        """Greatest allowed duration, with the path of the scenario field that sets this limit."""
        field = "duration_max" if self.is_free else "duration"
        return NamedDuration(f"mission.{field}", self.duration_limits[1])

    def chosen(self, duration: float) -> dict[str, float | str | None]:
        """Return the fields of the table `mission` that change if a free duration becomes fixed.

        `duration` is the fixed duration [s]. The limits on the duration and the price of time get
        their defaults. The aim of least time becomes the aim of least energy.
        """
        free = Mission.model_fields
        # These values, and the aim of least time, are allowed only with a free duration.
        by = ("duration_min", "duration_max", "price_of_time")
        aim = Aim.ENERGY if self.aim is Aim.TIME else self.aim
        return {"duration": duration, "aim": aim} | {name: free[name].default for name in by}

    @model_validator(mode="after")
    def _durations_agree(self) -> Self:
        least, greatest = self.duration_limits
        if least > greatest:
            raise ValueError(
                f"duration_min = {least:g} s; must be at most duration_max = {greatest:g} s; "
                "lower the one or raise the other"
            )
        idle = [name for name in ("duration_min", "duration_max") if getattr(self, name)]
        idle += ["price_of_time"] * (self.price_of_time > 0)
        idle += ["aim"] * (self.aim is Aim.TIME)
        if idle and not self.is_free:
            raise ValueError(
                f"{idle[0]} is for a free duration, duration = {self.duration:g} s is fixed; "
                f'leave {idle[0]} out or give duration = "free"'
            )
        is_nowhere = self.goal == self.start and not self.waypoints
        if self.is_free and self.duration_min is None and is_nowhere:
            raise ValueError(
                'duration = "free" with the goal at the start; the shortest flight takes no time: '
                "give duration_min or a fixed duration"
            )
        return self

    @model_validator(mode="after")
    def _yaw_can_be_kept(self) -> Self:
        if self.yaw is Yaw.KEPT and self.is_turning:
            raise ValueError(
                'yaw = "kept" where start, waypoints and goal have several headings; give all of '
                'them the same, or yaw = "free"'
            )
        return self

    @model_validator(mode="after")
    def _waypoints_can_be_passed(self) -> Self:
        earliest, since = 0.0, "the start"
        limit = "duration_max" if self.is_free else "duration"
        latest = self.duration_limits[1]
        for k, waypoint in enumerate(self.waypoints):
            if waypoint.at is not None:
                if waypoint.at <= earliest:
                    raise ValueError(
                        f"waypoints[{k}].at = {waypoint.at:g} s; must be later than {earliest:g} "
                        f"s, the earliest time to leave {since}; give rising times"
                    )
                if waypoint.at >= latest:
                    raise ValueError(
                        f"waypoints[{k}].at = {waypoint.at:g} s; must be below {limit} = "
                        f"{latest:g} s; pass it earlier or fly longer"
                    )
                earliest = waypoint.at
            earliest += waypoint.hold
            since = f"waypoints[{k}]"
        if self.waypoints and earliest >= latest:
            raise ValueError(
                f"waypoints with their hold last until {earliest:g} s or later; must be below "
                f"{limit} = {latest:g} s; hold less or fly longer"
            )
        return self

    @model_validator(mode="after")
    def _places_differ(self) -> Self:
        names = ["start", *(f"waypoints[{k}]" for k in range(len(self.waypoints))), "goal"]
        if self.order is Order.BEST:
            self._can_be_ordered(names[1:-1])
        places = list(zip(names, self.positions, strict=True))
        for (before, here), (after, there) in pairwise(places if self.waypoints else ()):
            if here == there and self.order is Order.GIVEN:
                raise ValueError(
                    f"{after} is at the same place as {before}; leave one out, and give hold to "
                    "stay"
                )
        return self

    def _can_be_ordered(self, names: list[str]) -> None:
        if len(names) > MOST_ORDERED:
            raise ValueError(
                f'order = "best" of {len(names)} waypoints; must be at most {MOST_ORDERED}; '
                "give the order or leave some out"
            )
        seen: dict[tuple[float, float, float], str] = {}
        for name, waypoint in zip(names, self.waypoints, strict=True):
            if waypoint.position in seen:
                raise ValueError(
                    f'{name} is at the same place as {seen[waypoint.position]}; order = "best" '
                    "passes each place once: leave one out"
                )
            if waypoint.at is not None:
                raise ValueError(
                    f'{name}.at = {waypoint.at:g} s fixes a time; order = "best" chooses it: '
                    "leave at out or give the order"
                )
            seen[waypoint.position] = name
