"""Plans and controlled flights that several test files look at, each made once."""

from functools import cache

import numpy as np

from pyomo_quad.flight import Planner
from pyomo_quad.flight.baselines import fly_baseline
from pyomo_quad.flight.flight import POSITION_STATES
from pyomo_quad.scenario import load_scenario
from pyomo_quad.study.certificate import certify
from pyomo_quad.study.check import check_mission
from tests.command import SCENARIOS

# What it has compiled serves the next test whose vehicle is declared alike.
PLANNER = Planner()


@cache
def scenario(name, *overrides):
    return load_scenario(SCENARIOS / f"{name}.toml", overrides)


@cache
def plan(name, *overrides):
    return PLANNER.solve(scenario(name, *overrides))


@cache
def vehicle(name, *overrides):
    return PLANNER.dynamics(scenario(name, *overrides))


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


def certified(told):
    return certify(told, planner=PLANNER)


def diagnosed(told):
    return check_mission(told, planner=PLANNER)
