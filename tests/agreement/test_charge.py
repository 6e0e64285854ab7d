"""Plans of least charge beside plans of least energy, and what a run says of both."""

from itertools import islice

import pandas as pd
import pytest
from scipy.integrate import trapezoid

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


def test_the_papers_own_missions_and_least_time_have_no_other_aim():
    assert energy_and_charge(plan("paper_calm"), planner=PLANNER).empty
    assert scenario("paper_calm").mission.aim == "energy"
