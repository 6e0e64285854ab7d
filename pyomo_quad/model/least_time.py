"""The same mission with time itself as the objective."""

from collections.abc import Iterable

from pyomo.environ import ConcreteModel, Objective, Var, units

__all__ = ["ask_for_least_time"]


def ask_for_least_time(m: ConcreteModel, bounds: Iterable[float], guess: float) -> Var:
    """Replace the objective of a model by the flight's duration.

    Parameters
    ----------
    m : ConcreteModel
        A mission's model, not yet discretised.
    bounds : pair of float
        Least and greatest duration looked at [s].
    guess : float
        Where the search starts [s].

    Returns
    -------
    Var
        The duration, to be given to the engine as the end of the horizon.
    """
    for objective in m.component_objects(Objective, active=True, descend_into=True):
        objective.deactivate()
    m.duration = Var(bounds=tuple(bounds), initialize=guess, units=units.s, doc="duration [s]")
    m.least_time = Objective(expr=m.duration)
    return m.duration
