"""Problems with several horizons: their declarations, their coupling, and the joint program.

Each continuous set is a horizon, with a program for its own constraints. The objective and all
other constraints form the coupling. They contain static variables (without time) in place of a
horizon's integrals and of its values at declared times (members of the set):

- A value of a state and its static variable are one unknown of the joint program.
- A value of an algebraic variable or of a derivative, and an integral, differ from their static
  variable as unknowns. A constraint in the horizon's program makes them equal.

An integral that enters only the objective, with a number as coefficient, has no static variable. It
moves into the objective of its horizon.
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
    """Static variable that stands for a value of one horizon in the coupling of several horizons.

    Attributes
    ----------
    slot : Slot
        The static variable.
    reader : ModelReader
        Reader of the horizon's declarations.
    value : casadi.SX
        Expression of the value, in the symbols of the horizon.
    time : float
        Time of the value, a member of the continuous set.
    state : PointSymbol, optional
        State and its time; None if the value is not a state.
    """

    slot: Slot
    reader: ModelReader
    value: Any
    time: float
    state: PointSymbol | None

    @property
    def condition(self) -> PointCondition:
        """Constraint that makes the static variable equal to the value that it replaces.

        The value is that of a variable of the horizon at one time. The constraint belongs to the
        nonlinear program of the horizon.
        """
        zero, difference = casadi.SX(0), casadi.SX(self.value) - self.slot.symbol
        return PointCondition(name=self.slot.name, expression=difference, lower=zero, upper=zero)


class CouplingWriter(TemplateWriter):
    """Translator from Pyomo to CasADi, for constraints on several horizons and for the objective.

    A value of a horizon's variable at a single time is replaced by a static variable (a variable
    without time) that equals this value.

    Attributes
    ----------
    links : dict
        The static variables as `Link` objects. The key is the name of the replaced Pyomo variable,
        including the time, as in ``x[0]``.
    """

    def __init__(self, readers: list[ModelReader], statics: dict[str, Slot]) -> None:
        self._readers = readers
        self.links: dict[str, Link] = {}
        self._in_objective = False
        times = tuple(reader.copy.time for reader in readers)
        super().__init__(WorkingCopy(model=readers[0].copy.model, others=times), {}, statics)

    def write_objective(self, objective: Any) -> Any:
        """Return the objective as a CasADi expression.

        Write all constraints before the objective. Only the objective may contain values at times
        inside a horizon. After this call, the writer therefore accepts values at these times.
        """
        self._in_objective = True
        return casadi.SX(self.write(objective.expr, objective.name))

    def leaf(self, data: Any) -> Any:
        """Return the symbol for a Pyomo variable or parameter that couples several horizons.

        The value at a single time, such as ``x[1]``, is replaced by a static variable, which is
        stored in `links`.

        Raises
        ------
        TranscriptionError
            If a parameter over time is given at a single time, or a constraint contains a variable
            at an interior time of a horizon.
        """
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
        """Raise an error for a value that must not appear in the coupling of several horizons.

        `data` is a parameter or variable at one time of the reader's horizon. A parameter is
        refused. A variable at a time inside the horizon is refused in constraints.
        """
        declared, name = reader.copy.declared_times, reader.copy.time.name
        is_end = reader.addresses.of(data).time in (declared[0], declared[-1])
        if not data.is_variable_type():
            raise TranscriptionError(
                f"{data.name}: a parameter over {name} at a single time cannot appear in "
                "an equation that couples horizons; use a parameter without time."
            )
        if not is_end and not self._in_objective:
            raise TranscriptionError(
                f"{data.name}: couples horizons at a time inside {name}; must be at one of its "
                f"ends, {declared[0]:g} or {declared[-1]:g}; introduce a static variable "
                "equal to it."
            )

    def named(self, expression: Any) -> Any:
        """Return the symbol that replaces a named Pyomo expression, or None.

        An integral over a horizon is replaced by its symbol. Any other named expression gives None,
        and is translated like an unnamed one.
        """
        component = expression.parent_component()
        if component is not None and component.ctype is PyomoIntegral:
            for reader in self._readers:
                if component.get_continuousset() is reader.copy.time:
                    return reader.writer.named(expression)
        return super().named(expression)


@dataclass(frozen=True, kw_only=True)
class CoupledDeclarations:
    """Declarations of a model with several horizons, separated by horizon.

    Attributes
    ----------
    horizons : dict
        Declarations and reader by the name of the continuous set.
    coupling : Declarations, ModelReader
        Objective and constraints on several horizons or none, with their reader.
    states : dict
        Static variable that equals a state -> (name of the horizon, state with its time).
    links : tuple of str
        Names of the static variables that equal values of algebraic variables or derivatives. The
        constraint that makes them equal has the same name.
    """

    horizons: dict[str, tuple[Declarations, ModelReader]]
    coupling: tuple[Declarations, ModelReader]
    states: dict[str, tuple[str, PointSymbol]]
    links: tuple[str, ...]


def read_horizons(model: Any, times: FreeTimes | None) -> CoupledDeclarations:
    """Read the declarations of a model with several continuous sets.

    `times` are the physical times that the solve determines, as in `JointProblem`.

    Raises
    ------
    TranscriptionError
        If the model has an unsupported or incomplete component; the message names the component.
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
    """Raise an error if an equality joins the end of a horizon to a later start of another one.

    The gap is accepted if one of the two times is free (determined by the solve). `free` maps set
    names to {free time: variable}.
    """
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
    """Split the objective `cost` into integrals over the horizon of `reader`, and the rest.

    An integral belongs to the rest if its factor varies, or if constraints of the coupling contain
    its symbol. `in_conditions` has the names of all symbols in them.
    """
    own = casadi.SX(0)
    for integral in reader.writer.integrals.values():
        slope = casadi.jacobian(cost, integral.symbol)
        # A mutable parameter is a symbol, so that a coefficient that contains one is not constant.
        if slope.is_constant() and integral.symbol.name() not in in_conditions:
            own += slope * integral.symbol
            cost = casadi.substitute(cost, integral.symbol, casadi.SX(0))
    return own, cost


def _integrals_in(reader: ModelReader, names: frozenset[str]) -> list[Slot]:
    """Return static variables that replace integrals over the horizon of `reader`.

    `names` are the names of all symbols in the coupling. Only integrals whose symbol is among them
    are replaced.
    """
    return [
        integral.slot
        for integral in reader.writer.integrals.values()
        if integral.symbol.name() in names
    ]


def _with(declared: Declarations, statics: list[Slot]) -> Declarations:
    """Return a copy of the declarations of a horizon, or of the coupling, with more variables.

    `declared` are the declarations, and `statics` the additional variables, which are static
    (without time).
    """
    return replace(declared, statics=(*declared.statics, *statics))


@dataclass(frozen=True, kw_only=True)
class StateValue:
    """State of one horizon's nonlinear program at a node of its mesh.

    Attributes
    ----------
    program : int
        Position of the horizon's program in the list of the nonlinear programs of all horizons.
    state : str
        Name of the state.
    fraction : float
        Position of the node, as a fraction of the horizon.
    """

    program: int
    state: str
    fraction: float


Part = TypeVar("Part", "Bounds", "Scaling", "IpoptResult")


class Union:
    """Positions of the unknowns and constraints of several programs in their joint program.

    Static variables of the same name share one unknown. The unknowns of the horizons come first.
    Static variables that share no unknown with a state follow.

    Parameters
    ----------
    programs : sequence of Transcription
        Programs of the horizons and of the coupling.
    states : mapping
        Static variable -> state that shares its unknown.

    Attributes
    ----------
    unknowns : int
        Number of unknowns of the joint program.
    statics : dict
        Position of each static variable that shares no unknown with a state.
    places : list of ndarray of int
        Positions of each program's unknowns.
    rows : list of slice
        Positions of each program's constraints.
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
        """Return the unknowns of the joint program from the unknowns of the separate programs.

        `parts` follows the order of the programs. A shared unknown, such as a common static
        variable, takes its value from the first program that contains it.
        """
        whole = np.zeros(self.unknowns)
        for places, part in reversed(list(zip(self.places, parts, strict=True))):
            whole[places] = part
        return whole

    def bounds(self, parts: Sequence[Bounds]) -> Bounds:
        """Return the bounds of the joint program; a shared unknown has the tightest of its bounds.

        Raises
        ------
        TranscriptionError
            If the bounds of a shared static variable contradict each other.
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
        """Return the part of bounds, scaling or Ipopt's result that belongs to one program.

        `whole` belongs to the joint program, and the result has its type. `k` is the number of the
        program, from 0.
        """
        return whole.part(self.places[k], self.rows[k])

    def nominal(self, whole: Bounds, z: FloatArray) -> FloatArray:
        """Return the magnitudes of the joint program's unknowns, shape (n_unknowns,).

        `whole` has the bounds of the joint program, and `z` the values of its unknowns. For the
        magnitudes, see `nominal_magnitudes`.
        """
        return self.joined(
            [
                nominal_magnitudes(program, self.part(whole, k), z[self.places[k]])
                for k, program in enumerate(self.programs)
            ]
        )

    def multipliers(self, parts: Sequence[Multipliers]) -> Multipliers:
        """Return the multipliers of the joint program, given the multipliers of each program.

        `parts` follows the order of the programs. The bounds of a shared unknown have the
        multipliers of the first program that contains the unknown.
        """
        return Multipliers(
            rows=np.concatenate([part.rows for part in parts]),
            lower=self.joined([part.lower for part in parts]),
            upper=self.joined([part.upper for part in parts]),
        )


@dataclass(frozen=True)
class CoupledProgram:
    """Joint nonlinear program of several horizons, in the form that Ipopt requires.

    The objective is the sum of the objectives of the separate programs. The constraints are the
    constraints of all programs, one program after the other.

    Attributes
    ----------
    union : Union
        Positions of each program's unknowns and constraints in the joint program.
    programs : tuple of NonlinearProgram
        Programs of the horizons, then of the coupling. In a solve with damping, the objective of a
        horizon's program includes the penalty of its `Damping`.
    """

    union: Union
    programs: tuple[NonlinearProgram, ...]

    def _parts(self, z: FloatArray) -> list[tuple[NonlinearProgram, FloatArray]]:
        """Return each program together with its own unknowns, taken from the joint unknowns `z`."""
        held = (z[places] for places in self.union.places)
        return list(zip(self.programs, held, strict=True))

    @property
    def n_rows(self) -> int:
        """Number of constraints."""
        return sum(program.n_rows for program in self.programs)

    @property
    def n_points(self) -> int:
        """Number of collocation points on all horizons together."""
        return sum(program.n_points for program in self.programs)

    @property
    def is_negated(self) -> bool:
        """Whether the Pyomo model maximises its objective; Ipopt then minimises the negative."""
        return self.programs[0].is_negated

    def objective(self, z: FloatArray) -> float:
        """Return the objective to minimise at the unknowns `z`."""
        return sum(program.objective(own) for program, own in self._parts(z))

    def gradient(self, z: FloatArray) -> FloatArray:
        """Return the gradient of the objective to minimise at `z`, shape (n_unknowns,)."""
        gradient = np.zeros(self.union.unknowns)
        for places, (program, own) in zip(self.union.places, self._parts(z), strict=True):
            gradient[places] += program.gradient(own)
        return gradient

    def constraints(self, z: FloatArray) -> FloatArray:
        """Return the values of the constraints at the unknowns `z`, shape (n_rows,)."""
        return np.concatenate([program.constraints(own) for program, own in self._parts(z)])

    @cached_property
    def _jacobian(self) -> tuple[Any, Any]:
        """Row and column indices of the nonzeros of the constraints' Jacobian."""
        found = []
        for rows, places, program in zip(
            self.union.rows, self.union.places, self.programs, strict=True
        ):
            own_rows, columns = program.jacobianstructure()
            found.append((own_rows + rows.start, places[columns]))
        every_row, every_column = zip(*found, strict=True)
        return np.concatenate(every_row), np.concatenate(every_column)

    def jacobianstructure(self) -> tuple[Any, Any]:
        """Return row and column indices of the nonzeros of the constraints' Jacobian."""
        return self._jacobian

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return the nonzeros of the constraints' Jacobian at the unknowns `z`.

        Their order is that of `jacobianstructure`.
        """
        return np.concatenate([program.jacobian(own) for program, own in self._parts(z)])

    @cached_property
    def _hessian(self) -> tuple[Any, Any]:
        """Row and column of each nonzero in the lower triangle of the Lagrangian's Hessian."""
        found = []
        for places, program in zip(self.union.places, self.programs, strict=True):
            rows, columns = (places[held] for held in program.hessianstructure())
            # Programs may hold the shared static variables in different orders.
            found.append((np.maximum(rows, columns), np.minimum(rows, columns)))
        every_row, every_column = zip(*found, strict=True)
        return np.concatenate(every_row), np.concatenate(every_column)

    def hessianstructure(self) -> tuple[Any, Any]:
        """Return row and column indices of nonzeros in the lower triangle of the Hessian.

        The Hessian is that of the Lagrangian with respect to the unknowns of the program.
        """
        return self._hessian

    def hessian(self, z: FloatArray, multipliers: FloatArray, factor: float) -> FloatArray:
        """Return the nonzeros of the Hessian of factor * objective + multipliers . constraints.

        The nonzeros are those of the lower triangle at the unknowns `z`, in the order of
        `hessianstructure`. `multipliers` has one value per constraint.
        """
        return np.concatenate(
            [
                program.hessian(own, multipliers[rows], factor)
                for rows, (program, own) in zip(self.union.rows, self._parts(z), strict=True)
            ]
        )
