"""Real cases: pure functions of their task, and as good as independent solves."""

import pandas as pd
import pytest

from pyomo_quad.flight import solve_scenario
from pyomo_quad.sweep import design_sweep, load_study, process_workers
from pyomo_quad.sweep.design import expand
from pyomo_quad.sweep.runner import FLIGHT_SOLVER
from tests.sweep.studies import write_study
from tests.sweep.sweeping import Here, rows, sweep

AXES = """
[[axis]]
path = "mission.duration"
values = [9.0, 11.0]

[[axis]]
path = "wind.speed"
values = [0.0, 1.5]
"""
COARSE = "fixed.solver = { elements = 12, degree = 5, tolerance = 1e-5 }"


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    return write_study(tmp_path_factory.mktemp("study"), AXES, COARSE)


@pytest.fixture(scope="module")
def solved_here(study):
    folder = study.parent / "here"
    sweep(study, folder, Here(), solver=FLIGHT_SOLVER)
    return rows(folder)


@pytest.mark.lengthy
def test_all_cases_are_verified(solved_here):
    assert list(solved_here["status"]) == ["finished"] * 4
    assert (solved_here["excess_energy_J"] > 0.0).all()


@pytest.mark.slow
def test_rows_are_the_same_numbers_from_two_processes(study, solved_here):
    folder = study.parent / "two"
    with process_workers(2) as workforce:
        sweep(study, folder, workforce, solver=FLIGHT_SOLVER)
    # Other processes may round otherwise.
    pd.testing.assert_frame_equal(rows(folder), solved_here, rtol=1e-6)


@pytest.mark.lengthy
def test_a_warm_start_changes_an_optimum_by_no_more_than_the_tolerance(study, solved_here):
    loaded = load_study(study)
    for case in expand(design_sweep(loaded))[::3]:
        alone = solve_scenario(loaded.base.with_values(case.overrides))
        assert solved_here["energy_J"][case.position] == pytest.approx(alone.energy, rel=1e-5)


@pytest.mark.lengthy
def test_baselines_of_a_case_are_flown_beside_its_plan(tmp_path):
    one = '[[axis]]\npath = "mission.duration"\nvalues = [10.0]\n'
    study = write_study(tmp_path, one, f'baselines = ["quintic"]\n{COARSE}')
    sweep(study, tmp_path / "out", Here(), solver=FLIGHT_SOLVER)
    (row,) = rows(tmp_path / "out").to_dict("records")
    assert row["status"] == "finished"
    settled = row["quintic_energy_J"] + row["quintic_owed_energy_J"]
    saving = 100.0 * (1.0 - row["energy_J"] / settled)
    # The energies are written with nine digits, of which the saving needs the last.
    assert row["saving_over_quintic_percent"] == pytest.approx(saving, abs=1e-6)
    assert 0.0 < saving < 20.0


@pytest.mark.lengthy
def test_a_plan_flown_in_another_world_than_its_own_misses_and_costs_more(tmp_path):
    masses = '[[axis]]\npath = "vehicle.mass"\nvalues = [1.3, 1.4]\n'
    study = write_study(tmp_path, masses, f'task = "fly_plan"\n{COARSE}')
    sweep(study, tmp_path / "out", Here(), solver=FLIGHT_SOLVER)
    as_planned, heavier = rows(tmp_path / "out").to_dict("records")
    assert as_planned["terminal_miss_m"] < heavier["terminal_miss_m"]
    assert as_planned["energy_J"] == pytest.approx(as_planned["planned_energy_J"], rel=1e-3)
    # Hover power goes with the weight to the power 3/2.
    expected = as_planned["energy_J"] * (1.4 / 1.3) ** 1.5
    assert heavier["energy_J"] == pytest.approx(expected, rel=1e-2)


@pytest.mark.slow
def test_a_case_that_cannot_be_flown_is_a_failed_row(tmp_path):
    # 11.8 m in 1.5 s is beyond thrust and rotor limits.
    hopeless = '[[axis]]\npath = "mission.duration"\nvalues = [1.5]\n'
    study = write_study(tmp_path, hopeless, COARSE.replace("}", ", max_iterations = 60 }"))
    sweep(study, tmp_path / "out", Here(), solver=FLIGHT_SOLVER)
    (row,) = rows(tmp_path / "out").to_dict("records")
    assert row["status"] == "failed"
    assert row["reason"].startswith(("infeasible: ", "not_converged: "))
