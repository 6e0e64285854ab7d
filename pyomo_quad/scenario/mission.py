"""The mission: hover at the start, hover at the goal, in a fixed time."""

from pyomo_quad.scenario.fields import Number, Part, Triple, quantity

__all__ = ["Hover", "Mission"]


class Hover(Part):
    """A place and a heading to hover at."""

    position: Triple = quantity("m", "position x, y, z in world axes, z up")
    yaw: Number = quantity("rad", "yaw angle", 0.0)


class Mission(Part):
    """Start, goal and duration of the flight."""

    start: Hover = quantity("", "where the flight starts", Hover(position=(0.0, 0.0, 0.0)))
    goal: Hover = quantity("", "where the flight ends")
    duration: Number = quantity("s", "duration of the flight", gt=0)
