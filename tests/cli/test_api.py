"""The public names: what a script imports."""

import gc
import json
import os
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import pyomo_quad
import pyomo_quad.cli
from tests.command import PAPER_CALM, QUICK


@pytest.fixture(scope="module")
def plan():
    scenario = pyomo_quad.load_scenario(
        PAPER_CALM, ["mission.duration = 4.0", "mission.goal.position = [1.0, 0.0, 0.5]"]
    )
    return pyomo_quad.solve(scenario)


def test_plan_answers(plan):
    assert plan.is_verified
    assert plan.energy > plan.hover_energy_J
    assert plan.to_frame()["x_m"].iloc[-1] == pytest.approx(1.0, abs=1e-9)
    # Time reversed, the flight leads back: half the way at half the time, nearly.
    assert plan.at(2.0)["x_m"] == pytest.approx(0.5, abs=1e-2)
    row = plan.to_frame(rate_hz=1.0).iloc[2]
    pd.testing.assert_series_equal(plan.at(2.0), row, check_names=False, rtol=1e-12, atol=1e-12)


def test_a_plan_gives_a_frame_at_several_times(plan):
    frame = plan.at([1, 2, 3])
    pd.testing.assert_frame_equal(frame, plan.at(np.array([1.0, 2.0, 3.0])))
    assert frame.index.name == "time_s"
    assert frame.index.tolist() == [1.0, 2.0, 3.0]
    for k, time in enumerate((1, 2, 3)):
        pd.testing.assert_series_equal(frame.iloc[k], plan.at(time), check_names=False)
    with pytest.raises(pyomo_quad.scenario.ScenarioError, match=r"t = 5 s is outside the flight"):
        plan.at([1, 5])


def test_frames_have_a_named_time_index(plan):
    whole, costates = plan.to_frame(rate_hz=10.0), plan.costate_frame()
    assert whole.index.name == costates.index.name == "time_s"
    assert "time_s" not in whole
    # The energy is the integral of the power over the index.
    spent = np.trapezoid(plan.to_frame(1000.0)["power_W"], plan.to_frame(1000.0).index)
    assert spent == pytest.approx(plan.energy, rel=1e-5)


def test_a_plan_becomes_a_dataset_with_units(plan):
    data = plan.to_xarray(rate_hz=10.0)
    assert list(data.dims) == ["time_s"]
    assert data.sel(time_s=1.0).x_m == pytest.approx(plan.at(1.0)["x_m"])
    assert data.phi_rad.attrs["units"] == "rad"
    assert data.motor_1_torque_N_m.attrs["units"] == "N m"
    assert data.attrs["energy_J"] == plan.energy


@pytest.mark.lengthy
def test_a_plan_draws_and_writes_its_figures(plan, tmp_path):
    picture = plan.plot()
    assert picture.name == "path"
    assert picture.save(tmp_path / "path.png").read_bytes().startswith(b"\x89PNG")
    (line, *_), power = plan.plot("power_W").figure.axes[0].lines, plan.flight().frame["power_W"]
    assert np.array_equal(line.get_ydata(), power)
    with pytest.raises(pyomo_quad.scenario.ScenarioError, match=r'^what = "bar"; must be one of p'):
        plan.plot("bar")
    with pytest.raises(pyomo_quad.scenario.ScenarioError, match=r"path\.gif: must end in \.png, "):
        picture.save(tmp_path / "path.gif")


def test_a_plan_writes_the_report_of_the_command(plan, tmp_path):
    page = plan.report(tmp_path / "hop", figures="none")
    summary = json.loads((page.parent / "summary.json").read_text(encoding="utf-8"))
    assert summary["energy_J"] == plan.energy
    again = pyomo_quad.Plan.load(page.parent / "plan.npz")
    assert again.energy == plan.energy
    with pytest.raises(pyomo_quad.scenario.ScenarioError, match='figures = "gif"; must be one of '):
        plan.report(tmp_path / "hop", figures="gif")


@pytest.mark.lengthy
def test_a_run_becomes_a_file_that_others_read(plan, tmp_path):
    result = pyomo_quad.run_scenario(plan.scenario, baselines=[])
    result.save(tmp_path / "hop.nc")
    with xr.open_dataset(tmp_path / "hop.nc") as data:
        names = data.flight.to_numpy().tolist()
        assert names == [flight.name for flight in result.flights]
        spent = data.energy_J.sel(flight="optimal").dropna("sample")[-1]
        assert spent == pytest.approx(float(data.total_energy_J.sel(flight="optimal")))
        assert data.attrs["lower_bound_J"] == result.certificate.lower_bound_J
    frame = result.to_frame()
    assert frame.index.names == ["flight", "time_s"]
    assert frame.loc["optimal"]["energy_J"].iloc[-1] == pytest.approx(plan.energy, rel=1e-6)
    assert result.report(tmp_path / "hop", figures="none").name == "report.html"
    assert result.plot("energy").name == "energy"


def test_a_scenario_is_changed_by_tables_and_by_paths(plan):
    slower = plan.scenario.replace({"mission": {"duration": 6.0}, "vehicle.payload": 0.1})
    assert (slower.mission.duration, slower.vehicle.payload) == (6.0, 0.1)
    # Fields that no change names are kept.
    assert slower.mission.goal == plan.scenario.mission.goal
    assert plan.scenario.mission.duration == 4.0
    with pytest.raises(pyomo_quad.scenario.ScenarioError, match=r"unknown key mission\.durations"):
        plan.scenario.replace({"mission": {"durations": 6.0}})


def test_plan_survives_its_file(plan, tmp_path):
    plan.save(tmp_path / "hop.npz")
    again = pyomo_quad.Plan.load(tmp_path / "hop.npz")
    assert (again.energy, again.status) == (plan.energy, plan.status)
    assert again.scenario == plan.scenario
    assert np.array_equal(again.trajectories.states, plan.trajectories.states)


def test_model_is_pyomo(plan):
    model = pyomo_quad.build_model(plan.scenario)
    assert model.rigid_body.roll_balance.is_constructed()


def test_a_path_is_a_scenario(tmp_path):
    with pytest.raises(pyomo_quad.scenario.ScenarioError, match=r"no\.toml: cannot be read"):
        pyomo_quad.solve(tmp_path / "no.toml")


def test_nested_mappings_are_a_scenario():
    mission = {"goal": {"position": [1.0, 0.0, 0.5]}, "duration": 4.0}
    with pytest.raises(pyomo_quad.scenario.ScenarioError, match=r"unknown key mission\.durations"):
        pyomo_quad.solve({"name": "hop", "mission": mission | {"durations": 4.0}})


def test_only_public_names_are_shown():
    assert dir(pyomo_quad) == sorted(pyomo_quad.__all__)
    assert all(getattr(pyomo_quad, name) is not None for name in pyomo_quad.__all__)


def test_unknown_name():
    with pytest.raises(AttributeError, match="module 'pyomo_quad' has no attribute 'fly'"):
        _ = pyomo_quad.fly


def modules_after(program):
    """Return what a new Python has imported once it has run a program."""
    done = subprocess.run(
        [sys.executable, "-c", f"{program}\nimport sys; print(*sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
    )
    return set(done.stdout.split())


def test_importing_the_package_imports_no_solver():
    slow = {"pyomo", "casadi", "cyipopt", "scipy", "pandas", "numpy", "pydantic"}
    assert slow.isdisjoint(modules_after("import pyomo_quad"))


@pytest.mark.lengthy
def test_naming_the_commands_imports_no_solver():
    slow = {"pyomo", "pint", "casadi", "cyipopt", "scipy", "pandas", "matplotlib", "plotly"}
    assert slow.isdisjoint(modules_after("import pyomo_quad.cli.commands"))


@pytest.mark.lengthy
def test_a_solve_without_figures_imports_only_what_it_uses(tmp_path):
    arguments = ["solve", PAPER_CALM, *QUICK, "--quiet", "--figures", "none", "--out"]
    program = (
        "from pyomo_quad.cli import main, startup\nstartup.own_process()\n"
        f"main({[*arguments, str(tmp_path / 'report')]!r})"
    )
    draws = {"matplotlib", "plotly", "PIL", "markdown_it"}
    slow = {"pandas", "pyarrow", "scipy.stats", "scipy.interpolate", "pyomo.environ"}
    unused = {"scipy.ndimage"}
    assert (draws | slow | unused).isdisjoint(modules_after(program))
    summary = json.loads((tmp_path / "report" / "summary.json").read_text(encoding="utf-8"))
    assert all(seconds > 0 for seconds in summary["wall_s"].values())
    assert not (tmp_path / "report" / "figures").exists()


def test_a_callers_garbage_collector_stays_as_it_is(capsys):
    before = gc.get_threshold(), gc.get_freeze_count()
    assert pyomo_quad.cli.main(["--version"]) == 0
    assert (gc.get_threshold(), gc.get_freeze_count()) == before


@pytest.mark.parametrize(("told", "kept"), [(None, "1"), ("2", "2")])
def test_the_command_keeps_blas_to_one_thread_unless_told(monkeypatch, told, kept):
    monkeypatch.setattr(os, "environ", {} if told is None else {"OMP_NUM_THREADS": told})
    seen = []
    monkeypatch.setattr("pyomo_quad.cli.commands.main", lambda _: seen.append(dict(os.environ)))
    for name in ("end_on_signals", "leave"):
        monkeypatch.setattr(pyomo_quad.cli, name, lambda *_: 0)
    monkeypatch.setattr(gc, "set_threshold", lambda *_: None)
    pyomo_quad.cli.main()
    assert seen == [{"OMP_NUM_THREADS": kept}]


def test_unknown_figures_are_refused(capsys):
    assert pyomo_quad.cli.main(["run", PAPER_CALM, "--figures", "gif"]) == 2
    assert "'gif' is not one of 'svg', 'png', 'all', 'none'" in capsys.readouterr().err


@pytest.mark.slow
def test_pyomo_still_finds_what_it_was_kept_from():
    program = (
        "import pyomo_quad.cli.solving\n"
        "from pyomo.common.dependencies import scipy, scipy_available\n"
        "if not scipy_available or scipy.stats.norm.cdf(0.0) != 0.5: raise SystemExit(1)"
    )
    assert "scipy.stats" in modules_after(program)


@pytest.mark.slow
def test_units_made_before_and_after_the_import_belong_together():
    program = (
        "from pyomo.environ import units\n"
        "before = units.km\n"
        "import pyomo_quad.collocation\n"
        "if units.convert_value(1.0, before, units.m) != 1000.0: raise SystemExit(1)"
    )
    modules_after(program)


@pytest.mark.slow
@pytest.mark.parametrize("cache", ["/dev/null/none", "rubbish"])
def test_units_need_no_cache(cache, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", cache if cache.startswith("/") else str(tmp_path))
    use = (
        "import pyomo_quad.collocation\n"
        "from pyomo.environ import units\n"
        "if units.convert_value(1.0, units.hr, units.s) != 3600.0: raise SystemExit(1)"
    )
    modules_after(use)
    for file in tmp_path.rglob("*.*"):
        file.write_text(cache, encoding="utf-8")
    modules_after(use)


def test_public_names_are_listed():
    assert set(pyomo_quad.__all__) <= set(dir(pyomo_quad))
    assert all(getattr(pyomo_quad, name) is not None for name in dir(pyomo_quad))
