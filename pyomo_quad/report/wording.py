"""How numbers and choices are put into words, the same in every document."""

from math import degrees, isfinite

from pyomo_quad.flight import PlanStatus
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.mission import Hover
from pyomo_quad.scenario.power import PowerModel
from pyomo_quad.scenario.wind import WindCoupling

__all__ = [
    "COUPLING_WORDS",
    "NOTHING",
    "POWER_WORDS",
    "STATUS_WORDS",
    "fixed",
    "hover_place",
    "rough",
    "seconds",
    "title_of",
    "yes_no",
]

#: Stands where a table has no number.
NOTHING = "n/a"

POWER_WORDS = {
    PowerModel.MOTOR: "electrical power of the motors, copper loss included",
    PowerModel.EFFICIENCY: "shaft power over the recovered efficiency f_r, eq. (8)",
    PowerModel.SHAFT: "shaft power",
    PowerModel.CONSTANT_EFFICIENCY: "shaft power over a constant efficiency",
    PowerModel.MOTOR_WITH_FRICTION: "electrical power of the motors, with their friction",
}

COUPLING_WORDS = {
    WindCoupling.ACCELERATION: "added to the acceleration as printed in eq. (9), times 1 1/s",
    WindCoupling.DRAG: "through drag on the relative airspeed",
}

STATUS_WORDS = {
    PlanStatus.VERIFIED: "Verified",
    PlanStatus.SOLVED: "Not verified",
    PlanStatus.NOT_CONVERGED: "Failed, not converged",
    PlanStatus.INFEASIBLE: "Failed, infeasible",
    PlanStatus.INTERRUPTED: "Failed, interrupted",
}


def fixed(value: float, digits: int = 2) -> str:
    """Return a number with a fixed count of decimals.

    Parameters
    ----------
    value : float
        Any number.
    digits : int, default 2
        Decimals.

    Returns
    -------
    str
        `NOTHING` for what is not finite; never minus zero.
    """
    if not isfinite(value):
        return NOTHING
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def rough(value: float) -> str:
    """Return a small number with two significant digits.

    Parameters
    ----------
    value : float
        Any number, such as an error.

    Returns
    -------
    str
        `NOTHING` for what is not finite.
    """
    return f"{value:.2g}" if isfinite(value) else NOTHING


def seconds(value: float) -> str:
    """Return a duration with its unit.

    Parameters
    ----------
    value : float
        Seconds.

    Returns
    -------
    str
        Without zeros that say nothing.
    """
    return f"{value:.6g} s"


def yes_no(value: object) -> str:
    """Return a truth value in a word.

    Parameters
    ----------
    value : object
        Taken as a boolean.

    Returns
    -------
    str
        "yes" or "no".
    """
    return "yes" if value else "no"


def hover_place(hover: Hover) -> str:
    """Return a place and a heading.

    Parameters
    ----------
    hover : Hover
        Start or goal.

    Returns
    -------
    str
        In metres and degrees.
    """
    place = ", ".join(f"{axis:.6g}" for axis in hover.position)
    return f"({place}) m, yaw {degrees(hover.yaw):.4g}°"


def title_of(scenario: Scenario) -> str:
    """Return what a report about a scenario is called.

    Parameters
    ----------
    scenario : Scenario
        Any scenario.

    Returns
    -------
    str
        Its title, or its name when it has none.
    """
    return scenario.title or scenario.name
