"""Settings of all tests."""

import gc
import os

import pytest
from hypothesis import settings

# Two processes share the cores already: further threads of BLAS only wait for each other.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# What tests hold grows to millions of objects, which Python would look through every 700 new ones.
gc.set_threshold(100_000, 50, 50)

# How long an example takes says more about the machine than about the code.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


@pytest.fixture(scope="session", autouse=True)
def _compiled_once():
    """Let all planners of a test process share what they compile from the declared model."""
    from pyomo_quad.flight import Planner, planning
    from pyomo_quad.model import build_model

    shared, problem_for = Planner(), Planner.problem_for

    def from_shared(planner, scenario):
        return problem_for(shared if planner.builder is build_model else planner, scenario)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(planning, "_KEPT", 1000)
        patch.setattr(Planner, "problem_for", from_shared)
        yield
