"""What a solution offers, and that it is also put into the Pyomo model."""

import pickle
from copy import deepcopy
from functools import cache
from inspect import signature
from xml.etree import ElementTree as ET

import numpy as np
import pandas as pd
import pytest
from pyomo.environ import Constraint, Param, value

from pyomo_quad import collocation
from pyomo_quad.collocation import Mesh, Status, Summarised, TranscriptionError, compile, solve
from tests.problems import bang_bang, dido, double_integrator, mass_chain, saving, waypoint
from tests.starts import assert_begins_at, noted_starts

MESH = Mesh.uniform(6, 4)


@cache
def solution():
    return solve(double_integrator.build(), mesh=MESH)


def test_value_at_one_time_is_a_number():
    found = solution().value("x", 0.5)
    assert isinstance(found, float)
    assert found == pytest.approx(0.5, abs=1e-9)


def test_value_takes_the_shape_of_the_times():
    times = np.linspace(0, 1, 6)
    found = solution().value("v", times)
    np.testing.assert_allclose(found, double_integrator.state(times)["v"], atol=1e-9)


def test_value_of_a_component_of_the_model():
    m = double_integrator.build()
    found = solve(m, mesh=MESH)
    assert found.value(m.u, 0.25) == pytest.approx(3.0, abs=1e-8)
    assert found.value(m.dx_dt, 0.25) == pytest.approx(1.125, abs=1e-8)
    assert found.value(m.effort) == pytest.approx(6.0, rel=1e-9)
    assert found.costate(m.x, 0.25) == pytest.approx(-12.0, rel=1e-6)


def test_value_with_a_further_index():
    m = mass_chain.build()
    found = solve(m, mesh=Mesh.uniform(10, 9))
    assert found.value(m.x, mass_chain.DURATION, index=2) == pytest.approx(0.4, abs=1e-9)
    expected = mass_chain.costate(np.array([3.0]))["v", 4]
    assert found.costate(m.v, np.array([3.0]), index=4) == pytest.approx(expected, rel=1e-4)


def test_named_expressions_can_be_read():
    m = saving.build()
    found = solve(m)
    consumption = found.value(m.consumption, 4.0)
    expected = np.exp(-saving.DISCOUNT * 4.0) * np.log(consumption)
    assert found.value(m.utility, 4.0) == pytest.approx(expected, rel=1e-12)


def test_static_variables():
    m = bang_bang.build()
    found = solve(m, mesh=Mesh(breakpoints=(0.0, bang_bang.SWITCH, 1.0), degrees=(3, 3)))
    assert found.value(m.duration) == pytest.approx(30.0, rel=1e-8)


def test_values_are_loaded_into_the_model():
    m = waypoint.build()
    found = solve(m)
    assert value(m.x[0.4]) == pytest.approx(1.0, abs=1e-9)
    assert value(m.v[0.4]) == pytest.approx(waypoint.SPEED, rel=1e-8)
    assert value(m.v[0.4]) == pytest.approx(found.value(m.v, 0.4), rel=1e-12)


def test_frame_holds_the_nodes():
    frame = solution().to_frame()
    assert list(frame.columns) == ["time", "x", "v", "u"]
    assert len(frame) == MESH.points + 1
    np.testing.assert_allclose(
        frame["x"], double_integrator.state(frame["time"].to_numpy())["x"], atol=1e-9
    )


def test_frame_at_chosen_times():
    frame = solution().to_frame([0.0, 0.5, 1.0])
    assert isinstance(frame, pd.DataFrame)
    np.testing.assert_allclose(frame["u"], [6.0, 0.0, -6.0], atol=1e-7)


def test_costates_are_the_slopes_of_the_optimum_in_the_start():
    m = double_integrator.build()
    problem = compile(m)
    step = 1e-4
    optima = []
    for shift in (step, -step):
        m.x[0].fix(shift)
        optima.append(problem.solve(mesh=MESH).objective)
    slope = (optima[0] - optima[1]) / (2 * step)
    assert solution().costate("x", 0.0) == pytest.approx(slope, rel=1e-6)


def test_running_objective_ends_at_the_objective():
    running = solution().running_objective
    assert running[0] == 0.0
    assert running[-1] == pytest.approx(solution().objective, rel=1e-12)
    assert np.all(np.diff(running) >= 0.0)


def test_integral_constraint_is_met():
    m = dido.build()
    assert solve(m).value(m.length) == pytest.approx(dido.ROPE, rel=1e-10)


@pytest.mark.parametrize("time", [-0.1, 1.1, np.nan])
def test_times_outside_the_horizon_are_refused(time):
    with pytest.raises(TranscriptionError, match=r"is outside the horizon \[0, 1\]"):
        solution().value("x", time)


def test_unknown_names_are_refused():
    with pytest.raises(TranscriptionError, match="speed: is not a variable or expression"):
        solution().value("speed", 0.5)
    with pytest.raises(TranscriptionError, match="u: is not a state of the optimised model"):
        solution().costate("u", 0.5)
    with pytest.raises(TranscriptionError, match="speed: is not a static variable or integral"):
        solution().value("speed")


def test_a_deep_copy_is_a_solution_of_its_own():
    m = double_integrator.build()
    problem = compile(m)
    found = problem.solve(mesh=MESH)
    copied = deepcopy(found)
    assert copied.problem is not problem
    assert copied.value("u", 0.3) == found.value("u", 0.3)
    assert copied.costate("x", 0.3) == found.costate("x", 0.3)
    assert copied.program.user_objective(found.unknowns) == found.objective
    m.x[0].fix(0.5)
    assert problem.solve(mesh=MESH).objective < 4.0
    # The copied problem has a model of its own, which still starts from 0.
    assert copied.problem.solve(mesh=MESH).objective == pytest.approx(6.0, rel=1e-9)


PICKLED = {
    "fixed values": (double_integrator, {"mesh": MESH}),
    "static variable": (bang_bang, {"mesh": MESH}),
    "expression over time": (saving, {}),
    "further index": (mass_chain, {"mesh": Mesh.uniform(10, 9)}),
    "integral in a condition": (dido, {"mesh": MESH}),
    "waypoint": (waypoint, {}),
}


@pytest.mark.parametrize("name", PICKLED)
def test_a_pickled_solution_is_the_same_and_solves_again(name):
    problem, how = PICKLED[name]
    found = compile(problem.build()).solve(**how)
    restored = pickle.loads(pickle.dumps(found))
    pd.testing.assert_frame_equal(restored.to_frame(), found.to_frame(), check_exact=True)
    residuals = [f.program.constraints(f.unknowns) for f in (restored, found)]
    np.testing.assert_array_equal(*residuals)
    np.testing.assert_array_equal(restored.costates.at_points, found.costates.at_points)
    assert restored.warnings == found.warnings
    assert restored.warm_start.fits(found.problem.compiled)
    again = restored.problem.solve(**how)
    assert again.objective == pytest.approx(found.objective, rel=1e-12)
    with noted_starts() as starts:
        warm = restored.problem.solve(mesh=restored.mesh, warm_start=found)
    assert_begins_at(starts[0], found)
    assert warm.objective == pytest.approx(found.objective, rel=1e-8)


def test_a_pickled_problem_evaluates_what_its_model_declared_and_nothing_else():
    found = solve(saving.build())
    restored = pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(found))))
    for name in ("utility", "consumption"):
        assert restored.value(name, 4.0) == found.value(name, 4.0)
    with pytest.raises(TranscriptionError, match="speed: is not a variable or expression"):
        restored.value("speed", 0.5)
    with pytest.raises(TranscriptionError, match="utility: has no index 3 beside time"):
        restored.value("utility", 0.5, index=3)
    with pytest.raises(TranscriptionError, match="'speed' is not a component of the model"):
        restored.problem.solve(parameters={"speed": 1.0})


def test_a_pickled_problem_takes_new_parameters():
    m = double_integrator.build()
    m.arrival.deactivate()
    m.distance = Param(initialize=1.0, mutable=True)
    m.further = Constraint(expr=m.x[1] == m.distance)
    restored = pickle.loads(pickle.dumps(compile(m)))
    # The effort is of second degree in the distance, and falls with the cube of the time.
    assert restored.solve(mesh=MESH).objective == pytest.approx(6.0, rel=1e-9)
    far = restored.solve(mesh=MESH, parameters={"distance": 3.0}, horizon=(0, 2))
    assert far.objective == pytest.approx(6.0 * 9 / 8, rel=1e-9)


def test_a_pickled_problem_leaves_the_model_behind():
    restored = pickle.loads(pickle.dumps(solution()))
    with pytest.raises(TranscriptionError, match="not the model; compile the model again to load"):
        restored.problem.load(restored)
    with pytest.raises(TranscriptionError, match="model: a pickled problem keeps the model's"):
        _ = restored.problem.model


@pytest.mark.parametrize(
    ("shown", "facts"),
    [
        (lambda s: s.mesh, ["elements: 6", "points: 24", "degrees: 4>"]),
        (lambda s: s.problem, ["objective: minimise objective", "states: 2"]),
        (lambda s: s, ["status: converged", "objective: 6", "24 points in 6 elements"]),
    ],
)
def test_what_is_shown_is_one_short_line_and_a_table(shown, facts):
    held = shown(solution())
    line, table = repr(held), held._repr_html_()
    assert "\n" not in line
    assert len(line) < 400
    assert all(fact in line for fact in facts)
    assert line.startswith(f"<{type(held).__name__} ")
    rows = ET.fromstring(table).findall("tr")
    assert {row.find("th").text: row.find("td").text for row in rows} == held.summary


def test_a_mesh_of_several_degrees_and_a_problem_without_objective_are_shown():
    assert "degrees: 2 to 5" in repr(Mesh(breakpoints=(0.0, 0.5, 1.0), degrees=(5, 2)))
    m = double_integrator.build()
    m.objective.deactivate()
    assert "objective: none" in repr(compile(m))


def test_what_has_no_summary_cannot_be_made():
    class Silent(Summarised):
        pass

    with pytest.raises(TypeError, match="abstract"):
        Silent()


def test_an_optimum_of_a_mesh_too_coarse_is_one_still():
    solved = {status for status in Status if status.is_solved}
    assert solved == {Status.CONVERGED, Status.TOLERANCE_NOT_MET}


def test_a_name_is_escaped_in_a_notebook():
    class Named(Summarised):
        @property
        def summary(self):
            return {"name": "<b> & c"}

    assert "<td>&lt;b&gt; &amp; c</td>" in Named()._repr_html_()


def test_the_front_door_says_what_it_takes():
    own, of_problem = signature(solve).parameters, signature(collocation.Problem.solve).parameters
    assert own.keys() - {"model", "final_time", "times"} == of_problem.keys() - {"self"}
    assert all(p.kind is not p.VAR_KEYWORD and p.annotation is not p.empty for p in own.values())
    for name in own.keys() & of_problem.keys():
        assert own[name].default == of_problem[name].default
    assert "JointSolution" in signature(solve).return_annotation


def test_only_public_names_are_shown():
    assert dir(collocation) == sorted(collocation.__all__)
    assert all(hasattr(collocation, name) for name in dir(collocation))
