"""A run on one core and on two: the same flights, in the same order, and what became of each."""

import os

import numpy as np
import pandas as pd
import pytest

from pyomo_quad import processes
from pyomo_quad.collocation import SolveError
from pyomo_quad.scenario import Reference, load_scenario
from pyomo_quad.study import run

SHORT = (
    "mission.goal.position=[1.0, 0.0, 0.5]",
    "mission.duration=4.0",
    "solver.elements=20",
    "baseline.mpc.knowledge=[]",
)
REFERENCES = (Reference.STEP, Reference.QUINTIC, Reference.MINIMUM_SNAP)


@pytest.fixture
def runs(monkeypatch):
    """Give the run of each number of cores; one of its flights is beyond all control."""
    fly, acts = run.fly_baseline, []

    def flown_or_lost(scenario, reference, **known):
        if reference is Reference.QUINTIC:
            raise SolveError("out of control")
        return fly(scenario, reference, **known)

    monkeypatch.setattr(run, "fly_baseline", flown_or_lost)
    made = {}
    for cores in (1, 2):
        monkeypatch.setattr(processes, "cores", lambda most, cores=cores, **_: min(cores, most))
        made[cores] = run.run_scenario(
            load_scenario("scenarios/paper_wind.toml", SHORT),
            baselines=REFERENCES,
            meanwhile=lambda: acts.append(os.getpid()),
        )
    assert acts == [os.getpid()] * 2
    return made


@pytest.mark.lengthy
def test_two_cores_fly_what_one_does(runs):
    alone, together = runs[1], runs[2]
    names = ["optimal", "adaptive/step", "adaptive/minimum_snap", "open_loop/plan"]
    assert [flight.name for flight in alone.flights] == names
    assert [flight.name for flight in together.flights] == names
    pd.testing.assert_frame_equal(together.comparison, alone.comparison, rtol=1e-9)
    pd.testing.assert_frame_equal(together.adaptation, alone.adaptation, rtol=1e-9)
    for one, other in zip(alone.flights, together.flights, strict=True):
        np.testing.assert_allclose(other.frame, one.frame, rtol=1e-9, atol=1e-9)
    assert together.warnings == alone.warnings
    assert alone.warnings[-1] == "adaptive/quintic could not be flown: out of control"
    assert together.timings.keys() == alone.timings.keys()
