"""Flyable trajectories by feedback along a coarse solution, and limits that become stricter."""

import numpy as np
import pytest

from pyomo_quad.collocation import Mesh
from pyomo_quad.flight import Planner, tracking
from pyomo_quad.flight.baselines import declared_start
from pyomo_quad.flight.integration import discrete
from pyomo_quad.flight.mission_problem import MissionProblem
from pyomo_quad.flight.stricter_limits import _least_energy, broken_limits, within_limits
from pyomo_quad.flight.verdict import energy_of, plan_of, verified
from pyomo_quad.scenario import load_scenario
from pyomo_quad.scenario.accuracy import FIGURES, USABLE, Accuracy
from tests.command import PAPER_CALM

PROVEN_J = 709.65279
SLOW = ["mission.goal.position=[4.0, 0.0, 1.0]", "mission.duration=6.0"]


@pytest.fixture(scope="module")
def planner():
    return Planner()


@pytest.fixture(scope="module")
def coarse(planner):
    """Scenario, solution on four elements, and its plan."""
    told = load_scenario(PAPER_CALM)
    solution = MissionProblem(planner, told).solve(mesh=Mesh.uniform(4, 4), tolerance=None)
    return told, solution, plan_of(told, solution, {}, 0.0)


def numerical_slopes(dynamics, t, x, u):
    """Derivatives of the rates by states and controls, by central differences."""
    joint, columns = np.append(x, u), []
    for k in range(joint.size):
        step = 1e-5 * max(1.0, abs(joint[k]))
        ends = []
        for side in (1.0, -1.0):
            moved = joint.copy()
            moved[k] += side * step
            ends.append(dynamics.rates(t, moved[: x.size], moved[x.size :]))
        columns.append((ends[0] - ends[1]) / (2.0 * step))
    found = np.array(columns).T
    return found[:, : x.size], found[:, x.size :]


def test_the_regulator_is_the_least_squares_solution_of_all_corrections_at_once(coarse):
    _, _, plan = coarse
    dynamics, path = plan.dynamics, plan.trajectories
    borders = np.linspace(*path.horizon, 9)
    regulator = tracking._regulator(dynamics, path, borders)
    middle, steps = 0.5 * (borders[1:] + borders[:-1]), np.diff(borders)
    states, controls = path.states_at(middle), path.controls_at(middle)
    pairs = zip(middle, states, controls, strict=True)
    A, B = map(np.array, zip(*(numerical_slopes(dynamics, *at) for at in pairs), strict=True))
    transitions, driven = discrete(A, B, steps)
    n_x, n_u, n = A.shape[1], B.shape[2], len(steps)
    weight = np.sqrt([tracking._weight(name) for name in dynamics.state_names])
    start = np.where(weight > 0.0, 0.3 / np.maximum(weight, 1e-12), 0.0)
    random = np.random.default_rng(5)
    disturbances = 0.1 * start * random.normal(size=(n, n_x))
    commands = tracking._anticipating(regulator, disturbances)
    # All deviations are linear in the start and in the stacked corrections.
    free, forced = [start], [np.zeros((n_x, n * n_u))]
    for k, (F, G) in enumerate(zip(transitions, driven, strict=True)):
        free.append(F @ free[-1] + disturbances[k])
        moved = F @ forced[-1]
        moved[:, k * n_u : (k + 1) * n_u] += G
        forced.append(moved)
    shares = np.sqrt(np.append(steps, tracking._AT_THE_END))
    rows = [s * weight[:, None] * m for s, m in zip(shares, forced, strict=True)]
    wanted = [-s * weight * f for s, f in zip(shares, free, strict=True)]
    # The rate of the yaw angle is linear in the deviation, too.
    turning = A[:, dynamics.state_names.index("rigid_body.psi")] / tracking._TURNING
    turned = zip(shares, turning, forced, free, strict=False)
    for s, a, m, f in turned:
        rows.append(s * (a @ m)[None, :])
        wanted.append(-s * np.array([a @ f]))
    price = np.repeat(np.sqrt(steps), n_u) / tracking._CORRECTION
    best, *_ = np.linalg.lstsq(
        np.vstack([*rows, np.diag(price)]), np.append(np.concatenate(wanted), np.zeros(n * n_u))
    )
    deviation = start
    for k, (F, G) in enumerate(zip(transitions, driven, strict=True)):
        correction = commands[k] - regulator.gains[k] @ deviation
        expected = best[k * n_u : (k + 1) * n_u]
        assert correction == pytest.approx(expected, rel=1e-4, abs=1e-4 * np.abs(best).max())
        deviation = F @ deviation + G @ correction + disturbances[k]


def test_a_flight_that_anticipates_its_deviations_keeps_nearer_to_its_path(coarse):
    _, _, plan = coarse
    dynamics, path = plan.dynamics, plan.trajectories
    first = tracking.tracked(dynamics, path)
    second = tracking.tracked(dynamics, path, previous=first)
    weights = np.array([tracking._weight(name) for name in dynamics.state_names])
    borders = np.asarray(first.mesh.breakpoints) * (path.horizon[1] - path.horizon[0])
    costs = [
        np.sum(weights * (flown.states_at(borders) - path.states_at(borders)) ** 2)
        for flown in (first, second)
    ]
    assert costs[1] < 0.8 * costs[0]


def test_a_coarse_solution_can_be_flown_once_feedback_corrects_it(coarse):
    _, solution, plan = coarse
    raw = verified(plan, solution, Accuracy.PROOF).verification
    asked = Accuracy.QUICK
    corrected = verified(plan, solution, asked)
    assert raw.reached is None
    assert corrected.verification.reached is asked
    # Flown by SciPy without feedback it arrives, and no flight that arrives spends less than the
    # optimum.
    assert corrected.verification.terminal_miss_m <= FIGURES[asked].miss
    assert corrected.verification.flown_energy_J >= PROVEN_J * (1.0 - FIGURES[asked].energy)
    assert corrected.energy == pytest.approx(corrected.verification.flown_energy_J, rel=1e-6)


def test_the_corrected_flight_starts_as_planned_and_keeps_the_limits_of_controls(coarse):
    _, _, plan = coarse
    flown = tracking.tracked(plan.dynamics, plan.trajectories)
    assert flown.states[0] == pytest.approx(plan.trajectories.states[0])
    assert set(plan.mesh.breakpoints) <= set(flown.mesh.breakpoints)
    low, high = plan.dynamics.control_limits()
    assert np.all((flown.controls >= low) & (flown.controls <= high))
    assert np.all(np.diff(flown.energy) > 0.0)


def test_a_flight_that_breaks_a_limit_slightly_is_solved_again_within_a_stricter_one(planner):
    asked = Accuracy.QUICK
    wide, told = (
        load_scenario(PAPER_CALM, [*SLOW, f"limits.speed_max={speed}"]) for speed in (1.06, 1.0)
    )
    mission = MissionProblem(planner, told)
    relaxed = MissionProblem(planner, wide).solve(mesh=Mesh.uniform(8, 4), tolerance=None)
    own = mission.unsolved(mesh=relaxed.mesh, guess=relaxed.trajectory)

    def fly(solution, least=None):
        return verified(plan_of(told, solution, {}, 0.0), solution, asked, least)

    # Feedback alone would keep the limit: the flight without it breaks it.
    before = verified(plan_of(told, own, {}, 0.0), own, Accuracy.PROOF)
    (breach,) = broken_limits(before, FIGURES[asked])
    assert breach.name.startswith("limits.speed_limit")
    after = next(within_limits(mission, own, before, FIGURES[asked], fly))
    assert not broken_limits(after, FIGURES[asked])
    assert after.verification.is_usable


def test_a_limit_as_strict_as_would_exclude_the_start_is_not_tried(planner):
    wide = load_scenario(PAPER_CALM)
    hover = declared_start(wide, planner.dynamics(wide))["rotors.omega[1]"]
    told = load_scenario(PAPER_CALM, [f"limits.rotor_speed_max={1.0001 * hover}"])
    relaxed = MissionProblem(planner, wide).solve(mesh=Mesh.uniform(8, 4), tolerance=None)
    mission = MissionProblem(planner, told)
    own = mission.unsolved(mesh=relaxed.mesh, guess=relaxed.trajectory)
    before = verified(plan_of(told, own, {}, 0.0), own, Accuracy.PROOF)
    assert any(b.name.startswith("limits.rotor_speed") for b in broken_limits(before, USABLE))
    assert not list(within_limits(mission, own, before, USABLE, lambda *_: before))


@pytest.mark.lengthy
def test_the_least_energy_is_between_a_relaxed_and_a_stricter_optimum(planner):
    solved = {}
    for speed in (1.02, 1.0, 0.985):
        told = load_scenario(PAPER_CALM, [*SLOW, f"limits.speed_max={speed}"])
        mission = MissionProblem(planner, told)
        solved[speed] = mission.solve(mesh=Mesh.uniform(12, 5), tolerance=None)
    low, exact, high = (energy_of(told, solved[s]) for s in (1.02, 1.0, 0.985))
    name = "limits.speed_max"
    found = _least_energy(mission, solved[1.02], solved[0.985], {name: -0.015}, {name: 0.02})
    assert low < exact < high
    # Linear to first order: the error is a small part of the difference.
    assert found == pytest.approx(exact, abs=0.1 * (high - low))


@pytest.mark.lengthy
def test_a_plan_asked_for_standard_is_the_flight_of_its_corrected_controls(planner):
    told = load_scenario(PAPER_CALM, ["solver.accuracy=standard"])
    plan = planner.solve(told)
    assert plan.is_verified
    assert plan.energy == pytest.approx(PROVEN_J, rel=FIGURES[Accuracy.STANDARD].energy)
    assert plan.verification.terminal_miss_m <= FIGURES[Accuracy.STANDARD].miss
    assert plan.verification.flown_energy_J == pytest.approx(plan.energy, rel=1e-6)
