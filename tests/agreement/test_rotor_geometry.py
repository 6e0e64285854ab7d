"""Rotors by number and place: the mixer and all that follows from it, against the flat writing."""

import numpy as np
import pytest

from pyomo_quad.flight.controller import mixer_matrix
from pyomo_quad.scenario import Reference, ScenarioError, load_scenario
from pyomo_quad.study.run import run_scenario
from tests.agreement import plain_quadrotor as plain
from tests.command import PAPER_CALM
from tests.declared_model import RIGID_BODY, scenario
from tests.flights import PLANNER

AGREEMENT = 1e-11
AIR = {"rotor_drag_plane": 1.2e-4, "rotor_drag_axis": 2.3e-4, "translational_lift": 3e-3}


def ring(count, radius=0.25):
    """Rotors at equal angles, none ahead, that turn alternately."""
    angles = np.pi / count + 2 * np.pi * np.arange(count) / count
    places = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return places.round(6).tolist(), [1 - 2 * (j % 2) for j in range(count)]


UNEQUAL = ([[0.3, 0.2], [-0.1, 0.2], [-0.3, -0.2], [0.1, -0.2]], [-1, 1, -1, 1])


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("rotors", "air"), [(ring(4), {}), (UNEQUAL, AIR), (ring(6), AIR), (ring(8), {})]
)
def test_state_derivative_of_other_rotors(rotors, air, monkeypatch):
    places, spins = rotors
    monkeypatch.setattr(plain, "POSITIONS", np.array([[*place, 0.0] for place in places]))
    monkeypatch.setattr(plain, "SPIN", np.array(spins, dtype=float))
    told = scenario(vehicle={"rotor_positions": places, "rotor_spins": spins} | air)
    dynamics = PLANNER.dynamics(told)
    names = list(dynamics.state_names)
    body = [names.index(f"rigid_body.{name}") for name in RIGID_BODY]
    speeds = [names.index(f"rotors.omega[{j}]") for j in range(1, len(places) + 1)]
    short = {"plane": "rotor_drag_plane", "axis": "rotor_drag_axis", "lift": "translational_lift"}
    numbers = {name: air[field] for name, field in short.items()} if air else None
    generator = np.random.default_rng(6)
    for _ in range(20):
        states = np.zeros(len(names))
        states[body] = generator.uniform(-1.0, 1.0, 12)
        states[speeds] = generator.uniform(50.0, 1047.0, len(places))
        alpha = generator.uniform(-3000.0, 3000.0, len(places))
        expected = plain.rates(
            states[body], states[speeds], alpha, np.zeros(3), is_exact=True, rotor_air=numbers
        )
        found = dynamics.rates(0.0, states, alpha)[[*body, *speeds]]
        scale = np.maximum(np.abs(expected), plain.GRAVITY)
        assert np.max(np.abs(found - expected) / scale) < AGREEMENT


def test_the_papers_cross_written_as_places_is_the_papers_vehicle():
    arm = plain.ARM
    cross = [[arm, 0.0], [0.0, arm], [-arm, 0.0], [0.0, -arm]]
    placed, papers = scenario(vehicle={"rotor_positions": cross}), scenario()
    mixers = [mixer_matrix(PLANNER.dynamics(told)) for told in (placed, papers)]
    np.testing.assert_allclose(*mixers, rtol=1e-14, atol=1e-20)
    assert placed.limits == papers.limits
    assert placed.vehicle.hover_speed(9.81) == papers.vehicle.hover_speed(9.81)


@pytest.mark.slow
def test_a_hexacopter_is_planned_followed_and_certified():
    places, _ = ring(6)
    changes = {"vehicle.rotor_positions": places, "vehicle.attitude": "euler"}
    changes |= {"mission.goal.yaw": 0.5, "solver.tolerance": 1e-3, "limits.reserve": 0.1}
    told = load_scenario(PAPER_CALM, changes)
    result = run_scenario(told, baselines=[Reference.PLAN])
    assert result.plan.is_verified
    assert result.comparison["arrived"].all()
    assert result.comparison["limits_kept"].all()
    assert 0.0 < result.certificate.gap_percent(result.plan.energy) < 0.5
    assert "omega_6_rad_per_s" in result.plan.to_frame(rate_hz=10)
    # Shaft power of hover goes with thrust^1.5 of each rotor: six share what four did.
    four, six = (
        PLANNER.steady_flight(one.with_values({"power.model": "shaft"})).hover_power
        for one in (load_scenario(PAPER_CALM), told)
    )
    assert six == pytest.approx(four * (4 / 6) ** 0.5, rel=1e-9)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rotor_positions": ring(6)[0][:5]}, r"must each add up to zero"),
        ({"rotor_positions": [[0.2, 0.0]]}, r"rotor_positions has 1 rotors; must have 4 to 8"),
        ({"rotor_spins": [1, -1, 1]}, r"must give 1 or -1 for each of the 4 rotors"),
        (
            {"rotor_positions": [[0.2, 0.0], [-0.2, 0.0]] * 2},
            r"cannot turn the vehicle",
        ),
        ({"rotor_positions": ring(4)[0], "rotor_spins": [1, -1, -1, 1]}, r"about every axis"),
        ({"rotor_spins": [1, 1, 1, -1]}, r"must each add up to zero"),
        ({"rotor_spins": [2, -2, 2, -2]}, r"must give 1 or -1"),
        ({"rotor_positions": ring(4, 1e5)[0]}, r"reach 100000 m; must reach 0.001 to 100 m"),
    ],
)
def test_rotors_that_cannot_hover_at_one_speed(changes, message):
    fields = {f"vehicle.{name}": value for name, value in changes.items()}
    with pytest.raises(ScenarioError, match=message):
        load_scenario(PAPER_CALM, fields)
