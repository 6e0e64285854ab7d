"""The mission: hover at the start, hover at the goal, in a fixed time."""

from pyomo_quad.scenario.fields import Number, Part, Sound, Triple, quantity

_FAR = Sound(-1e5, 1e5, "a quadrotor flies tens of kilometres, in metres")
_TURNS = Sound(-1e4, 1e4, "a turn is 6.283 rad")

__all__ = ["Hover", "Mission"]


class Hover(Part):
    """A place and a heading to hover at."""

    position: Triple = quantity(
        "m", "position x, y, z in world axes, z up", example="[6.0, 7.0, 8.0]", sound=_FAR
    )
    yaw: Number = quantity("rad", "yaw angle", 0.0, sound=_TURNS)


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
    duration: Number = quantity(
        "s",
        "duration of the flight",
        gt=0,
        example="10.0",
        other_names=("time", "t_final", "final_time", "seconds"),
        sound=Sound(1e-3, 86_400, "no quadrotor stays aloft for more than a day"),
    )
