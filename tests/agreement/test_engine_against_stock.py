"""The engine's program against Pyomo's own values on the stock-discretised model.

Objective, constraints, Jacobian and Hessian at random points about the optimum; the stock
scheme's derivative variables are eliminated by its own discretisation equations, since the
engine's compact program has none.  Then the optimum, found by CasADi's own Ipopt from Pyomo's
.nl file.
"""

from importlib import import_module

import numpy as np
import pytest
from pyomo.core.expr.calculus.derivatives import Modes, differentiate
from pyomo.core.expr.visitor import identify_variables
from pyomo.environ import Objective, value

from pyomo_quad.collocation import Mesh, compile
from pyomo_quad.collocation.program.transcription import row_place, unknown_place
from pyomo_quad.model import build_model
from pyomo_quad.scenario import load_scenario
from tests.agreement.stock import StockModel

# The stock scheme's matrices come from polynomial roots and carry their rounding.
ROUNDING = 1e-9


def quadrotor():
    return build_model(load_scenario("scenarios/paper_wind.toml"))


def textbook(name):
    return lambda: import_module(f"tests.problems.{name}").build()


# Builder, name of time, elements, degree, integrands.
CASES = {
    "brachistochrone": (textbook("brachistochrone"), "tau", 4, 3, {}),
    "implicit_dae": (
        textbook("implicit_dae"), "t", 3, 4,
        {"cost": lambda m, t: (m.x[t] ** 2 + m.rate[t] ** 2) / 2},
    ),
    "mass_chain": (textbook("mass_chain"), "t", 5, 3, {"effort": lambda m, t: m.u[t] ** 2 / 2}),
    "saving": (
        textbook("saving"), "t", 5, 3,
        {"lifetime_utility": lambda m, t: m.utility[t]},
    ),
    "scalar_regulator": (
        textbook("scalar_regulator"), "t", 4, 3,
        {"cost": lambda m, t: (m.q * m.x[t] ** 2 + m.r * m.u[t] ** 2) / 2},
    ),
    "quadrotor": (quadrotor, "time", 4, 3, {"energy": lambda m, t: m.power.total[t]}),
}  # fmt: skip


def discretised(case):
    builder, time, elements, degree, integrands = CASES[case]
    model = builder()
    return StockModel(
        model,
        model.find_component(time),
        elements=elements,
        degree=degree,
        integrands=integrands,
    )


class Comparison:
    """Both programs of one case, and the map from stock variables to engine unknowns."""

    def __init__(self, case):
        builder, _, elements, degree, _ = CASES[case]
        self.case = case
        self.solution = compile(builder()).solve(mesh=Mesh.uniform(elements, degree))
        self.program = self.solution.program
        self.stock = discretised(case)
        self.n = self.program.layout.unknowns
        self.columns, self.variables = self._match_variables()
        for derivative, equation in self.stock.slopes():
            self.columns[id(derivative)] = self._slope(derivative, equation)
        self.derivatives = [d for d, _ in self.stock.slopes()]

    def _label(self, fraction):
        first, last = self.stock.times[0], self.stock.times[-1]
        times = np.array(self.stock.times)
        return self.stock.labels[int(np.argmin(np.abs(times - first - (last - first) * fraction)))]

    def _match_variables(self):
        layout, declared = self.program.layout, self.program.compiled.declared
        mesh = self.program.mesh
        columns, variables = {}, {}
        for slots, table, fractions in (
            (declared.states, layout.state_columns, mesh.node_fractions),
            (declared.algebraics, layout.algebraic_columns, mesh.point_fractions),
            (declared.statics, layout.static_columns[None, :], (None,)),
        ):
            for k, slot in enumerate(slots):
                component = self.stock.model.find_component(slot.component)
                for fraction, column in zip(fractions, table[:, k], strict=True):
                    at = () if fraction is None else (self._label(fraction),)
                    index = (*slot.index, *at)
                    data = component[index if len(index) != 1 else index[0]] if index else component
                    columns[id(data)] = {int(column): 1.0}
                    variables[int(column)] = data
        return columns, variables

    def _slope(self, derivative, equation):
        """Return the derivative as weights of the states, from an equation that is linear."""
        for variable in identify_variables(equation.body, include_fixed=False):
            variable.set_value(0.0, skip_validation=True)
        slopes = gradient(equation.body)
        own = slopes.pop(id(derivative))
        return {
            column: -factor / own
            for key, factor in slopes.items()
            for column in self.columns.get(key, {})
        }

    def random_point(self, generator):
        nominal = np.ones(self.n)
        declared, layout = self.program.compiled.declared, self.program.layout
        for slots, table in (
            (declared.states, layout.state_columns),
            (declared.algebraics, layout.algebraic_columns),
        ):
            for k, slot in enumerate(slots):
                nominal[table[:, k]] = slot.nominal or 1.0
        z = self.solution.unknowns
        return z * (1 + 0.02 * generator.random(self.n)) + 0.02 * nominal * generator.random(self.n)

    def put(self, z):
        for column, data in self.variables.items():
            data.set_value(float(z[column]), skip_validation=True)
        for data in self.derivatives:
            slope = sum(w * z[c] for c, w in self.columns[id(data)].items())
            data.set_value(float(slope), skip_validation=True)

    def rows(self):
        """Return the stock constraint of every row of the engine's program."""
        constraints = self.stock.constraints()
        found = []
        for row in range(self.program.n_rows):
            place = row_place(self.program, row)
            label = None if place.element is None else self._label(self._fraction(place))
            found.append(constraints[place.name, label])
        return found

    def _fraction(self, place):
        mesh = self.program.mesh
        return mesh.point_fractions[mesh.first_node[place.element] + place.point - 1]

    def objective(self):
        (objective,) = self.stock.model.component_data_objects(Objective, active=True)
        return objective.expr * objective.sense

    def project(self, slopes):
        """Return a gradient in the engine's unknowns."""
        result = np.zeros(self.n)
        for key, factor in slopes.items():
            for column, weight in self.columns.get(key, {}).items():
                result[column] += factor * weight
        return result

    def curvature(self, expression):
        """Return the Hessian of an expression in the engine's unknowns."""
        result = np.zeros((self.n, self.n))
        variables = list(identify_variables(expression, include_fixed=True))
        firsts = differentiate(expression, wrt_list=variables, mode=Modes.reverse_symbolic)
        for variable, first in zip(variables, firsts, strict=True):
            row = self.project({id(variable): 1.0})
            result += np.outer(row, self.project(gradient(first)))
        return result


def gradient(expression):
    """Return Pyomo's derivatives of an expression by variable id, at the current values."""
    if not hasattr(expression, "is_expression_type"):
        return {}
    variables = list(identify_variables(expression, include_fixed=True))
    slopes = differentiate(expression, wrt_list=variables, mode=Modes.reverse_numeric)
    return {id(v): float(s) for v, s in zip(variables, slopes, strict=True)}


def residual(constraint):
    lower, body, _ = constraint.to_bounded_expression()
    return body - lower if constraint.equality else body


def dense(program, structure, values):
    rows, columns = structure
    result = np.zeros((program.n_rows, program.layout.unknowns))
    np.add.at(result, (rows, columns), values)
    return result


def assert_close(found, expected):
    assert np.max(np.abs(found - expected)) <= ROUNDING * max(1.0, np.max(np.abs(expected)))


@pytest.fixture(scope="module", params=CASES)
def comparison(request):
    return Comparison(request.param)


@pytest.fixture(scope="module", params=[1, 2])
def at_point(request, comparison):
    generator = np.random.default_rng(request.param)
    z = comparison.random_point(generator)
    comparison.put(z)
    return comparison, z, generator


def test_objective_and_gradient(at_point):
    comparison, z, _ = at_point
    expected = comparison.objective()
    assert_close(comparison.program.objective(z), value(expected))
    assert_close(comparison.program.gradient(z), comparison.project(gradient(expected)))


def test_constraints(at_point):
    comparison, z, _ = at_point
    expected = np.array([value(residual(c)) for c in comparison.rows()])
    assert_close(comparison.program.constraints(z), expected)


def test_jacobian(at_point):
    comparison, z, _ = at_point
    program = comparison.program
    expected = np.array([comparison.project(gradient(residual(c))) for c in comparison.rows()])
    assert_close(dense(program, program.jacobianstructure(), program.jacobian(z)), expected)


def test_hessian(at_point):
    comparison, z, generator = at_point
    program = comparison.program
    multipliers = generator.standard_normal(program.n_rows)
    lagrangian = 0.7 * comparison.objective() + sum(
        m * residual(c) for m, c in zip(multipliers, comparison.rows(), strict=True)
    )
    rows, columns = program.hessianstructure()
    found = np.zeros((comparison.n, comparison.n))
    np.add.at(found, (rows, columns), program.hessian(z, multipliers, 0.7))
    assert_close(found, np.tril(comparison.curvature(lagrangian)))


def test_every_row_of_the_stock_model_is_kept_or_a_bound(comparison):
    """Nothing declared is lost: a stock row is a row, or limits one unknown, or is an output's."""
    kept = {id(c) for c in comparison.rows()}
    outputs = {s.component for s in comparison.program.compiled.declared.outputs}
    for constraint, label in comparison.stock.rows():
        variables = list(identify_variables(residual(constraint), include_fixed=True))
        is_of_scheme = comparison.stock.is_slope(constraint)
        is_output = any(v.parent_component().name in outputs for v in variables)
        if label == comparison.stock.labels[0] or is_of_scheme or is_output:
            continue
        assert id(constraint) in kept or len(variables) == 1


def test_optimum(comparison):
    expected = discretised(comparison.case).optimum()
    assert comparison.solution.objective == pytest.approx(expected, rel=1e-8)


def test_unknowns_have_the_names_of_their_variables(comparison):
    for column, data in comparison.variables.items():
        name = unknown_place(comparison.program, column).name
        assert name.split("[")[0] == data.parent_component().name
