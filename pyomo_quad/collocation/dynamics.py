"""Equations of a Pyomo model as an explicit right-hand side dx/dt = f(t, x, u), for simulation.

The same equations also give the values of model components along a given trajectory.

The compiled function has four inputs: states, controls, static variables (variables without time)
and data. The data are the time-dependent inputs, then the constant parameters. The time-dependent
inputs are the fraction s of the horizon, then quantities such as the wind; see `Dynamics.moment`.
They do not contain the controls.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import casadi
import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_bipartite_matching

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.limits import LimitValues, Violation
from pyomo_quad.collocation.program.compiled import MappedFunction, stacked
from pyomo_quad.collocation.reading.schedules import BESIDE, Steps
from pyomo_quad.collocation.reading.writer import symbol_names

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import ArrayLike

    from pyomo_quad.collocation.formulation import Formulation
    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.reading.symbols import Slot
    from pyomo_quad.collocation.reading.values import Instance


# Residual at which Newton's method stops.
_NEWTON_TOLERANCE = 1e-13
# Number of Newton steps where it is fixed, starting from zero. The first step may overshoot by a
# factor of 2^12, as for the induced velocity of a hovering rotor; later steps halve the overshoot.
_NEWTON_STEPS = 20
# Compiled right-hand sides and their Jacobians, by problem, class and name of the function. They
# are kept because they are the same for all parameter values, and compiling one takes 20 to 30 ms.
_COMPILED: WeakKeyDictionary[Formulation, dict[tuple[type, str], Any]] = WeakKeyDictionary()
_RIGHT_HAND_SIDE, _SLOPES = "right_hand_side", "slopes"


@dataclass(frozen=True, kw_only=True)
class Instants:
    """States and controls at n times, with rates and algebraic variables.

    Attributes
    ----------
    inputs : list of ndarray, each with n rows
        Five arrays: rates (derivatives of the states with respect to the fraction of the horizon);
        states; algebraic variables, including controls; variables without time; and data (fraction
        of the horizon and parameters).
    read : callable
        ``(keys, *inputs)`` -> values of components of the model, shape (n, n_keys). For the keys,
        see `Instants.table`.
    numbers : callable
        (data, new values of constant parameters by full name) -> copy of the data with these
        values. The data are the last array of `inputs`.
    """

    inputs: list[FloatArray]
    read: Callable[..., FloatArray]
    numbers: Callable[[FloatArray, Mapping[str, ArrayLike]], FloatArray]

    def table(
        self,
        keys: tuple[tuple[str, Any], ...],
        changed: Mapping[str, ArrayLike] | None = None,
    ) -> FloatArray:
        """Evaluate components of the model at the n times.

        Parameters
        ----------
        keys : tuple of (str, index)
            For each component: its full name, and its index without the time (i for ``x[i, t]``,
            None for ``x[t]``).
        changed : mapping, optional
            New values of constant parameters by full name. The rates and the algebraic variables in
            `inputs` keep their values, and must be independent of these parameters.

        Returns
        -------
        ndarray, shape (n, n_keys)
        """
        *held, data = self.inputs
        return self.read(keys, *held, self.numbers(data, changed or {}))


class Dynamics:
    """Explicit right-hand side dx/dt = f(t, x, u) of a compiled problem, for given parameters.

    The model has two kinds of algebraic variables. Some are determined by equations, and are
    computed from these equations. All others are the controls u.

    Attributes
    ----------
    state_names : tuple of str
        States of the nonlinear program, then output states (states on which nothing depends).
    control_names : tuple of str
        Algebraic variables that no equation determines. A simulation requires their values.

    Raises
    ------
    TranscriptionError
        If the number of equations differs from the number of rates and determined variables.
    """

    def __init__(self, formulation: Formulation, instance: Instance, statics: FloatArray) -> None:
        self._formulation = formulation
        self._instance = instance
        self._statics = np.asarray(statics, dtype=float)
        declared = formulation.compiled.declared
        states = (*declared.states, *declared.outputs)
        self.controls, self._determined = split_algebraics(formulation)
        self.state_names = tuple(s.name for s in states)
        self.control_names = tuple(s.name for s in self.controls)
        self.timeline = formulation.timeline(self._statics, instance)
        self.start = float(self.timeline.times[0])
        kept = _COMPILED.setdefault(formulation, {})
        key = type(self), _RIGHT_HAND_SIDE
        if key not in kept:
            kept[key] = self._compile(states)
        self._right_hand_side = kept[key]
        self._at_one = MappedFunction(self._right_hand_side, 1)
        self._signals = formulation.values.signals(instance)
        n_signals = len(declared.signals) + len(declared.scheduled)
        self._data = np.concatenate([np.zeros(1 + n_signals), instance.parameters])

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arguments of the constructor instead of CasADi objects."""
        return type(self), (self._formulation, self._instance, self._statics)

    def _compile(self, states: tuple[Slot, ...]) -> Any:
        """Return the right-hand side as a CasADi function with two outputs.

        Output 1: dx/ds, then the determined algebraic variables. Output 2: the objective's
        integrand per unit of s, then dt/ds. Here s is the fraction of the horizon.
        """
        declared = self._formulation.compiled.declared
        equations = [e for e in declared.equations if e.is_equality]
        rows = casadi.vertcat(*[e.expression for e in (*equations, *declared.output_equations)])
        unknowns = casadi.vertcat(*[s.rate for s in states], *[s.symbol for s in self._determined])
        if rows.shape[0] != unknowns.shape[0]:
            raise TranscriptionError(
                f"dynamics: {rows.shape[0]} equations determine {unknowns.shape[0]} slopes and "
                "algebraic variables; a simulation needs as many equations as unknowns."
            )
        inputs = [
            stacked([s.symbol for s in states]),
            stacked([s.symbol for s in self.controls]),
            stacked([s.symbol for s in declared.statics]),
            casadi.vertcat(*declared.path_data),
        ]
        rest = casadi.vertcat(_objective_density(self._formulation), declared.clock.span)
        if symbol_names(casadi.jacobian(rows, unknowns)) & symbol_names(unknowns):
            return self._implicit_side(_Core.of(rows, unknowns, inputs, rest), inputs)
        solved = _solved_for(rows, unknowns)
        outputs = casadi.substitute([unknowns, rest], [unknowns], [solved])
        return casadi.Function(_RIGHT_HAND_SIDE, inputs, [casadi.densify(o) for o in outputs])

    def _implicit_side(self, core: _Core, inputs: list[Any]) -> Any:
        """Return the right-hand side as a CasADi function that solves `core` by Newton's method.

        `core` are the implicit equations. `inputs` are the four columns of symbols of states,
        controls, static variables and data.
        """
        newton = casadi.rootfinder("slopes", "newton", core.residual, {"abstol": _NEWTON_TOLERANCE})
        symbols = [casadi.MX.sym(f"i{k}", i.shape[0]) for k, i in enumerate(inputs)]
        stacked = casadi.vertcat(*symbols)
        found = newton(casadi.MX.zeros(core.inner.shape[0]), stacked)
        return casadi.Function(_RIGHT_HAND_SIDE, symbols, list(core.known(found, stacked)))

    def without_iterations(self) -> Dynamics:
        """Return a right-hand side that solves implicit equations by exactly 20 Newton steps.

        An equation is implicit if rates (derivatives of the states) or algebraic variables enter it
        nonlinearly. Without implicit equations, the result is this object itself.
        """
        # The 20 steps are faster than an iteration until convergence.
        return self if self._right_hand_side.is_a("SXFunction") else self._written_out

    @cached_property
    def _written_out(self) -> Dynamics:
        return _WithoutIterations(self._formulation, self._instance, self._statics)

    def control_limits(self, breach: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return constant lower and upper limits of the controls.

        Parameters
        ----------
        breach : float, default 0
            Allowed violation: both limits are widened by breach * max(1, abs(limit)).

        Returns
        -------
        ndarray, ndarray
            Lower and upper limits, shape (n_controls,) each. A limit that does not exist or that
            varies with time is infinite here.
        """
        names = [s.name for s in self._formulation.compiled.declared.algebraics]
        chosen = [names.index(name) for name in self.control_names]
        lower, upper = control_limits(self._formulation, self._instance, breach)
        return lower[chosen], upper[chosen]

    def just_after(self, t: float) -> float:
        """Return a time just after t, to evaluate parameters after a jump at t.

        At t itself, the equations take the parameters' values before the jump. If no parameter ever
        jumps, the result is t.

        Parameters
        ----------
        t : float
            Physical time.

        Returns
        -------
        float
        """
        return t + 2.0 * BESIDE * float(self.timeline.spans.max()) if self._instance.jumps else t

    def steps_between(self, start: float, end: float) -> list[float]:
        """Return the jump times of parameters that are given as `Steps` (piecewise constant).

        Parameters
        ----------
        start, end : float
            Physical times; the jumps between them are returned.

        Returns
        -------
        list of float
            In rising order.
        """
        given = [v for v in self._instance.overrides.values() if isinstance(v, Steps)]
        return sorted({edge for steps in given for edge in steps.edges(start, end)})

    @property
    def signal_names(self) -> tuple[str, ...]:
        """Full names of the time-dependent parameters, in the order used by the method `moment`."""
        return tuple(slot.name for slot in self._formulation.compiled.declared.signals)

    def moment(self, t: float) -> list[float]:
        """Return the time-dependent inputs of the compiled equations at a time.

        Parameters
        ----------
        t : float
            Physical time.

        Returns
        -------
        list of float
            The fraction of the horizon, then the time-dependent parameters, then the quantities of
            `Declarations.scheduled`. These are data of rules that branch on time, and factors of
            the horizon's phases.
        """
        fraction = self.timeline.fraction_at(float(t))
        return [fraction, *self._signals(fraction)]

    def moments(self, t: FloatArray) -> FloatArray:
        """Return the time-dependent inputs of the compiled equations at n times, a row for each.

        `t` are the physical times, shape (n,). The method `moment` describes the inputs.
        """
        fractions = np.asarray(self.timeline.fraction(t))
        if len(self._data) == 1 + len(self._instance.parameters):
            return fractions[:, None]
        return np.array([[f, *self._signals(f)] for f in fractions.tolist()])

    def symbol(self, name: str, size: int) -> Any:
        """Return a column of CasADi symbols as arguments for the method `written`.

        The type of the symbols is `casadi.MX` if the right-hand side calls CasADi's Newton
        iteration, otherwise `casadi.SX`.

        Parameters
        ----------
        name : str
            Name that CasADi prints for the symbols.
        size : int
            Number of symbols.
        """
        is_explicit = self._right_hand_side.is_a("SXFunction")
        return (casadi.SX if is_explicit else casadi.MX).sym(name, size)

    def parameter_column(self, changed: Mapping[str, Any]) -> Any:
        """Return the constant parameters as a CasADi column, some replaced by symbols.

        Parameters
        ----------
        changed : mapping
            Full name of a constant parameter -> symbol that replaces its value. Names of anything
            else are ignored.
        """
        pairs = zip(self.parameter_names, self._instance.parameters.tolist(), strict=True)
        return casadi.vertcat(*(changed.get(name, value) for name, value in pairs))

    def moment_column(self, moment: Any, changed: Mapping[str, Any]) -> Any:
        """Return a column of symbols for the time-dependent inputs, with some of them replaced.

        The time-dependent inputs are those of the compiled equations, without the controls.

        Parameters
        ----------
        moment : casadi.SX or casadi.MX
            Column of symbols for the time-dependent inputs at one time, in the order of the list
            that `Dynamics.moment` returns.
        changed : mapping
            Full name of a time-dependent parameter -> its new symbol. Names of anything else are
            ignored.
        """
        own = casadi.vertsplit(moment)
        for k, name in enumerate(self.signal_names, start=1):
            own[k] = changed.get(name, own[k])
        return casadi.vertcat(*own)

    def written(self, moment: Any, x: Any, u: Any, parameters: Any = None) -> tuple[Any, Any]:
        """Return dx/dt and the objective's integrand as CasADi expressions.

        Parameters
        ----------
        moment, x, u : casadi.SX or casadi.MX
            Columns of symbols: `moment` are the time-dependent inputs of the equations, in the
            order of the method `moment`; `x` are the states; and `u` are the controls.
        parameters : column, optional
            Column of all constant parameters, as numbers or symbols, from the method
            `parameter_column`. By default, the values of the parameters are used.

        Returns
        -------
        expression, expression
            Column of dx/dt, and the integrand, both per unit of physical time.
        """
        numbers = self._instance.parameters if parameters is None else parameters
        data = casadi.vertcat(moment, numbers)
        unknowns, rest = self._right_hand_side(x, u, self._statics, data)
        return unknowns[: x.shape[0]] / rest[1], rest[0] / rest[1]

    def expressions(
        self, keys: tuple[tuple[str, Any], ...], t: float, values: Mapping[str, Any]
    ) -> list[Any]:
        """Return components of the model at one time as CasADi expressions.

        Parameters
        ----------
        keys : tuple of (str, index)
            For each component: its full name, and its index without the time (i for ``x[i, t]``,
            None for ``x[t]``). The name of an equation over time gives its residual.
        t : float
            Physical time at which time-dependent parameters are evaluated.
        values : mapping
            States and algebraic variables by full name, as symbols or numbers. States and algebraic
            variables without an entry, and all rates (derivatives of the states), are zero.

        Returns
        -------
        list of casadi.SX
            One expression for each of `keys`.
        """
        declared, evaluator = self._formulation.compiled.declared, self._formulation.evaluator
        columns = [
            casadi.SX.zeros(evaluator.inputs[0].shape[0]),
            stacked([casadi.SX(values.get(name, 0.0)) for name in self.state_names]),
            stacked([casadi.SX(values.get(s.name, 0.0)) for s in declared.algebraics]),
            casadi.SX(casadi.DM(self._statics)),
            casadi.SX(casadi.DM(np.concatenate([self.moment(t), self._instance.parameters]))),
        ]
        equations = {e.name: e.expression for e in declared.equations}
        written = casadi.vertcat(
            *[equations[n] if n in equations else evaluator.expression(n, k) for n, k in keys]
        )
        found = casadi.substitute(
            written, casadi.vertcat(*evaluator.inputs), casadi.vertcat(*columns)
        )
        return casadi.vertsplit(found)

    def _row(self, t: float) -> FloatArray:
        """Return the data of the compiled right-hand side at the physical time `t`.

        The array has the time-dependent inputs, then the constant parameters. The next call
        overwrites it.
        """
        moment = self.moment(t)
        self._data[: len(moment)] = moment
        return self._data

    def _solve(self, t: float, x: FloatArray, u: FloatArray) -> list[FloatArray]:
        """Evaluate the right-hand side at one physical time, for states x and controls u.

        The result is two arrays of one row. The first has the rates dx/ds, then the determined
        algebraic variables. The second has the objective's integrand per unit of s, then dt/ds.
        """
        row = self._row(t)
        return self._at_one(x[None, :], u[None, :], self._statics[None, :], row[None, :])

    def rates(self, t: float, x: FloatArray, u: FloatArray) -> FloatArray:
        """Return the right-hand side dx/dt at a time.

        Parameters
        ----------
        t : float
            Physical time.
        x : ndarray, shape (n_states,)
            States.
        u : ndarray, shape (n_controls,)
            Controls.

        Returns
        -------
        ndarray, shape (n_states,)
        """
        return self.rates_and_integrand(t, x, u)[0]

    def rates_and_integrand(
        self, t: float, x: FloatArray, u: FloatArray
    ) -> tuple[FloatArray, float]:
        """Return the right-hand side dx/dt and the objective's integrand in one evaluation.

        Parameters
        ----------
        t : float
            Physical time.
        x : ndarray, shape (n_states,)
            States.
        u : ndarray, shape (n_controls,)
            Controls.

        Returns
        -------
        ndarray, shape (n_states,)
            dx/dt.
        float
            Integrand per unit of physical time.
        """
        unknowns, ((density, span),) = self._solve(t, x, u)
        return unknowns[0, : x.size] / span, float(density / span)

    @property
    def _slopes(self) -> Any:
        """CasADi function of the objective's integrand and the right-hand side's Jacobians.

        The first output is a column: the integrand per unit of s, then dt/ds. The second and third
        are Jacobians by states and by controls. Their rows are rates dx/ds, then determined
        algebraic variables.
        """
        kept, key = _COMPILED[self._formulation], (type(self), _SLOPES)
        if key not in kept:
            own = self._right_hand_side
            jacobians = [f"jac:{own.name_out(0)}:{name}" for name in own.name_in()[:2]]
            kept[key] = own.factory(_SLOPES, own.name_in(), [own.name_out(1), *jacobians])
        return kept[key]

    def slopes(self, t: float, x: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the Jacobians of the right-hand side dx/dt at a time.

        Parameters
        ----------
        t : float
            Physical time.
        x : ndarray, shape (n_states,)
            States.
        u : ndarray, shape (n_controls,)
            Controls.

        Returns
        -------
        ndarray, shape (n_states, n_states)
            Derivatives with respect to the states.
        ndarray, shape (n_states, n_controls)
            Derivatives with respect to the controls.
        """
        rest, *jacobians = self._slopes(x, u, self._statics, self._row(t))
        span = float(rest[1])
        by_state, by_control = (np.asarray(one.full())[: x.size] / span for one in jacobians)
        return by_state, by_control

    def integrand(self, t: float, x: FloatArray, u: FloatArray) -> float:
        """Return the objective's integrand per unit of physical time.

        Parameters
        ----------
        t : float
            Physical time.
        x : ndarray, shape (n_states,)
            States.
        u : ndarray, shape (n_controls,)
            Controls.
        """
        return self.rates_and_integrand(t, x, u)[1]

    def solved(
        self,
        t: FloatArray,
        states: FloatArray,
        controls: FloatArray,
        numbers: Mapping[str, ArrayLike] | None = None,
    ) -> Instants:
        """Compute rates and algebraic variables for states and controls at n times.

        Rates are the derivatives of the states with respect to the fraction of the horizon.

        Parameters
        ----------
        t : ndarray, shape (n,)
            Physical times.
        states, controls : ndarray, shape (n, n_states) and (n, n_controls)
            States and controls at these times.
        numbers : mapping, optional
            Values of constant parameters by full name, each a number or an array of shape (n,).

        Returns
        -------
        Instants
            The given states and controls, and the computed variables.
        """
        n = len(t)
        # Several flights may share their times; evaluate time-dependent parameters once per time.
        times, which = np.unique(np.asarray(t, dtype=float), return_inverse=True)
        fractions = self.timeline.fraction(times)
        signals = self._formulation.signals(self._instance, fractions)[which]
        parameters = np.tile(self._instance.parameters, (n, 1))
        data = self._with_numbers(np.hstack([signals, parameters]), numbers or {})
        statics = np.broadcast_to(self._statics, (n, self._statics.size))
        mapped = MappedFunction(self._right_hand_side, n)
        unknowns = mapped(states, controls, statics, data)[0]
        algebraics = self._algebraics(unknowns[:, states.shape[1] :], controls)
        inputs = [unknowns[:, : states.shape[1]], states, algebraics, statics, data]
        return Instants(inputs=inputs, read=self._formulation.evaluator, numbers=self._with_numbers)

    def _with_numbers(self, data: FloatArray, numbers: Mapping[str, ArrayLike]) -> FloatArray:
        """Return a copy of the equations' data at n times with new values of constant parameters.

        A new value is a number or an array of shape (n,).
        """
        names = self.parameter_names
        changed = data.copy()
        for name, column in numbers.items():
            # The constant parameters are the last columns.
            changed[:, data.shape[1] - len(names) + names.index(name)] = column
        return changed

    def _algebraics(self, determined: FloatArray, controls: FloatArray) -> FloatArray:
        """Merge controls and determined variables into one array of all algebraic variables.

        The columns are in the order of `Declarations.algebraics`, with one row per time.
        """
        names = [s.name for s in self._determined]
        columns = [
            determined[:, names.index(s.name)]
            if s.name in names
            else controls[:, self.control_names.index(s.name)]
            for s in self._formulation.compiled.declared.algebraics
        ]
        return np.column_stack(columns) if columns else np.zeros((determined.shape[0], 0))

    def evaluate(
        self,
        component: Any,
        t: FloatArray,
        states: FloatArray,
        controls: FloatArray,
        index: Any = None,
    ) -> FloatArray:
        """Return the values of a variable or expression along a simulated trajectory.

        Parameters
        ----------
        component : Var, DerivativeVar, Expression or str
            A component over time of the model, or its full name.
        t : ndarray, shape (n,)
            Physical times.
        states : ndarray, shape (n, n_states)
        controls : ndarray, shape (n, n_controls)
        index : optional
            Index of the component without the time: i for ``x[i, t]``; omitted for ``x[t]``.

        Returns
        -------
        ndarray, shape (n,)
        """
        name = component if isinstance(component, str) else component.name
        return self.table(((name, index),), t, states, controls)[:, 0]

    def table(
        self,
        keys: tuple[tuple[str, Any], ...],
        t: FloatArray,
        states: FloatArray,
        controls: FloatArray,
    ) -> FloatArray:
        """Return the values of several components along a simulated trajectory.

        Parameters
        ----------
        keys : tuple of (str, index)
            For each component: its full name, and its index without the time (i for ``x[i, t]``,
            None for ``x[t]``).
        t : ndarray, shape (n,)
            Physical times.
        states, controls : ndarray, shape (n, n_states) and (n, n_controls)
            States and controls of the trajectory at these times.

        Returns
        -------
        ndarray, shape (n, n_keys)
        """
        return self.solved(t, states, controls).table(keys)

    @property
    def states_used_up(self) -> tuple[str, ...]:
        """Names of the states with a given initial value and a free final value.

        An example is the charge drawn from a battery, which changes even in steady flight.
        """
        declared = self._formulation.compiled.declared
        # A state at the end remains free if only the objective depends on it.
        priced = symbol_names(declared.objective)
        points = [p for p in declared.point_symbols if p.symbol.name() not in priced]
        given = {(p.slot, p.fraction) for p in points} | set(declared.fixed)
        at_start = {name for name, fraction in given if fraction == 0.0}
        at_start |= {slot.name for slot in declared.outputs}
        return tuple(n for n in self.state_names if n in at_start and (n, 1.0) not in given)

    @property
    def tables_read(self) -> tuple[str, ...]:
        """Names of the interpolation tables that the model's equations evaluate at every time.

        Tables that occur only in conditions at single times, such as end conditions, are left out.
        """
        return tuple(use.name for use in self._formulation.compiled.tables.over_time)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Full names of the constant parameters in the equations."""
        return tuple(p.name for p in self._formulation.compiled.declared.parameters)

    def initial_states(self) -> dict[str, float]:
        """Return the value of each state at the start of the horizon, as set in the Pyomo model.

        The keys are full names of states. A state without a value at this time has the value 0.
        """
        declared = self._formulation.compiled.declared
        held = {
            slot.name: dict(self._formulation.values.initial_values(slot))
            for slot in (*declared.states, *declared.outputs)
        }
        return {name: values.get(0.0, 0.0) for name, values in held.items()}

    def has(self, name: str) -> bool:
        """Return whether the model has a component of this name.

        Parameters
        ----------
        name : str
            Full name.
        """
        return self._formulation.source.has(name)

    def unit(self, name: str) -> str:
        """Return the unit of a constraint or variable, "" if it has none.

        Parameters
        ----------
        name : str
            Full name.
        """
        return self._formulation.source.unit(name)

    def violations(
        self, t: FloatArray, states: FloatArray, controls: FloatArray
    ) -> tuple[Violation, ...]:
        """Return the worst violation of each limit along a trajectory.

        The limits are those of `limits_of`. The violation of a satisfied limit is 0. The limit with
        the largest violation relative to max(1, abs(bound)) comes first.

        Parameters
        ----------
        t : ndarray, shape (n,)
            Physical times.
        states, controls : ndarray, shape (n, n_states) and (n, n_controls)
        """
        (found,) = self.violations_of(self.solved(t, states, controls), t)
        return found

    def violations_of(self, instants: Instants, t: FloatArray) -> list[tuple[Violation, ...]]:
        """Return the worst violation of each limit, for several flights sampled at the same times.

        Parameters
        ----------
        instants : Instants
            States, controls, rates and algebraic variables of the flights, from the method
            `solved`. The n times of a flight are followed by the n times of the next flight.
        t : ndarray, shape (n,)
            Physical times, which are the same for all flights.

        Returns
        -------
        list of tuple of Violation
            For each flight, the worst violation of each limit over time. The limit with the
            largest violation relative to max(1, abs(bound)) comes first.
        """
        limits = self.limits_of(instants)
        flights = (slice(k, k + len(t)) for k in range(0, len(instants.inputs[0]), len(t)))
        return [
            tuple(
                sorted(
                    (limit.worst(own, t) for limit in limits),
                    key=lambda v: -v.relative,
                )
            )
            for own in flights
        ]

    def limits_of(self, instants: Instants) -> list[LimitValues]:
        """Return values and bounds of each limited quantity along a flight.

        Limited quantities are the expressions of path inequalities, and all states and algebraic
        variables except output states. A missing bound is infinite. A linear inequality on a single
        variable counts as a bound of this variable: 2 x <= 5 gives the bound 2.5 of x.

        Parameters
        ----------
        instants : Instants
            States, controls, rates and algebraic variables of the flight, from the method `solved`.

        Returns
        -------
        list of LimitValues
        """
        compiled = self._formulation.compiled
        declared, n_states = compiled.declared, len(compiled.declared.states)
        rates, all_states, algebraics, statics, data = instants.inputs
        n = len(data)
        inner = all_states[:, :n_states]
        variables = np.hstack([rates[:, :n_states], inner, algebraics, statics])
        rows = MappedFunction(compiled.path.values, n)(variables, data)[0]
        lower, upper = MappedFunction(compiled.path_bounds, n)(data)
        low, high = MappedFunction(compiled.limits_over_time, n)(data)
        values = np.hstack([inner, algebraics])[:, compiled.limited]
        limits = [
            LimitValues(e.name, rows[:, k], lower[:, k], upper[:, k])
            for k, e in enumerate(declared.equations)
            if not e.is_equality
        ]
        limits += [
            LimitValues(limit.name, values[:, k], low[:, k], high[:, k])
            for k, limit in enumerate(compiled.limits)
        ]
        return limits


def split_algebraics(formulation: Formulation) -> tuple[tuple[Slot, ...], tuple[Slot, ...]]:
    """Split the algebraic variables into controls and variables that equations determine.

    Each equality without time derivatives may determine one algebraic variable. A maximum matching
    of variables and equalities decides which one. The controls are the variables without an
    assigned equality.

    Parameters
    ----------
    formulation : Formulation
        A compiled problem.

    Returns
    -------
    tuple of Slot, tuple of Slot
        Controls, and determined variables, each in the order in which they first appear in the
        constraints.

    Examples
    --------
    The problem of the example of `solve` has the control `u` only:

    >>> controls, determined = split_algebraics(solution.problem)
    >>> [slot.name for slot in controls], determined
    (['u'], ())
    """
    declared = formulation.compiled.declared
    rates = {s.rate.name() for s in declared.states}
    rows = [
        names
        for e in declared.equations
        if e.is_equality and not (names := symbol_names(e.expression)) & rates
    ]
    # Variables that first appear in late constraints are preferred as determined variables.
    slots = list(reversed(declared.algebraics))
    if not rows or not slots:
        return declared.algebraics, ()
    incidence = csr_matrix([[int(s.name in names) for s in slots] for names in rows])
    matched = {int(k) for k in maximum_bipartite_matching(incidence, perm_type="column") if k >= 0}
    determined = {s.name for k, s in enumerate(slots) if k in matched}
    return (
        tuple(s for s in declared.algebraics if s.name not in determined),
        tuple(s for s in declared.algebraics if s.name in determined),
    )


def control_limits(
    formulation: Formulation, instance: Instance, breach: float
) -> tuple[FloatArray, FloatArray]:
    """Return constant lower and upper limits of the controls, shape (n_algebraics,) each.

    Both limits are widened by breach * max(1, abs(limit)). A limit is infinite if it varies with
    time or does not exist, or if equations determine the algebraic variable.
    """
    controls = {slot.name for slot in split_algebraics(formulation)[0]}
    is_control = np.array([s.name in controls for s in formulation.compiled.declared.algebraics])
    lower, upper = formulation.algebraic_limits(instance)
    lower = lower - breach * np.maximum(1.0, np.abs(lower))
    upper = upper + breach * np.maximum(1.0, np.abs(upper))
    return np.where(is_control, lower, -np.inf), np.where(is_control, upper, np.inf)


def _objective_density(formulation: Formulation) -> Any:
    """Return the objective's integrand per unit of the fraction of the horizon, in CasADi.

    If the objective is maximised, its sign is not changed.
    """
    declared = formulation.compiled.declared
    density = casadi.SX(0)
    for k in formulation.compiled.row_integrals:
        integral = declared.integrals[k]
        slope = casadi.jacobian(casadi.SX(declared.objective), integral.symbol)
        density += slope * integral.integrand
    return density


def _solve_linear(matrix: Any, right: Any) -> Any:
    """Solve a linear system of CasADi expressions symbolically."""
    rows, columns = matrix.sparsity().get_triplet()
    n = matrix.shape[0]
    # A matrix with a single nonzero in each row and column needs only divisions.
    if sorted(rows) == list(range(n)) and sorted(columns) == list(range(n)):
        solved = [casadi.SX(0)] * n
        for row, column in zip(rows, columns, strict=True):
            solved[column] = right[row] / matrix[row, column]
        return casadi.vertcat(*solved)
    return casadi.solve(matrix, right)


def _solved_for(rows: Any, unknowns: Any) -> Any:
    """Return the symbolic solution of equations that are linear in the unknowns.

    `rows` is the CasADi column of the equations' residuals.
    """
    offset = casadi.substitute(rows, unknowns, casadi.DM.zeros(unknowns.shape[0]))
    return _solve_linear(casadi.jacobian(rows, unknowns), -offset)


@dataclass(frozen=True, kw_only=True)
class _Core:
    """Implicit equations, split into a nonlinear part for Newton's method and a linear part.

    The unknowns are the rates dx/ds, then the algebraic variables that equations determine.

    Attributes
    ----------
    inner : casadi.SX
        Column of the unknowns of the nonlinear part.
    residual : casadi.Function
        (`inner`, inputs) -> residual of the nonlinear part. The inputs are states, controls, static
        variables and data, as one column.
    known : casadi.Function
        (`inner`, inputs) -> two columns. The first has all unknowns, also those of the linear part.
        The second has the objective's integrand per unit of s, then dt/ds.
    """

    inner: Any
    residual: Any
    known: Any

    @classmethod
    def of(cls, rows: Any, unknowns: Any, inputs: list[Any], rest: Any) -> _Core:
        """Split the equations with residuals `rows`, and solve the linear part symbolically.

        `unknowns` are the rates, then the determined algebraic variables. `inputs` are the columns
        of states, controls, static variables and data. `rest` is the column of the objective's
        integrand per unit of s, and dt/ds. All are CasADi expressions.
        """
        core, others = _nonlinear_core(rows, unknowns)
        parameters = casadi.vertcat(*inputs)
        inner = casadi.vertcat(*[unknowns[k] for k in core[1]])
        residual = casadi.Function(
            "residual", [inner, parameters], [casadi.vertcat(*[rows[k] for k in core[0]])]
        )
        solved, left = unknowns, casadi.vertcat(*[unknowns[k] for k in others[1]])
        if others[0]:
            outer = _solved_for(casadi.vertcat(*[rows[k] for k in others[0]]), left)
            solved = casadi.substitute(unknowns, left, outer)
            rest = casadi.substitute(rest, left, outer)
        outputs = [casadi.densify(solved), casadi.densify(rest)]
        known = casadi.Function("known", [inner, parameters], outputs)
        return cls(inner=inner, residual=residual, known=known)


class _WithoutIterations(Dynamics):
    """Right-hand side that solves implicit equations by 20 Newton steps, written out in CasADi."""

    def _implicit_side(self, core: _Core, inputs: list[Any]) -> Any:
        """Return the right-hand side as a CasADi function with 20 Newton steps written out.

        `core` are the implicit equations. `inputs` are the four columns of symbols of states,
        controls, static variables and data.
        """
        stacked = casadi.vertcat(*inputs)
        residual = core.residual(core.inner, stacked)
        slope = casadi.Function(
            "slope", [core.inner, stacked], [casadi.jacobian(residual, core.inner)]
        )
        found = casadi.SX.zeros(core.inner.shape[0])
        # CasADi's own Newton iteration would cost ten times as much as the evaluation of all other
        # equations.
        for _ in range(_NEWTON_STEPS):
            step = _solve_linear(slope(found, stacked), core.residual(found, stacked))
            found = found - step
        known = list(core.known(found, stacked))
        return casadi.Function(_RIGHT_HAND_SIDE, inputs, known, {"cse": True})


def _nonlinear_core(rows: Any, unknowns: Any) -> tuple[tuple[list[int], list[int]], ...]:
    """Split equations into a nonlinear and a linear part: (equations, unknowns) of each part.

    Both are positions in the columns `rows` (residuals) and `unknowns`. The nonlinear part has the
    unknowns that enter any equation nonlinearly, and the equations without further unknowns.
    """
    everything = list(range(unknowns.shape[0]))
    jacobian = casadi.jacobian(rows, unknowns)
    names = symbol_names(jacobian)
    inner = [k for k in everything if unknowns[k].name() in names]
    held: dict[int, set[int]] = {k: set() for k in everything}
    for row, column in zip(*jacobian.sparsity().get_triplet(), strict=True):
        held[row].add(column)
    own = [k for k in everything if held[k] <= set(inner)]
    # Newton's method needs as many equations as unknowns. Otherwise, the nonlinear part has all.
    if len(own) != len(inner):
        return (everything, everything), ([], [])
    others = [k for k in everything if k not in own], [k for k in everything if k not in inner]
    return (own, inner), others
