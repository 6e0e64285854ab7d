"""Any variable or expression over time as a function of a trajectory."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import casadi

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.expressions import symbol_names
from pyomo_quad.collocation.mapped import MappedFunction
from pyomo_quad.collocation.serialisation import Packed, packed

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pyomo_quad.collocation.compiled import CompiledModel
    from pyomo_quad.collocation.nodes import FloatArray
    from pyomo_quad.collocation.template_writer import TemplateWriter

__all__ = ["Evaluator", "index_tuple"]


def index_tuple(index: Any) -> tuple[Any, ...]:
    """Return a component's index without time as a tuple."""
    if index is None:
        return ()
    return index if isinstance(index, tuple) else (index,)


class WrittenComponents:
    """A model's components over time, written before it was pickled; read like a writer.

    Parameters
    ----------
    written : dict
        By name and index beside time the expression, or why it cannot be written.
    """

    def __init__(self, written: dict[tuple[str, tuple[Any, ...]], Any]) -> None:
        self._written = written

    def components_over_time(self) -> Iterator[tuple[str, tuple[Any, ...]]]:
        """Yield name and index of all components."""
        yield from self._written

    def over_time(self, name: str, index: tuple[Any, ...]) -> Any:
        """Return a component's expression, None if there is none of the name."""
        if all(name != known for known, _ in self._written):
            return None
        found = self._written[name, index]
        if isinstance(found, str):
            raise TranscriptionError(found)
        return found


class Evaluator:
    """Writes components of the model as CasADi functions of a point, once each.

    The inputs of a function are the rates, states and algebraic variables (outputs after the
    states of the program), the static variables, and the data: fraction, signals, parameters.
    """

    def __init__(self, inputs: tuple[Any, ...], writer: TemplateWriter | WrittenComponents) -> None:
        self._writer = writer
        self.inputs = inputs
        self._known = symbol_names(casadi.vertcat(*self.inputs))
        self._functions: dict[tuple[tuple[str, Any], ...], Any] = {}

    @classmethod
    def of(cls, compiled: CompiledModel, writer: TemplateWriter) -> Evaluator:
        """Return what evaluates the components of the model that was compiled."""
        d = compiled.declared
        states = (*d.states, *d.outputs)
        inputs = (
            _column([s.rate for s in states]),
            _column([s.symbol for s in states]),
            _column([s.symbol for s in d.algebraics]),
            _column([s.symbol for s in d.statics]),
            casadi.vertcat(*d.path_data),
        )
        return cls(inputs, writer)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the components written, each once."""
        written: dict[tuple[str, tuple[Any, ...]], Any] = {}
        for name, index in self._writer.components_over_time():
            try:
                written[name, index] = self._writer.over_time(name, index)
            except TranscriptionError as error:
                written[name, index] = str(error)
        return _unpacked, (packed((self.inputs, written)),)

    def __deepcopy__(self, memo: dict[int, Any]) -> Evaluator:
        """Return itself: it reads no number of the model."""
        return self

    def expression(self, component: Any, index: Any = None) -> Any:
        """Return a component over time as a CasADi expression of the inputs.

        Raises
        ------
        TranscriptionError
            If the component is not a variable or expression over time of this model.
        """
        name = component if isinstance(component, str) else component.name
        try:
            written = self._writer.over_time(name, index_tuple(index))
        except KeyError:
            raise TranscriptionError(
                f"{name}: has no index {index!r} beside time; give index= one of its set."
            ) from None
        if written is None:
            raise TranscriptionError(
                f"{name}: is not a variable or expression over time of the compiled model."
            )
        unknown = symbol_names(written) - self._known
        if unknown:
            raise TranscriptionError(
                f"{name}: holds {', '.join(sorted(unknown))}, which takes no part in the problem."
            )
        return written

    def function(self, keys: tuple[tuple[str, Any], ...]) -> Any:
        """Return the CasADi function of some (name, index) pairs, compiled when first asked."""
        if keys not in self._functions:
            rows = casadi.vertcat(*[self.expression(name, index) for name, index in keys])
            self._functions[keys] = casadi.Function(
                "components", list(self.inputs), [casadi.densify(rows)]
            )
        return self._functions[keys]

    def __call__(self, keys: tuple[tuple[str, Any], ...], *inputs: FloatArray) -> FloatArray:
        """Evaluate components at n points.

        Parameters
        ----------
        keys : tuple of (str, index)
            Full names and indices beside time (None for none).
        inputs : ndarray, shape (n, k)
            Rates, states, algebraics, statics and data, one row per point.

        Returns
        -------
        ndarray, shape (n, n_keys)
        """
        return MappedFunction(self.function(keys), inputs[0].shape[0])(*inputs)[0]


def _unpacked(kept: Packed) -> Evaluator:
    inputs, written = kept.unpacked()
    return Evaluator(inputs, WrittenComponents(written))


def _column(symbols: list[Any]) -> Any:
    return casadi.vertcat(casadi.SX(0, 1), *symbols)
