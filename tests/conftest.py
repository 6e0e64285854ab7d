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
    """Keep every problem that a test process compiles, where a program keeps the last few."""
    from pyomo_quad.flight.caches import PROBLEMS

    PROBLEMS.capacity = 1000
