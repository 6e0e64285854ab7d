"""Problems with several horizons: their declarations, their coupling, and the joint program.

A constraint over a continuous set, or on values of one set alone, belongs to that horizon. All
other constraints and the objective see a horizon through static variables that equal its values at
declared times and its integrals. The program holds each horizon's own unknowns first, then the
shared static variables.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import casadi
import numpy as np
from pyomo.core import Var
from pyomo.dae import Integral as PyomoIntegral

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.program.bounds import crossed, nominal_magnitudes
from pyomo_quad.collocation.program.compiled import stacked
from pyomo_quad.collocation.program.nonlinear import Bounds, Multipliers
from pyomo_quad.collocation.reading.clock import FreeTimes, free_times, index_tuple
from pyomo_quad.collocation.reading.copy import (
    WorkingCopy,
    continuous_sets,
    copies_with_template_times,
)
from pyomo_quad.collocation.reading.model import ModelReader
from pyomo_quad.collocation.reading.objectives import objective_of
from pyomo_quad.collocation.reading.symbols import PointCondition, PointSymbol, Slot
from pyomo_quad.collocation.reading.writer import TemplateWriter, symbol_names

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.program.ipopt import IpoptResult
    from pyomo_quad.collocation.program.nonlinear import NonlinearProgram, Scaling
    from pyomo_quad.collocation.program.transcription import Transcription
    from pyomo_quad.collocation.reading.symbols import Declarations


@dataclass(frozen=True, kw_only=True)
class Link:
    """Static variable that equals a value of one horizon.

    `state` is given if the value is an unknown itself: a state at a node.
    """

    slot: Slot
    reader: ModelReader
    value: Any
    time: float
    state: PointSymbol | None

    @property
    def condition(self) -> PointCondition:
        """The condition on the horizon that the variable equals the value."""
        zero, difference = casadi.SX(0), casadi.SX(self.value) - self.slot.symbol
        return PointCondition(name=self.slot.name, expression=difference, lower=zero, upper=zero)


class CouplingWriter(TemplateWriter):
    """Writer of constraints that couple horizons, with static variables for their values.

    Attributes
    ----------
    links : dict
        These variables, by the name of the value that each one replaces.
    """

    def __init__(self, readers: list[ModelReader], statics: dict[str, Slot]) -> None:
        self._readers = readers
        self.links: dict[str, Link] = {}
        self._in_objective = False
        times = tuple(reader.copy.time for reader in readers)
        super().__init__(WorkingCopy(model=readers[0].copy.model, others=times), {}, statics)

    def write_objective(self, objective: Any) -> Any:
        """Return the objective, in which values at any declared time are allowed."""
        self._in_objective = True
        return casadi.SX(self.write(objective.expr, objective.name))

    def leaf(self, data: Any) -> Any:
        """Return the symbol of a variable or parameter."""
        over = self.copy.other_of(data.parent_component())
        if over is None:
            return super().leaf(data)
        if data.name not in self.links:
            reader = next(r for r in self._readers if r.copy.time is over)
            self._refuse_interior(reader, data)
            name, index = f"{data.name} (coupled)", index_tuple(data.index())
            slot = Slot(
                name=name,
                component=data.parent_component().name,
                index=index,
                symbol=casadi.SX.sym(name),
            )
            address, value = reader.addresses.of(data), reader.writer.leaf(data)
            table, time = reader.symbols, float(address.time or 0.0)
            key = address.name, table.clock.fraction_of(time), False
            is_state = address.name in table.states and data.parent_component().ctype is Var
            self.links[data.name] = Link(
                slot=slot,
                reader=reader,
                value=value,
                time=time,
                state=table.points[key] if is_state else None,
            )
        return self.links[data.name].slot.symbol

    def _refuse_interior(self, reader: ModelReader, data: Any) -> None:
        declared, name = reader.copy.declared_times, reader.copy.time.name
        is_end = reader.addresses.of(data).time in (declared[0], declared[-1])
        if not data.is_variable_type():
            raise TranscriptionError(
                f"{data.name}: a parameter over {name} at a single time cannot stand in what "
                "couples horizons; use a parameter without time."
            )
        if not is_end and not self._in_objective:
            raise TranscriptionError(
                f"{data.name}: couples horizons at a time that is no boundary of {name}, which "
                f"runs from {declared[0]:g} to {declared[-1]:g}; introduce a static variable "
                "equal to it."
            )

    def named(self, expression: Any) -> Any:
        """Return the replacement of a named expression, None to keep its own expression."""
        component = expression.parent_component()
        if component is not None and component.ctype is PyomoIntegral:
            for reader in self._readers:
                if component.get_continuousset() is reader.copy.time:
                    return reader.writer.named(expression)
        return super().named(expression)


@dataclass(frozen=True, kw_only=True)
class CoupledDeclarations:
    """The declarations of a model with several horizons.

    Attributes
    ----------
    horizons : dict
        Declarations and their reader, by the name of the continuous set.
    coupling : Declarations, ModelReader
        The objective, and the conditions on values of several horizons or of none.
    states : dict
        Static variables of the coupling that equal values of states, by name: horizon and value.
    links : tuple of str
        Names of the other static variables that equal values of a horizon; the conditions on the
        horizons that impose the equalities have the same names.
    """

    horizons: dict[str, tuple[Declarations, ModelReader]]
    coupling: tuple[Declarations, ModelReader]
    states: dict[str, tuple[str, PointSymbol]]
    links: tuple[str, ...]


def read_horizons(model: Any, times: FreeTimes | None) -> CoupledDeclarations:
    """Read the declarations of a model with several continuous sets.

    Raises
    ------
    TranscriptionError
        If it declares something unsupported or incomplete; the message names it.
    """
    free = free_times(continuous_sets(model), None, times)
    statics: dict[str, Slot] = {}
    readers = [
        ModelReader(TemplateWriter(copy, free[copy.time.name], statics))
        for copy in copies_with_template_times(model)
    ]
    for reader in readers:
        reader.require_all()
    writer = CouplingWriter(readers, statics)
    coupling = ModelReader(writer)
    _refuse_gaps(coupling.conditions, list(writer.links.values()), free)
    objective = objective_of(coupling.copy)
    cost = casadi.SX(0) if objective is None else writer.write_objective(objective)
    links = list(writer.links.values())
    held = stacked([c.expression for c in coupling.conditions])
    horizons, integrals = {}, []
    states: dict[str, tuple[str, PointSymbol]] = {}
    for reader in readers:
        name, mine = reader.copy.time.name, [k for k in links if k.reader is reader]
        own, cost = _own_cost(reader, cost, symbol_names(held))
        others = [link for link in mine if link.state is None]
        reader.conditions.extend(link.condition for link in others)
        met = _integrals_in(reader, symbol_names(cost) | symbol_names(held))
        declared = reader.declarations(own, objective)
        points = {k.slot.name: k.state for k in mine if k.state is not None}
        new = tuple(p for p in points.values() if p not in declared.point_symbols)
        declared = replace(declared, point_symbols=(*declared.point_symbols, *new))
        horizons[name] = _with(declared, [k.slot for k in others] + met), reader
        integrals.extend(met)
        states |= {static: (name, point) for static, point in points.items()}
    declared = _with(
        coupling.declarations(cost, objective), [link.slot for link in links] + integrals
    )
    return CoupledDeclarations(
        horizons=horizons,
        coupling=(declared, coupling),
        states=states,
        links=tuple(link.slot.name for link in links if link.state is None),
    )


def _refuse_gaps(
    conditions: list[PointCondition], links: list[Link], free: dict[str, dict[float, Any]]
) -> None:
    """Refuse a condition that continues one horizon into another that starts at a later time."""
    for condition in conditions:
        names = symbol_names(condition.expression)
        pair = [link for link in links if link.slot.name in names]
        is_equality = casadi.is_equal(condition.lower, condition.upper)
        if len(pair) != len(names) or len(pair) != 2 or not is_equality:
            continue
        before, after = sorted(pair, key=lambda link: link.time)
        ends = before.reader.copy.declared_times[-1], after.reader.copy.declared_times[0]
        sets = [link.reader.copy.time.name for link in (before, after)]
        is_fixed = all(at not in free[name] for name, at in zip(sets, ends, strict=True))
        if (before.time, after.time) == ends and ends[0] < ends[1] and is_fixed:
            raise TranscriptionError(
                f"{condition.name}: {sets[0]} ends at {ends[0]:g}, but {sets[1]} begins at "
                f"{ends[1]:g}, which leaves a gap; declare one of them to meet the other."
            )


def _own_cost(reader: ModelReader, cost: Any, in_conditions: frozenset[str]) -> tuple[Any, Any]:
    """Split the cost into integrals over this horizon that enter it linearly, and the rest."""
    own = casadi.SX(0)
    for integral in reader.writer.integrals.values():
        slope = casadi.jacobian(cost, integral.symbol)
        if slope.is_constant() and integral.symbol.name() not in in_conditions:
            own += slope * integral.symbol
            cost = casadi.substitute(cost, integral.symbol, casadi.SX(0))
    return own, cost


def _integrals_in(reader: ModelReader, names: frozenset[str]) -> list[Slot]:
    """Return static variables for the integrals that appear in the coupling."""
    return [
        integral.slot
        for integral in reader.writer.integrals.values()
        if integral.symbol.name() in names
    ]


def _with(declared: Declarations, statics: list[Slot]) -> Declarations:
    return replace(declared, statics=(*declared.statics, *statics))


@dataclass(frozen=True, kw_only=True)
class StateValue:
    """A state of one of several programs, at the node at a fraction of its horizon."""

    program: int
    state: str
    fraction: float


Part = TypeVar("Part", "Bounds", "Scaling", "IpoptResult")


class Union:
    """Positions of the unknowns and rows of several programs in the joint program.

    Static variables with the same name share one unknown.

    Parameters
    ----------
    programs : sequence of Transcription
    states : mapping
        Names of static variables that equal values of states, and these values.
    """

    def __init__(self, programs: Sequence[Transcription], states: Mapping[str, StateValue]) -> None:
        self.programs = tuple(programs)
        varying = [p.layout.unknowns - p.layout.n_statics for p in self.programs]
        firsts = np.cumsum([0, *varying]).tolist()
        names = [s.name for p in self.programs for s in p.compiled.declared.statics]
        own = [name for name in dict.fromkeys(names) if name not in states]
        self.statics = {name: k for k, name in enumerate(own, start=firsts[-1])}
        self.unknowns = firsts[-1] + len(own)
        columns = self.statics | {
            name: firsts[at.program]
            + self.programs[at.program].layout.state_column(at.state, at.fraction)
            for name, at in states.items()
        }
        self.places: list[NDArray[np.intp]] = [
            np.array(
                [
                    *range(first, first + count),
                    *(columns[slot.name] for slot in program.compiled.declared.statics),
                ],
                dtype=np.intp,
            )
            for program, first, count in zip(self.programs, firsts, varying, strict=False)
        ]
        counts = [program.n_rows for program in self.programs]
        ends = np.cumsum(counts).tolist()
        self.rows = [slice(end - n, end) for end, n in zip(ends, counts, strict=True)]

    def joined(self, parts: Sequence[FloatArray]) -> FloatArray:
        """Return the unknowns of the union; a shared unknown takes the first program's value."""
        whole = np.zeros(self.unknowns)
        for places, part in reversed(list(zip(self.places, parts, strict=True))):
            whole[places] = part
        return whole

    def bounds(self, parts: Sequence[Bounds]) -> Bounds:
        """Return the intersection of the bounds.

        Raises
        ------
        TranscriptionError
            If the bounds of a shared static variable cross.
        """
        lower, upper = np.full(self.unknowns, -np.inf), np.full(self.unknowns, np.inf)
        for places, part in zip(self.places, parts, strict=True):
            lower[places] = np.maximum(lower[places], part.lower)
            upper[places] = np.minimum(upper[places], part.upper)
        for name, column in self.statics.items():
            if lower[column] > upper[column]:
                raise crossed(name, lower[column], upper[column])
        return Bounds(
            lower=lower,
            upper=upper,
            row_lower=np.concatenate([part.row_lower for part in parts]),
            row_upper=np.concatenate([part.row_upper for part in parts]),
        )

    def part(self, whole: Part, k: int) -> Part:
        """Return one program's part of bounds, scaling or a result of the union."""
        return whole.part(self.places[k], self.rows[k])

    def nominal(self, whole: Bounds, z: FloatArray) -> FloatArray:
        """Return the magnitudes of the unknowns."""
        return self.joined(
            [
                nominal_magnitudes(program, self.part(whole, k), z[self.places[k]])
                for k, program in enumerate(self.programs)
            ]
        )

    def multipliers(self, parts: Sequence[Multipliers]) -> Multipliers:
        """Return the multipliers of the union."""
        return Multipliers(
            rows=np.concatenate([part.rows for part in parts]),
            lower=self.joined([part.lower for part in parts]),
            upper=self.joined([part.upper for part in parts]),
        )


@dataclass(frozen=True)
class CoupledProgram:
    """The sum of the programs of a union, in the form Ipopt asks for.

    `programs` are those of the union, possibly with a penalty added to their objectives.
    """

    union: Union
    programs: tuple[NonlinearProgram, ...]

    def _parts(self, z: FloatArray) -> list[tuple[NonlinearProgram, FloatArray]]:
        held = (z[places] for places in self.union.places)
        return list(zip(self.programs, held, strict=True))

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return sum(program.n_rows for program in self.programs)

    @property
    def n_points(self) -> int:
        """Number of collocation points."""
        return sum(program.n_points for program in self.programs)

    @property
    def is_negated(self) -> bool:
        """Whether the declared objective is maximised."""
        return self.programs[0].is_negated

    def objective(self, z: FloatArray) -> float:
        """Return the objective to minimise."""
        return sum(program.objective(own) for program, own in self._parts(z))

    def gradient(self, z: FloatArray) -> FloatArray:
        """Return the gradient of the objective to minimise."""
        gradient = np.zeros(self.union.unknowns)
        for places, (program, own) in zip(self.union.places, self._parts(z), strict=True):
            gradient[places] += program.gradient(own)
        return gradient

    def constraints(self, z: FloatArray) -> FloatArray:
        """Return the value of every row."""
        return np.concatenate([program.constraints(own) for program, own in self._parts(z)])

    @cached_property
    def _jacobian(self) -> tuple[Any, Any]:
        found = []
        for rows, places, program in zip(
            self.union.rows, self.union.places, self.programs, strict=True
        ):
            own_rows, columns = program.jacobianstructure()
            found.append((own_rows + rows.start, places[columns]))
        every_row, every_column = zip(*found, strict=True)
        return np.concatenate(every_row), np.concatenate(every_column)

    def jacobianstructure(self) -> tuple[Any, Any]:
        """Return rows and columns of the Jacobian's nonzeros."""
        return self._jacobian

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return the Jacobian's nonzeros."""
        return np.concatenate([program.jacobian(own) for program, own in self._parts(z)])

    @cached_property
    def _hessian(self) -> tuple[Any, Any]:
        found = []
        for places, program in zip(self.union.places, self.programs, strict=True):
            rows, columns = (places[held] for held in program.hessianstructure())
            # Programs may hold the shared static variables in different orders.
            found.append((np.maximum(rows, columns), np.minimum(rows, columns)))
        every_row, every_column = zip(*found, strict=True)
        return np.concatenate(every_row), np.concatenate(every_column)

    def hessianstructure(self) -> tuple[Any, Any]:
        """Return rows and columns of the Lagrangian Hessian's lower triangle."""
        return self._hessian

    def hessian(self, z: FloatArray, multipliers: FloatArray, factor: float) -> FloatArray:
        """Return the nonzeros of the Lagrangian's Hessian."""
        return np.concatenate(
            [
                program.hessian(own, multipliers[rows], factor)
                for rows, (program, own) in zip(self.union.rows, self._parts(z), strict=True)
            ]
        )
