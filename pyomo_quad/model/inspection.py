"""What a declared model consists of, and whether its units are consistent."""

from collections.abc import Hashable
from dataclasses import dataclass
from io import StringIO

from pyomo.common.log import LoggingIntercept
from pyomo.core import ConcreteModel, Constraint, Expression, Param, Var
from pyomo.core.base.component import Component, ComponentData
from pyomo.core.base.indexed_component import IndexedComponent
from pyomo.core.base.units_container import InconsistentUnitsError, UnitsError
from pyomo.dae import ContinuousSet, DerivativeVar, Integral


@dataclass(frozen=True, kw_only=True)
class ModelInspection:
    """Counts of scalar functions of time and of equations, and the unit check.

    `degrees_of_freedom` is the number of functions of time that the equations leave free: the
    controls, when the model is complete.
    """

    states: tuple[str, ...]
    other_variables: tuple[str, ...]
    equations: int
    path_limits: int
    boundary_conditions: int
    parameters: int
    unit_errors: tuple[str, ...]

    @property
    def degrees_of_freedom(self) -> int:
        """Functions of time that the equations leave free."""
        # Each state has a derivative of its own, which the equations determine as well.
        return len(self.states) + len(self.other_variables) - self.equations

    @property
    def is_unit_consistent(self) -> bool:
        """Whether every declared relation has the same unit on both sides."""
        return not self.unit_errors


def inspect_model(model: ConcreteModel) -> ModelInspection:
    """Count what a continuous model declares and check its units.

    Parameters
    ----------
    model : ConcreteModel
        With one ContinuousSet, not discretised.

    Returns
    -------
    ModelInspection
        Counts at one time inside the flight.
    """
    time = next(model.component_objects(ContinuousSet, descend_into=True))
    instant = sorted(time)[len(time) // 2]
    derivatives = list(model.component_objects(DerivativeVar, descend_into=True))
    differentiated = {derivative.get_state_var().name for derivative in derivatives}
    # A DerivativeVar answers to its own type, so only states and algebraic variables come.
    variables = [d for v in _over_time(model, Var, time) for d in _instances(v, instant)]
    is_state = {d.name: d.parent_component().name in differentiated for d in variables}
    path = [d for c in _over_time(model, Constraint, time) for d in _instances(c, instant)]
    whole = list(_over_time(model, Constraint, time))
    return ModelInspection(
        states=tuple(_without_time(d) for d in variables if is_state[d.name]),
        other_variables=tuple(_without_time(d) for d in variables if not is_state[d.name]),
        equations=sum(d.equality for d in path),
        path_limits=sum(not d.equality for d in path),
        boundary_conditions=sum(
            sum(row.active for row in c.values())
            for c in model.component_objects(Constraint, active=True, descend_into=True)
            if not any(c is other for other in whole)
        ),
        parameters=sum(
            len(p)
            for p in model.component_objects(Param, descend_into=True)
            if not _is_over(p, time)
        ),
        unit_errors=unit_errors(model),
    )


def unit_errors(model: ConcreteModel) -> tuple[str, ...]:
    """Check the units of every declared relation, expression and objective.

    Parameters
    ----------
    model : ConcreteModel
        Continuous: units cannot be checked after discretisation.

    Returns
    -------
    tuple of str
        One line for each inconsistent component, empty when all agree.
    """
    kinds = (Constraint, Expression)
    from pyomo.util.check_units import assert_units_consistent  # noqa: PLC0415  has all of GDP

    found = []
    for component in model.component_objects(kinds, active=True, descend_into=True):
        if isinstance(component, Integral):
            continue  # a sum over a set without unit: its integrand is checked by itself
        try:
            # Pyomo logs the whole expression besides raising; the name and the units suffice.
            with LoggingIntercept(StringIO(), "pyomo"):
                assert_units_consistent(component)
        except (InconsistentUnitsError, UnitsError) as error:
            units = str(error).rsplit(": ", maxsplit=1)[-1]
            found.append(f"{component.name}: {units}")
    return tuple(found)


def _is_over(component: Component, time: ContinuousSet) -> bool:
    return component.is_indexed() and any(s is time for s in component.index_set().subsets())


def _over_time(model: ConcreteModel, kind: type, time: ContinuousSet) -> list[IndexedComponent]:
    components = model.component_objects(kind, active=True, descend_into=True)
    return [c for c in components if _is_over(c, time)]


def _instances(component: IndexedComponent, instant: float) -> list[ComponentData]:
    return [d for index, d in component.items() if instant in _as_tuple(index)[-1:]]


def _as_tuple(index: Hashable) -> tuple[Hashable, ...]:
    return index if isinstance(index, tuple) else (index,)


def _without_time(data: ComponentData) -> str:
    rest = _as_tuple(data.index())[:-1]
    name = data.parent_component().name
    return f"{name}[{','.join(map(str, rest))}]" if rest else name
