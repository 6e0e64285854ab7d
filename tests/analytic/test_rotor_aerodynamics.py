"""Air in body axes, motor lag and reserve, against closed forms and what a limit must mean."""

import numpy as np
import pytest

from pyomo_quad.flight.baselines import fly_baseline
from pyomo_quad.scenario import FeasibilityError, Reference, load_scenario
from pyomo_quad.study.certificate import certify
from pyomo_quad.study.comparison import RESERVE, compare_flights
from tests.command import PAPER_CALM
from tests.declared_model import scenario, steady
from tests.flights import PLANNER, certified

WEIGHT, ARM, KB, INERTIA = 1.3 * 9.81, 0.175, 3.8305e-6, 0.081
HURRIED = {"vehicle.attitude": "euler", "mission.duration": 4.5, "solver.tolerance": 1e-3}


@pytest.mark.lengthy
def test_drag_in_the_rotor_plane_tilts_level_flight():
    drag, speed = 1.19e-4, 8.0
    told = scenario(vehicle={"rotor_drag_plane": drag})
    flown = steady(told)
    trim = flown.trim((speed, 0.0, 0.0))
    names = list(PLANNER.dynamics(told).state_names)
    pitch, rotor = (trim.states[names.index(n)] for n in ("rigid_body.theta", "rotors.omega[1]"))
    assert np.tan(pitch) == pytest.approx(4 * drag * rotor * speed / WEIGHT, rel=1e-6)
    assert 4 * KB * rotor**2 == pytest.approx(WEIGHT * np.cos(pitch), rel=1e-6)


def test_drag_along_the_axis_slows_a_climb_and_lift_speeds_level_flight_up():
    axial, climb = 2.32e-4, 5.0
    rotor = steady(scenario(vehicle={"rotor_drag_axis": axial})).trim((0.0, 0.0, climb)).states[0]
    assert KB * rotor**2 - axial * rotor * climb == pytest.approx(WEIGHT / 4, rel=1e-6)
    lift, speed = 3.39e-3, 6.0
    rotor = steady(scenario(vehicle={"translational_lift": lift})).trim((0.0, speed, 0.0)).states[0]
    assert KB * rotor**2 + lift * speed**2 == pytest.approx(WEIGHT / 4, rel=1e-6)


def test_parasitic_drag_stops_a_fall():
    drag = 0.05
    told = scenario(vehicle={"parasitic_drag": [0.0, 0.0, drag]})
    dynamics = PLANNER.dynamics(told)
    states = np.zeros(len(dynamics.state_names))
    falling = list(dynamics.state_names).index("rigid_body.vz")
    states[falling] = -np.sqrt(WEIGHT / drag)
    rate = dynamics.rates(0.0, states, np.zeros(4))[falling]
    assert rate == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("number", "rate", "inertia", "share"),
    # Two rotors stand aside of the roll and pitch axes, all four around the yaw axis.
    [
        ("rotor_drag_axis", "p", INERTIA, 2),
        ("rotor_drag_axis", "q", INERTIA, 2),
        ("rotor_drag_plane", "r", 0.142, 4),
    ],
)
def test_rotor_drag_damps_the_body_rates(number, rate, inertia, share):
    drag, speed, spin = 2e-4, 912.0, 0.7
    dynamics = PLANNER.dynamics(scenario(vehicle={number: drag}))
    names = list(dynamics.state_names)
    states = np.zeros(len(names))
    states[[names.index(f"rotors.omega[{j}]") for j in range(1, 5)]] = speed
    states[names.index(f"rigid_body.{rate}")] = spin
    found = dynamics.rates(0.0, states, np.zeros(4))[names.index(f"rigid_body.{rate}")]
    assert found == pytest.approx(-share * drag * speed * ARM**2 * spin / inertia, rel=1e-9)


def test_no_bound_is_claimed_where_the_air_acts_in_body_axes():
    certificate = certified(scenario(vehicle={"rotor_drag_axis": 1e-4}))
    assert not certificate.applies
    assert "aerodynamic forces in body axes" in certificate.reason


def _rotors(frame, quantity):
    return frame[[f"{quantity}_{j}_rad_per_s" for j in range(1, 5)]].to_numpy()


def test_a_lagging_motor_accelerates_the_less_the_faster_it_turns():
    lag, speed = 0.4, 900.0
    told = load_scenario(PAPER_CALM, {"vehicle.motor_time_constant": lag})
    dynamics = PLANNER.dynamics(told)
    states = np.zeros((1, len(dynamics.state_names)))
    states[0, [dynamics.state_names.index(f"rotors.omega[{j}]") for j in range(1, 5)]] = speed
    most = (told.limits.rotor_speed_max - speed) / lag
    for share, names in (
        (1.01, {"limits.motor_lag_limit"}),
        (-1.01, {"limits.motor_braking_limit"}),
    ):
        breaches = dynamics.violations(np.zeros(1), states, np.full((1, 4), share * most))
        assert {b.name.partition("[")[0] for b in breaches if b.relative > 1e-3} == names
    within = dynamics.violations(np.zeros(1), states, np.full((1, 4), 0.99 * most))
    assert not [breach for breach in within if breach.relative > 0.0]


def test_the_controller_knows_the_lag_of_its_motors():
    lag = 0.1
    told = load_scenario(PAPER_CALM, {"mission.duration": 4.0, "vehicle.motor_time_constant": lag})
    flight = fly_baseline(told, Reference.STEP, dynamics=PLANNER.dynamics(told))
    assert not flight.broken_limits
    alpha = flight.frame[[f"alpha_{j}_rad_per_s2" for j in range(1, 5)]].to_numpy()
    allowed = (told.limits.rotor_speed_max - _rotors(flight.frame, "omega")) / lag
    assert np.max(np.abs(alpha) / allowed) == pytest.approx(1.0, abs=2e-3)


@pytest.mark.slow
def test_plans_leave_the_reserve_to_the_controller():
    reserve = 0.04
    told = load_scenario(PAPER_CALM, HURRIED | {"limits.reserve": reserve})
    planner = PLANNER
    plan, free = planner.solve(told), PLANNER.solve(load_scenario(PAPER_CALM, HURRIED))
    assert plan.is_verified
    assert plan.energy > free.energy
    flights = [
        plan.flight(),
        fly_baseline(told, Reference.PLAN, dynamics=planner.dynamics(told), plan=plan),
    ]
    fastest = [_rotors(flight.frame, "omega").max() for flight in flights]
    most = told.limits.rotor_speed_max
    assert fastest[0] == pytest.approx((1 - reserve) * most, rel=1e-3)
    assert (1 - reserve) * most < fastest[1] <= most
    # The reserve is the controller's to use, so its flight breaks no limit.
    assert not flights[1].broken_limits
    compared = compare_flights(told, flights, certify(told, planner=planner), plan.hover_energy_J)
    assert compared[RESERVE].tolist() == pytest.approx(
        [100 * (1 - speed / most) for speed in fastest], abs=0.05
    )
    without = compare_flights(
        free.scenario, [free.flight()], certified(free.scenario), free.hover_energy_J
    )
    assert RESERVE not in without


def test_hover_must_leave_the_reserve():
    with pytest.raises(
        FeasibilityError,
        match=r"912\.3 rad/s per rotor, limits\.rotor_speed_max less limits\.reserve = 0\.2 is 837",
    ):
        load_scenario(PAPER_CALM, {"limits.reserve": 0.2})
