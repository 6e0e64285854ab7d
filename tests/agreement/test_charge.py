"""Plans of least charge beside plans of least energy, and what a run says of both."""

from dataclasses import replace
from itertools import islice
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import trapezoid

from pyomo_quad.flight.candidate import guess_from
from pyomo_quad.flight.mission_problem import MissionProblem
from pyomo_quad.flight.plan import trajectories_of
from pyomo_quad.model.battery import CHARGE_STATE
from pyomo_quad.scenario.mission import Aim
from pyomo_quad.study.aims import charge_drawn, disagreement, energy_and_charge
from tests.benchmarks.charge import missions, pairs
from tests.flights import PLANNER, plan, scenario

# Charge of a plan that is verified to 1e-6, relative.
ALIKE = 2e-6


def hold(found):
    for pair in found:
        plans = (pair.least_energy, pair.least_charge)
        assert all(one.is_verified for one in plans), pair.name
        assert charge_drawn(plans[1]) <= (1 + ALIKE) * charge_drawn(plans[0]), pair.name
        assert plans[0].energy <= (1 + ALIKE) * plans[1].energy, pair.name


@pytest.mark.lengthy
def test_the_plan_of_least_charge_draws_no_more_than_that_of_least_energy():
    (pair,) = pairs(islice(missions(), 1))
    hold([pair])
    # The charge is the integral of the current that the flight of the plan shows.
    frame = pair.least_charge.to_frame(1000.0)
    flown = trapezoid(frame["battery_current_A"], frame.index) / 3600
    assert charge_drawn(pair.least_charge) == pytest.approx(flown, rel=1e-5)


@pytest.mark.slow
def test_on_random_missions_the_least_charge_is_never_more():
    hold(pairs())


@pytest.mark.lengthy
def test_the_aim_changes_nothing_but_the_optimum():
    told = plan("paper_calm", "mission.aim='charge'")
    frame = told.to_frame(1000.0)
    energy = trapezoid(frame["power_W"], frame.index)
    assert told.is_verified
    assert told.energy == pytest.approx(energy, rel=1e-6)
    # The objective is the energy that the charge is worth at the pack's voltage of the start.
    full = 3 * (3.7348 - 0.00876 + 0.468)
    assert told.solution.objective == pytest.approx(3600 * full * charge_drawn(told), rel=1e-7)


@pytest.mark.lengthy
def test_a_run_compares_the_aims_and_says_where_they_part():
    fast = ("mission.duration=3.75", "vehicle.attitude='euler'", "solver.accuracy='standard'")
    found = energy_and_charge(plan("paper_calm", *fast), planner=PLANNER)
    assert found["aim"].tolist() == ["energy", "charge"]
    assert found["is_plan"].tolist() == [True, False]
    (least, more), (charge, least_charge) = found["energy_J"], found["charge_Ah"]
    assert least < more
    assert least_charge < charge
    apart = pd.DataFrame(found)
    apart.loc[0, "charge_Ah"] = 1.02 * least_charge
    (line,) = disagreement(apart)
    assert "draws 2 % more charge than necessary" in line
    assert 'mission.aim = "charge"' in line
    apart.loc[0, "charge_Ah"] = 1.004 * least_charge
    assert disagreement(apart) == ()


@pytest.mark.lengthy
@pytest.mark.parametrize("least", ["energy", "charge"])
def test_a_plan_for_the_other_aim_that_is_worse_in_it_is_no_optimum(least, monkeypatch):
    fast = ("mission.duration=3.75", "vehicle.attitude='euler'", "solver.accuracy='standard'")
    aims = {aim: plan("paper_calm", f"mission.aim='{aim}'", *fast) for aim in ("energy", "charge")}
    (given,) = (one for aim, one in aims.items() if aim != least)
    poor = worsened(aims[least])
    monkeypatch.setattr("pyomo_quad.study.aims.planned_alike", lambda *_, **__: poor)
    assert energy_and_charge(given, planner=PLANNER).empty


def worsened(found):
    """Return a plan that needs more energy, more charge and more of its objective."""
    held, more = found.trajectories, 1.02
    column = held.state_names.index(CHARGE_STATE)
    states = held.states.copy()
    states[:, column] = states[0, column] + more * (states[:, column] - states[0, column])
    return replace(
        found,
        energy=more * found.energy,
        trajectories=replace(held, states=states),
        solution=SimpleNamespace(
            objective=more * found.solution.objective, status=found.solution.status
        ),
    )


@pytest.mark.lengthy
def test_a_plan_of_chosen_times_begins_a_solve_for_another_aim_at_these_times():
    told = scenario(
        "paper_calm",
        "mission.duration='free'",
        "mission.waypoints=[{position=[3.0, 1.0, 4.0], hold=1.5}, {position=[4.0, 5.0, 6.0]}]",
        "vehicle.attitude='euler'",
        "solver.accuracy='quick'",
    )
    found, other = PLANNER.solve(told), told.with_mission(aim=Aim.CHARGE)
    guess, held = guess_from(found, other), found.trajectories
    start = MissionProblem(PLANNER, other).unsolved(mesh=found.warm_start.mesh, guess=guess)
    assert start.horizon == pytest.approx(held.horizon)
    for k, reached in enumerate(found.passing_times_s):
        assert start.value("mission.passing_time", index=k) == pytest.approx(reached)
    begun = trajectories_of(start)
    for name in ("rigid_body.x", "rigid_body.vz", "rigid_body.theta"):
        planned = held.states_at(begun.node_times)[:, held.state_names.index(name)]
        # The guess is linear between the nodes of the plan.
        nearly = pytest.approx(planned, abs=0.02 * np.ptp(planned))
        assert begun.states[:, begun.state_names.index(name)] == nearly


def test_the_papers_own_missions_and_least_time_have_no_other_aim():
    assert energy_and_charge(plan("paper_calm"), planner=PLANNER).empty
    assert scenario("paper_calm").mission.aim == "energy"
