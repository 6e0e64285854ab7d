"""Dynamics of scenarios that differ in their duration only."""

import numpy as np
import pytest

from pyomo_quad.flight import problems
from pyomo_quad.flight.caches import Recent
from pyomo_quad.flight.problems import Problems
from pyomo_quad.model import build_model
from pyomo_quad.scenario import load_scenario
from tests.command import SCENARIOS


@pytest.fixture
def counted(monkeypatch):
    """Return a function that makes problems without a cache, and the list of models they build."""
    built = []

    def build(scenario):
        built.append(scenario)
        return build_model(scenario)

    monkeypatch.setattr(problems, "build_model", build)

    def fresh():
        monkeypatch.setattr(problems, "PROBLEMS", Recent(4))
        return Problems(build)

    return fresh, built


@pytest.mark.lengthy
def test_dynamics_of_another_duration_need_no_other_model(counted):
    fresh, built = counted
    told = load_scenario(SCENARIOS / "paper_wind.toml")
    longer = told.with_values({"mission.duration": 14.0})
    one = fresh()
    one.dynamics(told)
    reused = one.dynamics(longer)
    assert built == [told]
    new = fresh().dynamics(longer)
    assert reused.state_names == new.state_names
    assert reused.initial_states() == pytest.approx(new.initial_states())
    random = np.random.default_rng(5)
    for t in (0.0, 6.0, 13.5):
        states = random.normal(size=len(new.state_names))
        controls = random.normal(size=len(new.control_names))
        assert reused.rates(t, states, controls) == pytest.approx(new.rates(t, states, controls))


def test_dynamics_of_another_payload_start_at_their_own_rotor_speeds(counted):
    fresh, built = counted
    told = load_scenario(SCENARIOS / "paper_wind.toml")
    loaded = told.with_values({"vehicle.payload": 0.1})
    one = fresh()
    before = one.dynamics(told).initial_states()
    after = one.dynamics(loaded).initial_states()
    assert built == [told, loaded]
    assert after["rotors.omega[1]"] > before["rotors.omega[1]"] * 1.001
