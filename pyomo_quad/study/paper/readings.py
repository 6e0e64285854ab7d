"""Two readings of the efficiency function f_r: regularised, and literally as eq. (8) has it."""

from enum import StrEnum
from typing import TYPE_CHECKING, Any

from pyomo_quad.flight import Planner
from pyomo_quad.model import build_model
from pyomo_quad.scenario import PowerModel, Scenario

if TYPE_CHECKING:
    from pyomo.environ import ConcreteModel

__all__ = ["Reading", "literal_model", "model_without_battery"]

# So far below every torque [N m] and every value of f_r that the rounded floor changes nothing.
_NO_FLOOR = -1e3


class Reading(StrEnum):
    """How f_r is read where it is small or negative."""

    REGULARISED = "regularised"
    LITERAL = "literal"

    def values(self) -> dict[str, Any]:
        """Return the fields of a scenario that choose this reading.

        Returns
        -------
        dict
            Dotted field -> value.
        """
        return {
            "power.model": PowerModel.EFFICIENCY,
            "power.regeneration": self is Reading.LITERAL,
        }

    def planner(self) -> Planner:
        """Return a planner whose model reads f_r in this way.

        Returns
        -------
        Planner
            Nothing is built yet.
        """
        return Planner(literal_model if self is Reading.LITERAL else model_without_battery)


def model_without_battery(scenario: Scenario) -> "ConcreteModel":
    """Declare a mission without its battery, for which some powers of f_r have no current.

    Parameters
    ----------
    scenario : Scenario
        Without limits of the battery.

    Returns
    -------
    ConcreteModel
        The declared model, less one block that nothing else depends on.
    """
    m = build_model(scenario)
    m.del_component(m.battery)
    return m


def literal_model(scenario: Scenario) -> "ConcreteModel":
    """Declare a mission whose f_r is read everywhere as the polynomial stands.

    Parameters
    ----------
    scenario : Scenario
        With `Reading.LITERAL.values`.

    Returns
    -------
    ConcreteModel
        The declared model with both floors of f_r taken out, and without its battery.
    """
    m = model_without_battery(scenario)
    m.power.torque_floor.set_value(_NO_FLOOR)
    m.power.efficiency_floor.set_value(_NO_FLOOR)
    return m
