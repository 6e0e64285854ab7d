"""Plans and controlled flights that several test files look at, each made once."""

from functools import cache

import numpy as np

from pyomo_quad.flight import Planner
from pyomo_quad.flight.baselines import fly_baseline
from pyomo_quad.flight.flight import POSITION_STATES
from pyomo_quad.scenario import load_scenario
from tests.command import SCENARIOS


@cache
def scenario(name, *overrides):
    return load_scenario(SCENARIOS / f"{name}.toml", overrides)


@cache
def planner():
    return Planner()


@cache
def plan(name, *overrides):
    return planner().solve(scenario(name, *overrides))


@cache
def vehicle(name, *overrides):
    return planner().dynamics(scenario(name, *overrides))


@cache
def baseline(name, reference, *overrides):
    """Fly a baseline of a scenario in its own wind."""
    mission = scenario(name, *overrides)
    return fly_baseline(
        mission, reference, dynamics=vehicle(name, *overrides), plan=plan(name, *overrides)
    )


def positions(dynamics, states):
    return states[:, [dynamics.state_names.index(name) for name in POSITION_STATES]]


def distances(dynamics, states, place):
    return np.linalg.norm(positions(dynamics, states) - place, axis=1)
