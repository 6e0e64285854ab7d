"""Tables and external functions of states: their spline, what reads them, what is refused."""

import pickle

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import (
    ConcreteModel,
    Constraint,
    ExternalFunction,
    Objective,
    Var,
    cos,
    maximize,
    sin,
    value,
)
from scipy.integrate import solve_ivp
from scipy.interpolate import RectBivariateSpline, make_interp_spline

from pyomo_quad.collocation import Table, TranscriptionError, compile, solve
from pyomo_quad.collocation.reading.tables import Spline


def falling(drag, *, height=1000.0, end=10.0):
    """A body that falls from a height through air whose drag is a function of height."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, end))
    m.h, m.v = Var(m.t, bounds=(0, 2000)), Var(m.t, bounds=(0, 500))
    m.dh_dt, m.dv_dt = DerivativeVar(m.h, wrt=m.t), DerivativeVar(m.v, wrt=m.t)
    m.drag = drag
    m.fall = Constraint(m.t, rule=lambda m, t: m.dh_dt[t] == -m.v[t])
    m.pull = Constraint(m.t, rule=lambda m, t: m.dv_dt[t] == 9.81 - m.drag(m.h[t]) * m.v[t] ** 2)
    m.h[0].fix(height)
    m.v[0].fix(0)
    return m


def density(h):
    return 0.004 * np.exp(-h / 700)


def crossing(wind):
    """Time to cross a river whose stream is a function of the place, as Zermelo has it."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 1))
    m.T = Var(bounds=(0.1, 10), initialize=2)
    m.x, m.y = Var(m.t, bounds=(-1, 3)), Var(m.t, bounds=(-2, 2))
    m.heading = Var(m.t, bounds=(-3, 3), initialize=0)
    m.dx_dt, m.dy_dt = DerivativeVar(m.x, wrt=m.t), DerivativeVar(m.y, wrt=m.t)
    m.wind = wind
    m.east = Constraint(
        m.t, rule=lambda m, t: m.dx_dt[t] == cos(m.heading[t]) + m.wind(m.x[t], m.y[t])
    )
    m.north = Constraint(m.t, rule=lambda m, t: m.dy_dt[t] == sin(m.heading[t]))
    for state, first, last in ((m.x, 0, 2), (m.y, 0, 0)):
        state[0].fix(first)
        state[1].fix(last)
    m.objective = Objective(expr=m.T)
    return m


def test_a_spline_is_scipys_within_its_range():
    points, generator = np.array([0.0, 0.3, 0.4, 1.0, 1.7, 2.0]), np.random.default_rng(1)
    values = generator.normal(size=points.size)
    ours, theirs = Spline.through([points], values, 3), make_interp_spline(points, values)
    for at in (0.1, 0.35, 1.2, 1.99):
        found = [float(part) for part in ours.function([at])]
        assert found == pytest.approx([float(theirs(at, k)) for k in range(3)], rel=1e-10)
    rows, columns = np.linspace(0, 1, 5), np.linspace(-1, 2, 7)
    grid = generator.normal(size=(5, 7))
    plane = Spline.through([rows, columns], grid, 3)
    flat = RectBivariateSpline(rows, columns, grid, s=0)
    got, slope, _ = plane.function([0.61, 0.4])
    assert float(got) == pytest.approx(flat(0.61, 0.4).item(), rel=1e-11)
    wanted = [flat(0.61, 0.4, dx=1).item(), flat(0.61, 0.4, dy=1).item()]
    assert slope.full().ravel() == pytest.approx(wanted, rel=1e-10)


def test_a_spline_goes_on_straight_beyond_its_range():
    points = np.linspace(0, 2, 9)
    spline = Spline.through([points], np.sin(points), 3)
    end, slope, _ = (float(part) for part in spline.function([2.0]))
    for beyond in (0.1, 5.0):
        assert float(spline.function([2.0 + beyond])[0]) == pytest.approx(end + beyond * slope)


def test_a_spline_goes_through_points_at_any_distances():
    generator = np.random.default_rng(0)
    for _ in range(40):
        points = np.cumsum(generator.uniform(1, 30, 9)) - 80.0
        spline = Spline.through([points], np.sin(points), 3)
        assert float(spline.function([points[4]])[0]) == pytest.approx(np.sin(points[4]), abs=1e-9)


def test_a_table_of_a_state_is_read_as_its_spline():
    heights = np.linspace(0, 2000, 81)
    by_table = solve(falling(Table(heights, density(heights))), tolerance=1e-8)
    exact = falling(ExternalFunction(density))
    by_formula = solve(exact, tolerance=1e-8)
    assert by_table.is_converged
    assert by_table.value("v", 10.0) == pytest.approx(by_formula.value("v", 10.0), rel=1e-7)
    # SciPy's integration of the same spline.
    spline = make_interp_spline(heights, density(heights))
    flown = solve_ivp(
        lambda _t, s: (-s[1], 9.81 - spline(s[0]) * s[1] ** 2), (0, 10), (1000, 0), rtol=1e-11
    )
    assert by_table.value("v", 10.0) == pytest.approx(flown.y[1, -1], rel=1e-8)


def test_a_function_that_takes_no_symbols_is_sampled_between_bounds():
    exact = solve(falling(ExternalFunction(density)))

    def with_numbers(h):
        return 0.004 * float(np.exp(-float(h) / 700))

    assert solve(falling(ExternalFunction(with_numbers))).value("v", 10.0) == pytest.approx(
        exact.value("v", 10.0), rel=1e-7
    )


def test_what_a_function_raises_is_told_with_where_and_its_type():
    def above_clouds(h):
        if float(h) > 900:
            raise RuntimeError("no air")
        return 0.004

    told = r"^drag in pull: its function fails at \d+ \(RuntimeError: no air\), between the bounds"
    with pytest.raises(TranscriptionError, match=told):
        solve(falling(ExternalFunction(above_clouds)))


def test_a_wind_grid_bends_the_quickest_way_as_its_formula_does():
    across, along = np.linspace(-1, 3, 17), np.linspace(-2, 2, 33)

    def stream(_x, y):
        return 0.3 - 0.5 * y**2 + 0.2 * y

    grid = stream(*np.meshgrid(across, along, indexing="ij"))
    found = [
        compile(m, final_time=m.T).solve().objective
        for m in (crossing(Table(across, along, grid)), crossing(ExternalFunction(stream)))
    ]
    assert found[0] == pytest.approx(found[1], rel=1e-9)
    assert found[0] < 2 / 1.3


def test_a_table_has_a_value_in_pyomo_and_survives_a_pickle():
    heights = np.linspace(0, 2000, 9)
    m = falling(Table(heights, heights**2))
    m.h[0].set_value(1000.0)
    assert value(m.drag(m.h[0])) == pytest.approx(1e6)
    _, slopes, curvature = m.drag.evaluate_fgh([1000.0, m.drag._fcn_id])
    assert slopes[0] == pytest.approx(2000.0)
    assert curvature[0] == pytest.approx(2.0)
    problem = compile(falling(Table(heights, density(heights))))
    again = pickle.loads(pickle.dumps(problem))
    assert again.solve().value("v", 10.0) == problem.solve().value("v", 10.0)


def test_a_table_over_time_and_in_an_objective():
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 2))
    m.x = Var(m.t)
    m.dx_dt = DerivativeVar(m.x, wrt=m.t)
    points = np.linspace(0, 2, 5)
    m.wind, m.price = Table(points, points**3), Table(np.linspace(0, 9, 6), np.arange(6.0))
    m.drift = Constraint(m.t, rule=lambda m, t: m.dx_dt[t] == m.wind(t))
    m.x[0].fix(0)
    m.gain = Integral(m.t, wrt=m.t, rule=lambda m, t: m.wind(t))
    m.objective = Objective(expr=m.price(m.x[2]) + 0 * m.gain, sense=maximize)
    assert solve(m).objective == pytest.approx(4.0 / 1.8)


def test_a_solution_beyond_a_table_is_not_converged():
    heights = np.linspace(500, 2000, 31)
    solution = solve(falling(Table(heights, density(heights)), end=14.0))
    assert not solution.is_converged
    assert solution.message.startswith("drag in pull: its argument is ")
    assert "outside its range [500, 2000]; extend the table, or bound" in solution.message


def test_a_table_in_a_model_without_time():
    m = ConcreteModel()
    m.x = Var(initialize=1)
    m.cost = Table(np.linspace(0, 3, 7), (np.linspace(0, 3, 7) - 2) ** 2)
    m.objective = Objective(expr=m.cost(m.x))
    assert solve(m).value("x") == pytest.approx(2.0)
    m.far = Constraint(expr=m.x >= 4)
    assert "its argument is 4, outside its range [0, 3]" in solve(m).message


@pytest.mark.parametrize(
    ("grid", "line"),
    [
        (([0, 1, 2], [0, 1, 4]), "Table: 3 points along axis 1; at least 4 .* are needed"),
        (([0, 1, 1, 2], [0, 1, 4, 9]), "Table: points along axis 1 do not rise, 1 before 1; sort"),
        (([0, 1, 2, 3], [0, 1, 4]), r"Table: values of shape \(3,\) for points of shape \(4,\)"),
        (([0, 1, 2, 3], [0, 1, np.nan, 9]), "Table: some values are not finite"),
        (([0, 1, 2, 3], [0, 1, 2], np.zeros((4, 3))), "Table: 3 points along axis 2; at least 4"),
    ],
)
def test_tables_that_cannot_be_are_refused(grid, line):
    with pytest.raises(TranscriptionError, match=line):
        Table(*grid)


def test_a_table_is_called_with_as_many_arguments_as_it_has():
    m = ConcreteModel()
    m.drag = Table(range(5), range(5))
    with pytest.raises(TranscriptionError, match=r"drag: called with 2 arguments; it has .* 1"):
        m.drag(1.0, 2.0)


def test_functions_that_cannot_be_tabulated_are_refused():
    def kinked(h):
        return float(np.interp(float(h), [0, 700, 2000], [0.004, 0.001, 0.0]))

    with pytest.raises(
        TranscriptionError, match=r"drag in pull.* has a relative error of .*a Table"
    ):
        solve(falling(ExternalFunction(kinked)))
    unbounded = falling(ExternalFunction(float))
    unbounded.h.setub(None)
    with pytest.raises(TranscriptionError, match=r"drag in pull.*: .*argument 1 has no finite "):
        solve(unbounded)
