"""The mission: where it starts and ends, and how long it takes or may take."""

from enum import StrEnum
from typing import Annotated, Literal, NamedTuple, Self

from pydantic import Field, model_validator

from pyomo_quad.scenario.fields import Number, Part, Sound, Triple, quantity
from pyomo_quad.scenario.messages import ScenarioError

_FAR = Sound(-1e5, 1e5, "a quadrotor flies tens of kilometres, in metres")
_TURNS = Sound(-1e4, 1e4, "a turn is 6.283 rad")
_ALOFT = Sound(1e-3, 86_400, "no quadrotor stays aloft for more than a day")
FREE = "free"


class Hover(Part):
    """A place and a heading to hover at."""

    position: Triple = quantity(
        "m", "position x, y, z in world axes, z up", example="[6.0, 7.0, 8.0]", sound=_FAR
    )
    yaw: Number = quantity("rad", "yaw angle", 0.0, sound=_TURNS)


class Aim(StrEnum):
    """What a free duration is chosen for."""

    ENERGY = "energy"
    TIME = "time"


class NamedDuration(NamedTuple):
    """A duration, s, and the field of a scenario that holds it."""

    field: str
    value: float


class Mission(Part):
    """Start, goal and duration of the flight."""

    start: Hover = quantity(
        "",
        "where the flight starts",
        Hover(position=(0.0, 0.0, 0.0)),
        other_names=("from", "begin", "origin"),
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
    duration_min: Number | None = quantity(
        "s",
        "least duration where it is free, no limit when absent",
        None,
        gt=0,
        sound=_ALOFT,
        is_late=True,
    )
    duration_max: Number | None = quantity(
        "s",
        "greatest duration where it is free, no limit when absent",
        None,
        gt=0,
        sound=_ALOFT,
        is_late=True,
    )
    price_of_time: Number = quantity(
        "W",
        "what a second of a free duration costs beside the energy",
        0.0,
        ge=0,
        sound=Sound(0, 1e9, "beyond, the least time is meant: mission.aim"),
        is_late=True,
    )
    aim: Aim = quantity(
        "",
        "what a free duration is chosen for: least energy, or least time",
        Aim.ENERGY,
        is_late=True,
    )

    @property
    def is_free(self) -> bool:
        """Whether the plan chooses the duration."""
        return self.duration == FREE

    @property
    def fixed_duration(self) -> float:
        """The duration, s; of a mission whose plan chooses it, `Scenario.lasting` gives one.

        Raises
        ------
        ScenarioError
            If it is free.
        """
        if isinstance(self.duration, str):
            raise ScenarioError(
                'mission.duration = "free"; without a plan it must be a number in s; give one.'
            )
        return self.duration

    @property
    def duration_limits(self) -> tuple[float, float]:
        """Least and greatest duration, s."""
        if not isinstance(self.duration, str):
            return self.duration, self.duration
        return (
            _ALOFT.low if self.duration_min is None else self.duration_min,
            _ALOFT.high if self.duration_max is None else self.duration_max,
        )

    @property
    def longest(self) -> NamedDuration:
        """The greatest duration and the field that says so."""
        field = "duration_max" if self.is_free else "duration"
        return NamedDuration(f"mission.{field}", self.duration_limits[1])

    @staticmethod
    def chosen(duration: float) -> dict[str, float | str | None]:
        """Return the fields that fix a free duration."""
        free = Mission.model_fields
        by = ("duration_min", "duration_max", "price_of_time", "aim")
        return {"duration": duration} | {name: free[name].default for name in by}

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
        if self.is_free and self.duration_min is None and self.goal == self.start:
            raise ValueError(
                'duration = "free" with the goal at the start; the least flight is none at all: '
                "give duration_min or a fixed duration"
            )
        return self
