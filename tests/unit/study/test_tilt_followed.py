"""Plans tilt no further than their controller, or `check` and their cautions say by how much."""

from dataclasses import replace

import numpy as np

from pyomo_quad.study.check import plan_cautions
from tests import flights
from tests.command import QUICK

HOP = tuple(option.removeprefix("--set=") for option in QUICK)


def said(*overrides):
    found = flights.diagnosed(flights.scenario("paper_calm", *overrides))
    return [f.message for f in found if f.subject == "baseline.gains.tilt_max"]


def test_a_controller_that_tilts_less_than_plans_may_is_named():
    assert said() == []
    (message,) = said("baseline.gains.tilt_max=0.2")
    assert message.startswith("baseline.gains.tilt_max = 0.2 rad: plans may tilt by 0.6")
    assert message.endswith("and the controller would fall behind; leave it out.")


def test_a_plan_that_tilts_further_than_its_controller_says_by_how_much():
    plan = flights.plan("paper_calm", *HOP)
    assert not any("falls behind" in caution for caution in plan_cautions(plan))
    timid = replace(plan, scenario=plan.scenario.with_values({"baseline.gains.tilt_max": 0.001}))
    roll, pitch = (
        plan.trajectories.states[:, plan.trajectories.state_names.index(name)]
        for name in ("rigid_body.phi", "rigid_body.theta")
    )
    tilt = np.arccos((np.cos(roll) * np.cos(pitch)).min())
    (caution,) = [c for c in plan_cautions(timid) if "fall behind" in c and "the plan" in c]
    assert f"tilts by up to {tilt:.4g} rad, the controller by at most 0.001 rad" in caution
