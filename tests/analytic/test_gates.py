"""The textbook problems of tests/problems, solved with default settings, against closed forms."""

from functools import cache
from importlib import import_module

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pyomo_quad.collocation import Status, control_polynomial
from tests.problems import __main__ as table

TOLERANCE = 1e-8
# Of the states: what the error estimate promises, times what an unseen control error adds.
STATE_TOLERANCE = 1e-6
# Of controls and costates, root mean square: the optimum is flat, so an objective good to 1e-8
# needs no better.
SLOPE_TOLERANCE = 1e-4
# The cost does not hold a singular control, so it is found far less sharply; its costates are
# cubics and quartics on elements that the states, quadratics there, let stay coarse.
SINGULAR_STATE_TOLERANCE = 1e-5
SINGULAR_SLOPE_TOLERANCE = 1e-2
# Beside a jump or bend the polynomials cannot follow within one element.
BESIDE_KINK = 1e-2

GATES = (
    "bang_bang",
    "brachistochrone",
    "bryson_denham",
    "dido",
    "diode_charging",
    "double_integrator",
    "floor_constraint",
    "goddard",
    "hyper_sensitive",
    "implicit_dae",
    "jacobson",
    "mass_chain",
    "saving",
    "scalar_regulator",
    "singular_arc",
    "steering",
    "stiff_tracking",
    "waypoint",
)


def textbook(name):
    return import_module(f"tests.problems.{name}")


@cache
def solved(name):
    return table.compiled_case(table.textbook(name)).solve(tolerance=TOLERANCE)


def times_away_from_kinks(name, count=201):
    times = np.linspace(*solved(name).horizon, count)
    for kink in textbook(name).KINKS:
        times = times[np.abs(times - kink) > BESIDE_KINK]
    return times


def split(component):
    return component if isinstance(component, tuple) else (component, None)


def state_tolerance(name):
    return SINGULAR_STATE_TOLERANCE if name == "singular_arc" else STATE_TOLERANCE


def slope_tolerance(name):
    return SINGULAR_SLOPE_TOLERANCE if name == "singular_arc" else SLOPE_TOLERANCE


def offering(kind, names=GATES):
    return [name for name in names if hasattr(textbook(name), kind)]


def assert_close(found, expected, tolerance):
    assert np.max(np.abs(found - expected)) <= tolerance * np.max(np.abs(expected))


def assert_close_in_the_mean(found, expected, tolerance):
    error = np.sqrt(np.mean((found - expected) ** 2))
    assert error <= tolerance * np.max(np.abs(expected))


@pytest.mark.parametrize("name", GATES)
def test_objective(name):
    solution = solved(name)
    assert solution.status is Status.CONVERGED
    assert solution.error_estimate <= TOLERANCE
    assert solution.objective == pytest.approx(textbook(name).objective(), rel=TOLERANCE)


@pytest.mark.parametrize("name", offering("state"))
def test_states(name):
    times = times_away_from_kinks(name)
    for component, expected in textbook(name).state(times).items():
        variable, index = split(component)
        assert_close(
            solved(name).value(variable, times, index=index), expected, state_tolerance(name)
        )


@pytest.mark.parametrize("name", offering("control"))
def test_controls(name):
    times = times_away_from_kinks(name)
    for component, expected in textbook(name).control(times).items():
        variable, index = split(component)
        found = solved(name).value(variable, times, index=index)
        assert_close_in_the_mean(found, expected, slope_tolerance(name))


@pytest.mark.parametrize("name", offering("costate"))
def test_costates(name):
    times = times_away_from_kinks(name)
    for component, expected in textbook(name).costate(times).items():
        variable, index = split(component)
        found = solved(name).costate(variable, times, index=index)
        assert_close_in_the_mean(found, expected, slope_tolerance(name))


def own_times(name):
    """Return times all over the horizon, the mesh's among them, but for the very kinks."""
    solution = solved(name)
    times = np.unique([*np.linspace(*solution.horizon, 201), *solution.times])
    return times[[not np.any(np.isclose(t, textbook(name).KINKS, atol=1e-6)) for t in times]]


def farthest(found, expected):
    return np.max(np.abs(found - expected)) / np.max(np.abs(expected))


@pytest.mark.parametrize("name", offering("costate"))
def test_no_costate_is_wronger_than_twice_what_it_claims(name):
    solution, times = solved(name), own_times(name)
    for component, expected in textbook(name).costate(times).items():
        variable, index = split(component)
        found = solution.costate(variable, times, index=index)
        claimed = solution.costate_errors[variable if index is None else f"{variable}[{index}]"]
        assert farthest(found, expected) <= 2 * claimed


# Any polynomial of dido's slope satisfies the equations, so that its error stays unseen.
@pytest.mark.parametrize("name", [name for name in offering("state") if name != "dido"])
def test_no_state_is_wronger_than_twice_what_it_claims(name):
    solution, times = solved(name), own_times(name)
    for component, expected in textbook(name).state(times).items():
        variable, index = split(component)
        found = solution.value(variable, times, index=index)
        error = np.max(np.abs(found - expected)) / max(1.0, np.max(np.abs(expected)))
        assert error <= max(2 * solution.state_error, 1e-12)


@pytest.mark.parametrize(
    ("name", "costate"),
    [
        ("brachistochrone", "v"),
        ("hyper_sensitive", "x"),
        ("jacobson", "x1"),
        ("scalar_regulator", "x"),
        ("singular_arc", "x"),
        ("stiff_tracking", "x"),
    ],
)
def test_costates_are_as_sharp_as_asked_for_where_no_limit_pulls_them(name, costate):
    times = own_times(name)
    found = solved(name).costate(costate, times)
    assert farthest(found, textbook(name).costate(times)[costate]) <= 5 * TOLERANCE


@pytest.mark.parametrize(
    "name", ["brachistochrone", "dido", "double_integrator", "hyper_sensitive", "mass_chain"]
)
def test_hamiltonian_is_constant_where_time_plays_no_part(name):
    solution = solved(name)
    values = solution.hamiltonian(times_away_from_kinks(name))
    size = max(abs(solution.objective), float(np.max(np.abs(values))))
    assert np.ptp(values) <= SLOPE_TOLERANCE * size


@pytest.mark.parametrize("name", GATES)
def test_controls_flown_by_scipy_pass_the_same_states(name):
    solution = solved(name)
    mesh, path = solution.mesh, solution.trajectory
    dynamics = solution.problem.dynamics(statics=path.statics)
    names = [slot.name for slot in solution.problem.compiled.declared.algebraics]
    chosen = [names.index(control) for control in dynamics.control_names]
    size = np.maximum(np.abs(path.states).max(axis=0), 1.0)
    x = path.states[0]
    for e in range(mesh.elements):
        start, end = solution.times[mesh.first_node[[e, e + 1]]]
        control = control_polynomial(mesh, path.algebraics[:, chosen], e, start, end)
        flown = solve_ivp(
            lambda t, x, control=control: dynamics.rates(t, x, control(t)),
            (start, end),
            x,
            method="LSODA",
            rtol=1e-11,
            atol=1e-12,
        )
        x = flown.y[:, -1]
        assert np.max(np.abs(x - path.states[mesh.first_node[e + 1]]) / size) <= STATE_TOLERANCE


def test_the_table_lists_every_problem(capsys):
    listed = table.names()
    assert set(GATES) <= set(listed)
    assert len(set(listed)) == len(listed) >= 40
    table.main(["--no-stock", "double_integrator", "steering"])
    header, *lines, total = capsys.readouterr().out.splitlines()
    assert header.split()[:2] == ["problem", "published"]
    for line, name in zip(lines, ("double_integrator", "steering"), strict=True):
        cells = line.split()
        assert cells[0] == name
        off, claimed = float(cells[4]), float(cells[5])
        assert off <= 2 * max(claimed, TOLERANCE)
    assert total.endswith("s at 1e-8")


@pytest.mark.slow
@pytest.mark.parametrize("case", table.cases(), ids=table.names())
def test_no_problem_is_wronger_than_twice_what_it_claims(case):
    solution = table.compiled_case(case).solve(tolerance=1e-6, starts=case.starts)
    assert solution.is_converged
    assert table.off_by(case, solution.objective) <= 2 * solution.error_estimate


@pytest.mark.slow
def test_the_alp_rider_s_limit_is_kept_in_flight_at_less_than_the_published_cost():
    """Begun anew where each element begins, for between them the rider's slope grows as e^(2 t)."""
    (case,) = (case for case in table.cases() if case.name == "alp_rider")
    solution = table.compiled_case(case).solve(tolerance=TOLERANCE)
    mesh, path = solution.mesh, solution.trajectory
    peaks = ((3, 3, 12), (3, 6, 10), (3, 10, 6), (8, 15, 4))
    cost = 0.0
    for e in range(mesh.elements):
        start, end = solution.times[mesh.first_node[[e, e + 1]]]
        control = control_polynomial(mesh, path.algebraics, e, start, end)

        def rates(t, x, control=control):
            a, b, c, d, _ = x
            u, w = control(t)
            square = a**2 + b**2 + c**2 + d**2
            slopes = (-10 * a + u + w, -2 * b + u + 2 * w, -3 * c + 5 * d + u - w)
            return (*slopes, 5 * c - 3 * d + u + 3 * w, 100 * square + 0.01 * (u**2 + w**2))

        times = np.linspace(start, end, 41)
        flown = solve_ivp(
            rates,
            (start, end),
            [*path.states[mesh.first_node[e]], 0.0],
            method="DOP853",
            t_eval=times,
            rtol=1e-12,
            atol=1e-12,
        )
        *states, cost_here = flown.y
        cost += cost_here[-1]
        missed = flown.y[:4, -1] - path.states[mesh.first_node[e + 1]]
        assert np.max(np.abs(missed)) <= TOLERANCE
        terrain = 0.01 + sum(h * np.exp(-steep * (times - at) ** 2) for h, at, steep in peaks)
        assert np.all(np.square(states).sum(axis=0) >= (1 - TOLERANCE) * terrain - TOLERANCE)
    assert cost == pytest.approx(solution.objective, rel=2 * solution.error_estimate)
    assert cost < 2030.85609
