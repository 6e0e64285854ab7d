"""Controlled flights: where they start and should end; do they arrive, settle, and keep quiet?"""

from dataclasses import replace

import numpy as np
import pytest

from pyomo_quad.collocation import SolveError
from pyomo_quad.flight import baselines
from pyomo_quad.flight.baselines import (
    assembled_flight,
    baseline_name,
    closed_loop,
    fly,
    fly_baseline,
    fly_open_loop,
    fly_reference,
    reference_path,
    start_state,
    wanted_at_goal,
)
from pyomo_quad.flight.controller import (
    CONTROLLER_STATES,
    AdaptiveController,
    mixer_matrix,
    thrust_direction,
)
from pyomo_quad.flight.flight import POSITION_STATES, Flown
from pyomo_quad.flight.weather import vehicle_flown
from pyomo_quad.scenario import ScenarioError, scenario_from_mapping
from pyomo_quad.scenario.tables import MISSION_TIMED, Reference
from tests import flights

MISSIONS = ("paper_calm", "paper_wind")
UNFORESEEN = "wind.forecast.use='calm'"
# Of sums of a few terms, relative.
ROUNDING = 1e-12


@pytest.mark.lengthy
@pytest.mark.parametrize("reference", MISSION_TIMED)
@pytest.mark.parametrize("name", MISSIONS)
def test_every_reference_arrives(name, reference):
    flight = flights.baseline(name, reference)
    assert flight.name == baseline_name(reference)
    assert flight.terminal_miss_m < 0.02
    assert flight.is_verified
    assert flight.max_violation == pytest.approx(0.0, abs=ROUNDING)
    assert flight.frame["energy_J"].iloc[-1] == pytest.approx(flight.energy_J, rel=ROUNDING)


@pytest.mark.parametrize("reference", [Reference.QUINTIC, Reference.MINIMUM_SNAP, Reference.PLAN])
@pytest.mark.parametrize("name", MISSIONS)
def test_rotors_are_quiet_once_under_way(name, reference):
    frame = flights.baseline(name, reference).frame
    limits = flights.scenario(name).limits
    under_way = frame[(frame["time_s"] >= 1.0) & (frame["time_s"] <= 9.0)]
    alpha = under_way[[f"alpha_{j}_rad_per_s2" for j in (1, 2, 3, 4)]].to_numpy()
    omega = under_way[[f"omega_{j}_rad_per_s" for j in (1, 2, 3, 4)]].to_numpy()
    assert np.abs(alpha).max() < 0.1 * limits.rotor_acceleration_max
    assert limits.rotor_speed_min < omega.min()
    assert omega.max() < 0.95 * limits.rotor_speed_max
    # Chatter would turn the rotors' acceleration around many times a second.
    turns_per_s = (np.diff(np.sign(alpha), axis=0) != 0).sum(axis=0) / 8.0
    assert turns_per_s.max() < 2.0


@pytest.mark.lengthy
def test_a_heading_to_be_kept_is_asked_of_plans_and_of_feedback_that_it_turns_back():
    kept = ("vehicle.attitude='euler'", "mission.yaw='kept'")
    vehicle = flights.vehicle("paper_wind", *kept)
    flight = fly_baseline(
        flights.scenario("paper_wind", *kept), Reference.QUINTIC, dynamics=vehicle
    )
    assert flight.worst_constraint.startswith("mission.yaw_keeping")
    assert flight.broken_limits == ()
    heading = flight.frame["psi_rad"].abs()
    assert 1e-6 < heading.max() < 0.02
    assert heading.iloc[-1] < 0.5 * heading.max()


@pytest.mark.lengthy
def test_a_plan_is_followed_without_the_lag_of_the_command_filter():
    """Without the plan's rates of roll and pitch, its flight of 5 s ended 2 cm off."""
    quick = ("mission.duration=5.0",)
    flight = fly_baseline(
        flights.scenario("paper_calm", *quick),
        Reference.PLAN,
        dynamics=flights.vehicle("paper_calm", *quick),
        plan=flights.plan("paper_calm", *quick),
    )
    assert flight.terminal_miss_m < 0.005


@pytest.mark.lengthy
def test_a_plan_that_uses_all_the_thrust_is_followed_with_its_own_acceleration():
    """Shortened to the controller's share of the thrust, its flight of 3.9 s ended 0.16 m off."""
    quick = ("mission.duration=3.9",)
    flight = fly_baseline(
        flights.scenario("paper_calm", *quick),
        Reference.PLAN,
        dynamics=flights.vehicle("paper_calm", *quick),
        plan=flights.plan("paper_calm", *quick),
    )
    assert flight.terminal_miss_m < 0.02


RELEASE = (
    "mission.goal.position=[2.0, 0.0, 0.0]",
    "mission.duration=8.0",
    "vehicle.payload=0.2",
    "mission.waypoints=[{position=[1.0, 0.0, 0.0], at=3.0, hold=1.0, release=0.2}]",
)


@pytest.mark.lengthy
def test_a_payload_that_is_released_is_no_disturbance():
    """With the old mass the controller learnt 1.3 m/s^2 upwards, and rose by 5 cm."""
    vehicle = flights.vehicle("paper_calm", *RELEASE)
    mission = flights.scenario("paper_calm", *RELEASE)
    flight = fly_reference(mission, Reference.QUINTIC, dynamics=vehicle)
    learnt = flight.controller_states[:, CONTROLLER_STATES.index("disturbance_z_m_per_s2")]
    assert np.abs(learnt).max() < 0.01
    # Until the rotors have slowed down, the vehicle is too light for its thrust.
    assert np.abs(flights.positions(vehicle, flight.flown.states)[:, 2]).max() < 0.01


@pytest.mark.slow
def test_a_plan_demands_the_acceleration_that_its_rotors_give_the_mass_of_the_time():
    air = ("wind.coupling='drag'", "mission.goal.position=[12.0, 0.0, 0.0]")
    way = "mission.waypoints=[{position=[6.0, 0.0, 0.0], at=4.0, radius=0.5, release=0.2}]"
    plan = flights.plan("paper_calm", *RELEASE, *air, way)
    held, mission = plan.trajectories, plan.mission_flown
    path = reference_path(mission, Reference.PLAN, plan)
    # At the 20 samples per second of the path.
    for t, mass in ((3.0, 1.5), (6.0, 1.3)):
        state = dict(zip(held.state_names, held.states_at(np.array([t]))[0], strict=True))
        roll, pitch, yaw = (state[f"rigid_body.{angle}"] for angle in ("phi", "theta", "psi"))
        speeds = np.array([state[f"rotors.omega[{j}]"] for j in (1, 2, 3, 4)])
        thrust = mixer_matrix(plan.dynamics)[0] @ speeds**2
        given = thrust / mass * np.array(thrust_direction(roll, pitch, yaw))
        given[2] -= mission.gravity
        assert path(t).acceleration[:3] == pytest.approx(given, abs=1e-6)


def test_a_step_settles_in_two_to_three_seconds_without_overshoot():
    near = "mission.goal.position=[1.0, 0.0, 0.0]"
    dynamics = flights.vehicle("paper_calm", near)
    scenario = flights.scenario("paper_calm", near)
    flown = fly_reference(scenario, Reference.STEP, dynamics=dynamics).flown
    position = flights.positions(dynamics, flown.states)
    outside = np.linalg.norm(position - (1.0, 0.0, 0.0), axis=1) > 0.05
    assert 2.0 <= flown.t[outside][-1] <= 3.0
    assert position[:, 0].max() < 1.02


def test_limits_hold_even_in_a_step():
    frame = flights.baseline("paper_calm", Reference.STEP).frame
    alpha = frame[[f"alpha_{j}_rad_per_s2" for j in (1, 2, 3, 4)]].abs().to_numpy()
    most = flights.scenario("paper_calm").limits.rotor_acceleration_max
    # A step is what takes them to the limit.
    assert alpha.max() == pytest.approx(most, rel=ROUNDING)


def test_the_controller_is_not_told_the_wind():
    name = "paper_wind"
    dynamics, scenario = flights.vehicle(name), flights.scenario(name)
    believed = scenario.with_values({"wind.use": "calm"})
    flight = fly(
        dynamics=dynamics,
        controller=AdaptiveController(believed, mixer_matrix(dynamics)),
        reference=reference_path(scenario, Reference.QUINTIC),
        initial_state=start_state(scenario, dynamics),
        times=np.array([0.0, 10.0]),
    )
    energy = flights.baseline(name, Reference.QUINTIC).energy_J
    assert flight.flown.energy[-1] == pytest.approx(energy, rel=1e-9)


def test_controllers_that_differ_in_their_first_estimate_alone_share_a_compiled_loop():
    dynamics, scenario = flights.vehicle("paper_calm"), flights.scenario("paper_calm")
    mixer = mixer_matrix(dynamics)
    known = {
        "dynamics": dynamics,
        "controller": AdaptiveController(scenario, mixer, (0.5, 0.0, -0.2)),
        "reference": reference_path(scenario, Reference.QUINTIC),
        "initial_state": start_state(scenario, dynamics),
        "times": np.array([0.0, 1.0]),
    }
    shared = closed_loop(dynamics, AdaptiveController(scenario, mixer))
    own, lent, ignorant = (
        fly(**known),
        fly(**known, system=shared),
        fly(**known | {"controller": AdaptiveController(scenario, mixer)}),
    )
    assert lent.flown.states == pytest.approx(own.flown.states, rel=1e-12, abs=1e-12)
    assert np.abs(own.flown.states - ignorant.flown.states).max() > 1e-3


def test_a_heavier_vehicle_than_believed_is_carried_all_the_same():
    loaded = flights.scenario("paper_calm", "vehicle.payload=0.1")
    dynamics = flights.vehicle("paper_calm", "vehicle.payload=0.1")
    flight = fly(
        dynamics=dynamics,
        controller=AdaptiveController(flights.scenario("paper_calm"), mixer_matrix(dynamics)),
        reference=reference_path(loaded, Reference.QUINTIC),
        initial_state=start_state(loaded, dynamics),
        times=np.array([0.0, 10.0]),
    )
    goal = loaded.mission.goal.position
    assert flights.distances(dynamics, flight.flown.states, goal)[-1] < 0.01


@pytest.mark.lengthy
def test_in_a_wind_not_foreseen_feedback_arrives_and_the_plan_alone_does_not():
    name = "paper_wind"
    plan = flights.plan(name, UNFORESEEN)
    alone = fly_open_loop(flights.scenario(name, UNFORESEEN), plan, flights.vehicle(name))
    assert alone.is_verified
    assert alone.terminal_miss_m > 10.0
    assert flights.baseline(name, Reference.PLAN, UNFORESEEN).terminal_miss_m < 0.02


def test_open_loop_in_constant_wind_is_blown_as_far_as_the_double_integral_says():
    blown = ("wind.use='constant'", "wind.speed=0.02", UNFORESEEN)
    scenario = flights.scenario("paper_calm", *blown)
    dynamics = flights.vehicle("paper_calm", *blown)
    flight = fly_open_loop(scenario, flights.plan("paper_calm"), dynamics)
    assert flight.terminal_miss["rigid_body.x"] == pytest.approx(0.02 * 10.0**2 / 2, rel=1e-6)
    assert flight.terminal_miss["rigid_body.y"] == pytest.approx(0.0, abs=1e-6)


def test_the_flights_verdict_is_that_of_the_second_integrator(monkeypatch):
    name = "paper_calm"
    scenario, dynamics = flights.scenario(name), flights.vehicle(name)
    honest = baselines.fly

    def drifting(*, integrator=baselines.Integrator.RUNGE_KUTTA, **arguments):
        flight = honest(integrator=integrator, **arguments)
        share = 1.0 if integrator is baselines.Integrator.RUNGE_KUTTA else 1.0 + 2e-6
        return replace(flight, flown=replace(flight.flown, energy=share * flight.flown.energy))

    monkeypatch.setattr("pyomo_quad.flight.baselines.fly", drifting)
    assert not fly_baseline(scenario, Reference.QUINTIC, dynamics=dynamics).is_verified


def test_a_flight_out_of_control_is_given_up(monkeypatch):
    monkeypatch.setattr(baselines, "_MOST_EVALUATIONS_PER_SECOND", 5)
    with pytest.raises(SolveError, match=r"out of control at .* s, stopped after 50 evaluations"):
        fly_reference(
            flights.scenario("paper_calm"),
            Reference.QUINTIC,
            dynamics=flights.vehicle("paper_calm"),
        )


def test_restarts_at_jumps_of_turbulence_are_no_tumbling(monkeypatch):
    """What the jumps allow carries the flight, whatever is allowed for its duration."""
    monkeypatch.setattr(baselines, "_MOST_EVALUATIONS_PER_SECOND", 0)
    gusty = ("wind.use='constant'", "wind.speed=5.0", "wind.coupling='drag'")
    scenario = flights.scenario("paper_calm", *gusty, "wind.turbulence.intensity='moderate'")
    dynamics = vehicle_flown(flights.PLANNER, scenario)
    flight = fly(
        dynamics=dynamics,
        controller=AdaptiveController(scenario, mixer_matrix(dynamics)),
        reference=reference_path(scenario, Reference.QUINTIC),
        initial_state=start_state(scenario, dynamics),
        times=np.array([0.0, 0.5]),
    )
    assert np.all(np.isfinite(flight.flown.states))
    with pytest.raises(SolveError, match="out of control"):
        fly_reference(
            flights.scenario("paper_calm"),
            Reference.QUINTIC,
            dynamics=flights.vehicle("paper_calm"),
        )


@pytest.mark.parametrize(("off", "is_kept"), [(0.049, True), (0.099, True), (0.101, False)])
def test_a_hold_under_control_may_be_as_far_off_again_as_a_plan_may(off, is_kept):
    stop = {"position": [1.0, 1.0, 1.0], "at": 2.0, "hold": 2.0}
    mission = {"goal": {"position": [0.0, 2.0, 2.0]}, "duration": 6.0, "waypoints": [stop]}
    told = scenario_from_mapping({"name": "hold", "mission": mission})
    dynamics = flights.PLANNER.dynamics(told)
    times = np.linspace(0.0, 6.0, 61)
    states = np.tile(start_state(told, dynamics), (len(times), 1))
    places = [dynamics.state_names.index(name) for name in POSITION_STATES]
    states[:, places] = np.add(stop["position"], (off, 0.0, 0.0))
    controls = np.zeros((len(times), len(dynamics.control_names)))
    flown = Flown(t=times, states=states, controls=controls, energy=times)
    flight = assembled_flight("aside", told, dynamics, ((flown, flown),), None, 0.0)
    broken = [limit for limit in flight.broken_limits if "hover" in limit]
    assert (broken == []) == is_kept


@pytest.mark.parametrize(("apart", "is_verified"), [(4e-5, True), (6e-5, False)])
def test_parts_of_a_flight_are_confirmed_by_all_that_integrators_differ_in(apart, is_verified):
    told = flights.scenario("paper_calm")
    dynamics, x = flights.vehicle("paper_calm"), POSITION_STATES[0]
    parts = []
    for begin in (0.0, 5.0):
        times = np.linspace(begin, begin + 5.0, 11)
        states = np.tile(start_state(told, dynamics), (len(times), 1))
        controls = np.zeros((len(times), len(dynamics.control_names)))
        flown = Flown(t=times, states=states, controls=controls, energy=times - begin)
        again = states + np.where(np.array(dynamics.state_names) == x, apart, 0.0)
        parts.append((flown, replace(flown, states=again)))
    flight = assembled_flight("parts", told, dynamics, parts, None, 0.0)
    assert flight.is_verified == is_verified
    assert (flight.duration_s, flight.energy_J) == (10.0, 10.0)
    assert (flight.doubt == "") == is_verified
    if not is_verified:
        assert flight.doubt.startswith(
            "two integrators end 0.00012 m apart; must be at most 0.0001"
        )
        assert "the sum over 2 parts between plans" in flight.doubt
        assert flight.doubt.endswith("a longer baseline.mpc.interval makes fewer parts")
    spent = [(one, replace(two, energy=1.1 * one.energy, states=one.states)) for one, two in parts]
    doubt = assembled_flight("spent", told, dynamics, spent, None, 0.0).doubt
    assert "two integrators differ by 1 J in the energy spent; must be at most 1e-05 J" in doubt


def test_the_plan_as_reference_needs_a_plan():
    with pytest.raises(ScenarioError, match="paper_calm: reference 'plan' needs a plan"):
        reference_path(flights.scenario("paper_calm"), Reference.PLAN)


class OtherVehicle:
    state_names = ("x", "v")
    control_names = ("u",)


def test_a_model_that_is_no_quadrotor_is_refused():
    with pytest.raises(ScenarioError, match=r"the model has no state rigid_body\.x; the"):
        fly_reference(flights.scenario("paper_calm"), Reference.STEP, dynamics=OtherVehicle())


def test_without_a_plan_a_flight_starts_where_the_plan_does():
    dynamics, scenario = flights.vehicle("paper_wind"), flights.scenario("paper_wind")
    planned = start_state(scenario, dynamics, flights.plan("paper_wind"))
    assert start_state(scenario, dynamics) == pytest.approx(planned, abs=1e-6)


def test_the_battery_starts_with_the_charge_of_the_scenario():
    override = "battery.initial_state_of_charge=90.0"
    dynamics = flights.vehicle("paper_calm", override)
    start = start_state(flights.scenario("paper_calm", override), dynamics)
    charge = dict(zip(dynamics.state_names, start, strict=True))["battery.charge_drawn"]
    assert charge == pytest.approx(0.1 * 5.2)


def test_the_goal_is_wanted_level_and_at_rest():
    wanted = wanted_at_goal(flights.scenario("paper_calm"), flights.vehicle("paper_calm"))
    assert [wanted[f"rigid_body.{axis}"] for axis in "xyz"] == [6.0, 7.0, 8.0]
    assert wanted["rotors.omega[3]"] == pytest.approx(np.sqrt(1.3 * 9.81 / (4 * 3.8305e-6)))
    assert len(wanted) == 16
    assert sum(value != 0.0 for value in wanted.values()) == 7


class WithLamp:
    state_names = ("rigid_body.x", "lamp.heat")
    control_names = ()


def test_a_state_of_unknown_start_is_refused():
    with pytest.raises(ScenarioError, match=r"the initial value of state lamp\.heat of the"):
        start_state(flights.scenario("paper_calm"), WithLamp())
