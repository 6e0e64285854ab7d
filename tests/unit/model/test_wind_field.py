"""A wind that varies from place to place: its derivatives, and the plans that it makes."""

import casadi
import numpy as np
import pytest
from pyomo.environ import value

from pyomo_quad.collocation import compile as compile_model
from pyomo_quad.collocation.reading.tables import Spline
from pyomo_quad.flight import Planner
from pyomo_quad.flight.plan import PlanStatus
from pyomo_quad.flight.proof import refuse_unproven
from pyomo_quad.model import build_model
from pyomo_quad.model.wind import mean_wind, still_air
from pyomo_quad.model.wind_field import unknown_wind
from pyomo_quad.scenario import ScenarioError, load_scenario
from pyomo_quad.scenario.accuracy import FIGURES, Accuracy

HEIGHTS = [0.0, 5.0, 10.0, 15.0, 20.0, 30.0]
_VEHICLE = {"use": "dji_phantom_2", "drag_linear": 0.3}


def mission(wind, **tables):
    return load_scenario(
        {
            "name": "field",
            "vehicle": _VEHICLE,
            "wind": wind,
            "solver": {"accuracy": "proof"},
            "mission": {
                "start": {"position": [20.0, 30.0, 5.0]},
                "goal": {"position": [40.0, 40.0, 9.0]},
                "duration": 8.0,
            },
        }
        | tables
    )


def table(file, columns, rows):
    """Write a CSV file of rows and return its name."""
    lines = [",".join(columns), *(",".join(repr(float(n)) for n in row) for row in rows)]
    file.write_text("\n".join(lines), encoding="utf-8")
    return str(file)


def field(file, wind, **axes):
    """Write the field of a function of its axes, x and y first."""
    columns = [f"{name}_{'s' if name == 'time' else 'm'}" for name in axes]
    points = np.stack(np.meshgrid(*axes.values(), indexing="ij"), axis=-1).reshape(-1, len(axes))
    rows = [(*place, *wind(*place)) for place in points]
    speeds = [f"wind_{axis}_m_per_s" for axis in "xyz"[: len(rows[0]) - len(axes)]]
    return table(file, (*columns, *speeds), rows)


def waves(x, y, z=0.0, t=0.0):
    return (
        4 + np.sin(x / 20) * np.cos(y / 30) + z / 50 + np.sin(t / 60),
        np.cos(x / 25 + y / 30) - z / 40,
        0.3 * np.sin(y / 20),
    )


GRID = {"x": np.linspace(0, 100, 11), "y": np.linspace(0, 90, 10)}
TALL = GRID | {"z": np.linspace(0, 40, 5), "time": np.linspace(0, 60, 7)}


@pytest.mark.lengthy
@pytest.mark.parametrize("axes", [GRID, TALL])
@pytest.mark.parametrize("beyond", ["refuse", "hold"])
def test_a_field_has_exact_first_and_second_derivatives(tmp_path, axes, beyond):
    told = mission({"field": field(tmp_path / "w.csv", waves, **axes), "beyond": beyond})
    dynamics = Planner().dynamics(told)
    names = ("rigid_body.x", "rigid_body.y", "rigid_body.z")
    symbols = [dynamics.symbol(name, 1) for name in names]
    for component in ("velocity_x", "velocity_y", "velocity_z"):
        (written,) = dynamics.expressions(
            ((f"wind.{component}", None),), 3.0, dict(zip(names, symbols, strict=True))
        )
        at = casadi.vertcat(*symbols)
        hessian, gradient = casadi.hessian(written, at)
        found = casadi.Function("found", [at], [written, gradient, hessian])
        place, step = np.array([33.0, 47.0, 12.0]), 1e-4
        steps = step * np.eye(3)
        first = [float(found(place + e)[0] - found(place - e)[0]) / (2 * step) for e in steps]
        second = [
            (found(place + e)[1] - found(place - e)[1]).full().ravel() / (2 * step) for e in steps
        ]
        value_there, slope, bend = (part.full() for part in found(place))
        assert slope.ravel() == pytest.approx(first, rel=1e-6, abs=1e-9)
        assert bend == pytest.approx(np.array(second), rel=1e-6, abs=1e-9)
        index = ("velocity_x", "velocity_y", "velocity_z").index(component)
        height, when = (12.0, 3.0) if "z" in axes else (0.0, 0.0)
        assert value_there.item() == pytest.approx(waves(33, 47, height, when)[index], abs=2e-2)


def test_a_field_has_its_own_values_at_its_points(tmp_path):
    told = mission({"field": field(tmp_path / "w.csv", waves, **TALL), "field_scale": 0.6})
    model = build_model(told)
    body = model.rigid_body
    time = model.time.first()
    body.x[time], body.y[time], body.z[time] = 30.0, 50.0, 20.0
    for name, speed in zip("xyz", waves(30.0, 50.0, 20.0), strict=True):
        wind = model.wind.component(f"velocity_{name}")[time]
        assert value(wind) == pytest.approx(0.6 * speed, rel=1e-12, abs=1e-12)
    for parameter, number in still_air(model).items():
        model.find_component(parameter).set_value(number)
    assert value(model.wind.velocity_x[time]) == 0.0
    assert value(model.wind.velocity_z[time]) == 0.0


@pytest.mark.lengthy
def test_a_field_of_heights_alone_makes_the_plan_of_the_same_profile(tmp_path):
    speeds = [(3 * np.log1p(h), 0.5 * np.sqrt(h)) for h in HEIGHTS]
    columns = ("height_m", "wind_x_m_per_s", "wind_y_m_per_s")
    rows = [(h, *speed) for h, speed in zip(HEIGHTS, speeds, strict=True)]
    profile = Planner().solve(mission({"file": table(tmp_path / "h.csv", columns, rows)}))
    axes = {"x": [0.0, 50.0, 100.0], "y": [0.0, 90.0], "z": HEIGHTS}
    same = field(tmp_path / "f.csv", lambda _x, _y, z: speeds[HEIGHTS.index(z)], **axes)
    # A wind by height is held beyond its heights, and has no edges that a barrier keeps away from.
    of_field = Planner().solve(mission({"field": same, "beyond": "hold"}))
    assert of_field.is_verified
    assert of_field.energy == pytest.approx(profile.energy, rel=1e-8)
    assert of_field.trajectories.states == pytest.approx(profile.trajectories.states, abs=1e-6)


def test_work_of_a_spline_does_not_grow_with_its_table():
    made = []
    for count in (8, 80):
        points = np.linspace(0, 1, count)
        values = np.sin(np.add.outer(points, 2 * points))
        made.append(Spline.through([points, points], values, 3).function)
    assert made[0].n_instructions() == made[1].n_instructions()


@pytest.mark.lengthy
def test_what_two_compiled_models_share_does_not_depend_on_what_was_done_with_them(tmp_path):
    told = mission({"field": field(tmp_path / "w.csv", waves, **GRID)})
    first, again = (compile_model(build_model(told)) for _ in range(2))
    first.solve()
    assert first.compiled.fingerprint == again.compiled.fingerprint
    other = mission({"field": field(tmp_path / "w.csv", lambda x, y: waves(y, x), **GRID)})
    assert compile_model(build_model(other)).compiled.fingerprint != first.compiled.fingerprint


@pytest.mark.slow
def test_a_plan_through_a_cell_without_wind_is_refused_or_held(tmp_path):
    def with_a_tower(x, y):
        return (np.nan, np.nan) if (x, y) == (30.0, 40.0) else (3.0, 1.0)

    axes = {"x": np.linspace(0, 100, 11), "y": np.linspace(0, 90, 10)}
    file = field(tmp_path / "w.csv", with_a_tower, **axes)
    refused = Planner().solve(mission({"field": file}))
    assert refused.status is PlanStatus.SOLVED
    assert "has no wind: keep out of there, give more of the field, or set" in refused.message
    # Nor is it believed when it is read from a file.
    with pytest.raises(ScenarioError, match=r"flown again, at .* has no wind: keep out of there"):
        refuse_unproven(
            refused.scenario,
            refused.trajectories,
            refused.energy,
            (),
            FIGURES[Accuracy.PROOF],
            refused.dynamics,
        )
    assert (
        unknown_wind(mission({"field": file, "beyond": "hold"}), np.zeros(1), [[30, 40, 5]]) == ""
    )
    # Where it is held, the wind is that of the neighbours.
    towards = {"speed": float(np.hypot(3, 1)), "direction": float(np.arctan2(1, 3))}
    assert refused.energy == pytest.approx(Planner().solve(mission(towards)).energy, rel=1e-9)


def test_flights_beyond_a_field_are_told_and_held_winds_change_no_more(tmp_path):
    told = mission({"field": field(tmp_path / "w.csv", waves, **GRID), "beyond": "hold"})
    assert unknown_wind(told, np.array([1.0]), np.array([[-50.0, 40.0, 5.0]])) == ""
    model = build_model(told)
    time = model.time.first()
    model.rigid_body.y[time] = 40.0
    model.rigid_body.z[time] = 5.0
    for beyond, end in ((-50.0, 0.0), (150.0, 100.0)):
        model.rigid_body.x[time] = beyond
        assert value(model.wind.velocity_x[time]) == pytest.approx(waves(end, 40.0)[0], abs=1e-9)
    refused = mission({"field": told.wind.field})
    line = unknown_wind(refused, np.array([1.5]), np.array([[-50.0, 40.0, 5.0]]))
    assert line.startswith("at 1.5 s the flight is at (-50, 40, 5) m, where wind.field = ")


@pytest.mark.lengthy
def test_a_forecast_is_a_field_of_its_own(tmp_path):
    true = field(tmp_path / "true.csv", waves, **GRID)
    told = field(tmp_path / "told.csv", lambda x, y: (2.0, 0.0), **GRID)
    scenario = mission({"field": true, "forecast": {"use": "calm", "field": told}})
    steady = mission({"use": "calm", "speed": 2.0})
    assert Planner().solve(scenario).energy == pytest.approx(
        Planner().solve(steady).energy, rel=1e-9
    )
    assert mean_wind(scenario.as_forecast()) == pytest.approx((2.0, 0.0), abs=1e-12)


@pytest.mark.slow
def test_a_plan_stays_within_the_field_although_better_wind_seems_to_blow_beyond_its_edge(tmp_path):
    def stronger_to_the_north(x, y):
        return (8.0 * (y - 30.0) / 12.0, 0.0)

    axes = {"x": np.linspace(0, 100, 11), "y": np.linspace(17, 41, 5)}
    file = field(tmp_path / "w.csv", stronger_to_the_north, **axes)
    ends = {
        "start": {"position": [10.0, 40.0, 5.0]},
        "goal": {"position": [90.0, 40.0, 5.0]},
        "duration": 14.0,
    }
    chosen = {"mission": ends, "solver": {"accuracy": "standard"}}
    inside = Planner().solve(mission({"field": file}, **chosen))
    assert inside.is_verified, inside.message
    way = inside.to_frame(50.0)["y_m"]
    assert way.max() == pytest.approx(41.0, abs=0.01)
    # The same field, known farther north, lets the plan go on; the edge can only cost energy.
    axes["y"] = np.linspace(17, 65, 9)
    wide = field(tmp_path / "wide.csv", stronger_to_the_north, **axes)
    outside = Planner().solve(mission({"field": wide}, **chosen))
    assert outside.to_frame(50.0)["y_m"].max() > 41.5
    assert outside.energy < inside.energy * (1.0 - 1e-4)
