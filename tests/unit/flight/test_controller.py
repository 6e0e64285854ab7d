"""The parts of the law: rotor speeds in order of rank, thrust as a vector, smooth limits."""

from math import atan2, cos, hypot, sin, sqrt

import casadi
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pyomo_quad.collocation.closed_loop import Symbol
from pyomo_quad.flight.baselines import reference_path
from pyomo_quad.flight.controller import (
    Allocation,
    ThrustEnvelope,
    bend,
    braking_rate,
    followed_tilt,
    mixer_matrix,
    project,
    thrust_direction,
    tilt_toward,
)
from pyomo_quad.flight.ensemble import Draws, EnsembleSimulation
from pyomo_quad.scenario import Reference
from pyomo_quad.scenario.tables import FASTER_GAINS, Gains
from tests import flights

KB, KAPPA, ARM = 3.8305e-6, 2.2518e-8, 0.175
MIXER = np.array(
    [
        [KB, KB, KB, KB],
        [0.0, ARM * KB, 0.0, -ARM * KB],
        [-ARM * KB, 0.0, ARM * KB, 0.0],
        [KAPPA, -KAPPA, KAPPA, -KAPPA],
    ]
)
LIMITS = flights.scenario("paper_calm").limits
WEIGHT = 1.3 * 9.81


def achieved(thrust, moments, limits=LIMITS):
    speeds = np.array(Allocation(MIXER, limits).rotor_speeds(thrust, moments))
    assert (speeds >= limits.rotor_speed_min * (1 - 1e-12)).all()
    assert (speeds <= limits.rotor_speed_max * (1 + 1e-12)).all()
    return MIXER @ speeds**2


def test_the_mixer_is_that_of_equation_7():
    assert mixer_matrix(flights.vehicle("paper_calm")) == pytest.approx(MIXER, rel=1e-12)


def test_what_fits_is_given_exactly():
    wanted = (WEIGHT, 0.05, -0.08, 0.004)
    assert achieved(wanted[0], wanted[1:]) == pytest.approx(wanted, rel=1e-10)


moments = st.tuples(*[st.floats(-2.0, 2.0)] * 3)


@given(st.floats(-5.0, 60.0), moments)
def test_limits_are_never_left(thrust, wanted):
    achieved(thrust, wanted)


def test_tilting_comes_before_thrust():
    given_ = achieved(2 * LIMITS.thrust_max, (0.2, 0.1, 0.0))
    assert given_[1:3] == pytest.approx([0.2, 0.1], rel=1e-9)
    assert given_[0] < LIMITS.thrust_max


def test_thrust_comes_before_yaw():
    thrust = 0.99 * LIMITS.thrust_max
    given_ = achieved(thrust, (0.0, 0.0, 1.0))
    assert given_[0] == pytest.approx(thrust, rel=1e-9)
    assert 0.0 < given_[3] < LIMITS.yaw_moment_max


def test_declared_moment_limits_hold():
    tight = LIMITS.model_copy(update={"roll_moment_max": 0.01, "yaw_moment_max": 0.001})
    given_ = achieved(WEIGHT, (0.5, 0.0, -0.5), tight)
    assert given_[[1, 3]] == pytest.approx([0.01, -0.001], rel=1e-9)


def test_a_command_that_stops_a_rotor_can_be_linearised():
    thrust, moments = casadi.SX.sym("thrust"), casadi.SX.sym("moments", 3)
    wanted = [Symbol(moment) for moment in casadi.vertsplit(moments)]
    limits = LIMITS.model_copy(update={"rotor_speed_min": 0.0})
    speeds = Allocation(MIXER, limits).rotor_speeds(Symbol(thrust), wanted)
    column = casadi.vertcat(*(speed.expression for speed in speeds))
    slopes = casadi.jacobian(column, casadi.vertcat(thrust, moments))
    found = casadi.Function("slopes", [thrust, moments], [column, slopes])
    stopped, by_command = found(0.0, [0.0, 10.0 * LIMITS.pitch_moment_max, 0.0])
    assert min(stopped.full()) <= 1.0
    assert np.all(np.isfinite(by_command.full()))


def test_tilting_moment_at_hover_is_what_one_rotor_pair_has_left():
    most = Allocation(MIXER, LIMITS).tilting_moment_at(WEIGHT)
    spare = KB * LIMITS.rotor_speed_max**2 - WEIGHT / 4
    assert most == pytest.approx((2 * ARM * spare,) * 2, rel=1e-9)


GRAVITY, MOST, TILT = 9.81, 12.0, 0.5
angles = st.floats(-1.2, 1.2)
accelerations = st.tuples(*[st.floats(-30.0, 30.0)] * 3)


def rotation(roll, pitch, yaw):
    """The columns of yaw-pitch-roll, multiplied out by NumPy."""
    about_x = np.array([[1, 0, 0], [0, cos(roll), -sin(roll)], [0, sin(roll), cos(roll)]])
    about_y = np.array([[cos(pitch), 0, sin(pitch)], [0, 1, 0], [-sin(pitch), 0, cos(pitch)]])
    about_z = np.array([[cos(yaw), -sin(yaw), 0], [sin(yaw), cos(yaw), 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


@given(angles, angles, angles)
def test_direction_is_the_third_column_of_the_rotation(roll, pitch, yaw):
    expected = rotation(roll, pitch, yaw)[:, 2]
    assert thrust_direction(roll, pitch, yaw) == pytest.approx(expected, abs=1e-12)


@given(angles, angles, angles, st.floats(0.1, 50.0))
def test_tilt_is_the_inverse_of_direction(roll, pitch, yaw, size):
    force = [size * part for part in thrust_direction(roll, pitch, yaw)]
    assert tilt_toward(force, yaw) == pytest.approx((roll, pitch), abs=1e-7)


@given(accelerations)
def test_the_envelope_keeps_direction_thrust_tilt_and_support(wanted):
    given_ = ThrustEnvelope(gravity=GRAVITY, acceleration_max=MOST, tilt_max=TILT).limited(wanted)
    x, y, z = given_
    assert sqrt(x * x + y * y + (z + GRAVITY) ** 2) <= MOST * (1 + 1e-9)
    assert atan2(hypot(x, y), z + GRAVITY) <= TILT * (1 + 1e-9)
    assert z + GRAVITY >= 0.3 * GRAVITY * (1 - 1e-9)
    assert np.cross(wanted, given_) == pytest.approx(np.zeros(3), abs=1e-9)
    assert np.dot(wanted, given_) >= 0.0


def test_small_accelerations_pass_untouched():
    envelope = ThrustEnvelope(gravity=GRAVITY, acceleration_max=MOST, tilt_max=TILT)
    assert envelope.limited((0.3, -0.2, 0.5)) == pytest.approx((0.3, -0.2, 0.5), rel=1e-12)
    assert envelope.limited((0.0, 0.0, 0.0)) == (0.0, 0.0, 0.0)


@given(accelerations)
def test_what_a_plan_asks_is_kept_and_its_direction_can_still_be_corrected(planned):
    envelope = ThrustEnvelope(gravity=GRAVITY, acceleration_max=MOST, tilt_max=TILT)
    assert envelope.limited(planned, planned) == pytest.approx(planned, abs=1e-9)
    aside = np.array([-planned[1], planned[0], 0.0])
    if np.linalg.norm(aside) > 0.1:
        small = 1e-3 * aside / np.linalg.norm(aside)
        corrected = np.array(envelope.limited(planned + small, planned)) - planned
        assert 0.1 * 1e-6 < corrected @ small <= (1 + 1e-6) * 1e-6


def test_a_plan_at_the_largest_thrust_gets_no_more_of_it():
    envelope = ThrustEnvelope(gravity=GRAVITY, acceleration_max=MOST, tilt_max=TILT)
    climbing = (0.0, 0.0, 4.0)
    more = envelope.limited((0.0, 0.0, 24.0), climbing)[2]
    # Within the twentieth by which a smooth limit stays below its bound.
    assert climbing[2] < more < 1.06 * climbing[2]


numbers = st.floats(-50.0, 50.0)
vectors = arrays(float, 3, elements=numbers)


@given(numbers, st.floats(0.1, 10.0))
def test_bend_keeps_small_numbers_and_the_limit(magnitude, limit):
    bent = bend(magnitude, limit)
    assert abs(bent) <= limit
    assert bend(-magnitude, limit) == -bent
    if abs(magnitude) <= 0.8 * limit:
        assert bent == magnitude


def test_bend_is_smooth_where_it_begins():
    x = 0.8 + np.linspace(-1e-3, 1e-3, 5)
    slopes = np.diff([bend(v, 1.0) for v in x]) / np.diff(x)
    assert slopes == pytest.approx(np.ones(4), abs=1e-4)


@given(numbers, st.floats(0.1, 100.0), st.floats(0.1, 100.0))
def test_braking_rate_can_be_braked(error, gain, acceleration_max):
    rate = braking_rate(error, gain, acceleration_max)
    step = 1e-6 * max(abs(error), 1e-3)
    slope = (braking_rate(error + step, gain, acceleration_max) - rate) / step
    assert abs(rate * slope) <= 0.5 * acceleration_max * (1 + 1e-4)
    assert rate * error >= 0.0


@given(vectors, vectors, vectors, st.floats(0.5, 5.0))
def test_projection_never_raises_v_and_keeps_the_ball(direction, rate, truth, bound):
    norm = np.linalg.norm(direction)
    estimate = direction / norm * bound * 0.99 if norm > 1e-3 else np.zeros(3)
    truth = truth / max(1.0, np.linalg.norm(truth) / (0.9 * bound))
    applied = np.array(project(estimate, rate, bound))
    scale = 1.0 + np.linalg.norm(rate) * bound
    assert (estimate - truth) @ (applied - rate) <= 1e-9 * scale
    at_the_wall = estimate / 0.99
    assert at_the_wall @ np.array(project(at_the_wall, rate, bound)) <= 1e-9 * scale


def test_projection_leaves_the_inside_alone():
    assert project((0.1, 0.2, 0.3), (5.0, 6.0, 7.0), 1.0) == [5.0, 6.0, 7.0]


def test_the_controller_tilts_as_far_as_the_limits_let_plans():
    heavy = flights.scenario("delivery", "limits.thrust_max=200.0")
    roll, pitch = heavy.limits.roll_max, heavy.limits.pitch_max
    # Far from the thrust's limit, both angles at theirs tilt the third column of the rotation.
    tilt = atan2(hypot(*rotation(roll, pitch, 0.3)[:2, 2]), rotation(roll, pitch, 0.3)[2, 2])
    assert followed_tilt(heavy) == pytest.approx(tilt, rel=1e-12)
    own = heavy.with_values({"baseline.gains.tilt_max": 0.3})
    assert followed_tilt(own) == 0.3


def test_the_controller_tilts_no_further_than_its_thrust_carries_the_weight():
    mission = flights.scenario("paper_calm")
    spare = mission.limits.thrust_max - mission.vehicle.total_mass * GRAVITY
    thrust = mission.vehicle.total_mass * GRAVITY + 0.9 * spare
    up = thrust * cos(followed_tilt(mission))
    assert up == pytest.approx(mission.vehicle.total_mass * GRAVITY, rel=1e-9)


DASH = (
    "mission.duration=6.0",
    "mission.goal.position=[50.0, 20.0, 10.0]",
    "mission.waypoints=[]",
    "vehicle.payload=0.0",
    "airspace.keep_out=[]",
    "wind.speed=0.0",
)


@pytest.mark.lengthy
def test_a_flight_follows_what_tilts_further_than_half_a_radian_and_keeps_both_angles():
    mission = flights.scenario("delivery", *DASH)
    vehicle = flights.vehicle("delivery", *DASH)
    path = reference_path(mission, Reference.QUINTIC)
    timid = mission.with_values({"baseline.gains.tilt_max": 0.5})
    (follows,), (lags,) = (
        EnsembleSimulation(told, vehicle, path).fly(Draws(count=1)).endings
        for told in (mission, timid)
    )
    assert follows.peak_tilt_rad > 0.55
    assert not {"roll angle", "pitch angle"} & set(follows.broken)
    assert follows.largest_deviation_m < 0.5 * lags.largest_deviation_m


HOVER = (
    "mission.goal.position=[0.0, 0.0, 50.0]",
    "mission.start.position=[0.0, 0.0, 50.0]",
    "mission.duration=6.0",
    "vehicle.attitude='euler'",
)


@pytest.mark.lengthy
@pytest.mark.parametrize("gains", [Gains(), FASTER_GAINS], ids=["default", "faster"])
def test_a_vehicle_tilted_far_from_its_command_rights_itself_and_hardly_falls(gains):
    """Rotors that give 1.3 times the weight; the command of all flights begins level."""
    mission = flights.scenario("paper_calm", *HOVER).with_values({"baseline.gains": gains})
    vehicle = flights.vehicle("paper_calm", *HOVER)
    simulation = EnsembleSimulation(mission, vehicle, reference_path(mission, Reference.QUINTIC))
    tilts = np.array([0.0, 0.3, 0.6])
    flown = simulation.fly(Draws(count=3, start={"rigid_body.theta": tilts}))
    assert flown.tracks["tilt_rad"][0] == pytest.approx(tilts, abs=1e-6)
    assert flown.tracks["tilt_rad"].max(axis=0) == pytest.approx(tilts, abs=0.05)
    last_second = flown.t > flown.t[-1] - 1.0
    assert flown.tracks["tilt_rad"][last_second].max() < 0.1
    assert flown.tracks["z_m"].min() > 50.0 - 2.5
