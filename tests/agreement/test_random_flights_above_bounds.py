"""Hundreds of flights drawn at random, of every form that is bounded, and none below its bound.

A flight is drawn as a path: quintics from passage to passage, at random times and velocities.  The
thrust that it needs and what the motors draw for it come from the vehicle's second writing; the
rotors turn alike, so that what it spends on turning the body is left out, which can only lower it.
"""

from math import inf

import numpy as np
import pytest

from pyomo_quad.study.certificate import certify
from tests.agreement import plain_quadrotor as plain
from tests.declared_model import scenario
from tests.flights import PLANNER, certified

FLIGHTS = 500
FASTEST = 1500.0
SAMPLES = 24
GOAL = (6.0, 7.0, 8.0)


def waypoint(*position, **more):
    return {"position": list(position), **more}


PASSED = [waypoint(2.0, 5.0, 2.0), waypoint(7.0, 6.0, 5.0, radius=0.5)]
HELD = [waypoint(2.0, 5.0, 2.0, hold=1.5), waypoint(7.0, 6.0, 5.0, speed_max=0.5)]
TIMED = [waypoint(2.0, 5.0, 2.0, at=3.0), waypoint(7.0, 6.0, 5.0)]
DELIVERED = [waypoint(2.0, 5.0, 2.0, release=0.15), waypoint(7.0, 6.0, 5.0, release=0.05)]
STEADY = {"use": "constant", "speed": 1.0, "direction": 0.7}
FORMS = {
    "fixed": {},
    "fixed_in_wind": {"wind": STEADY},
    "free": {"duration": "free"},
    "free_in_wind": {"duration": "free", "wind": STEADY},
    "free_within_limits": {"duration": "free", "duration_min": 6.0, "duration_max": 9.0},
    "passed": {"waypoints": PASSED},
    "passed_free": {"waypoints": PASSED, "duration": "free"},
    "passed_in_wind": {"waypoints": PASSED, "duration": "free", "wind": STEADY},
    "held": {"waypoints": HELD},
    "held_free": {"waypoints": HELD, "duration": "free"},
    "timed": {"waypoints": TIMED, "duration": "free"},
    "delivered": {"waypoints": DELIVERED},
    "delivered_free": {"waypoints": DELIVERED, "duration": "free"},
}
QUICK = ("fixed_in_wind", "free", "delivered_free")


@pytest.fixture(scope="module")
def planner():
    return PLANNER


def mission_of(form):
    tables = dict(FORMS[form])
    wind = tables.pop("wind", {"use": "calm"})
    mission = {"goal": {"position": list(GOAL)}, "duration": 8.0} | tables
    released = sum(w.get("release", 0.0) for w in mission.get("waypoints", []))
    return scenario(
        mission=mission,
        wind=wind,
        vehicle={"payload": released},
        limits={"rotor_speed_max": FASTEST},
    )


class Flights:
    """Flights of one mission, drawn at random: each quantity has one row for each of them."""

    samples = SAMPLES

    def __init__(self, told, seed):
        self.mission, self.mass = told.mission, told.vehicle.total_mass
        self.positions = np.array(told.mission.positions)
        self.random = np.random.default_rng(seed)
        # As (9) has it, the wind is an acceleration.
        towards = np.array([np.cos(told.wind.direction), np.sin(told.wind.direction), 0.0])
        self.wind = towards * (told.wind.speed if told.wind.use == "constant" else 0.0)
        ways = np.linalg.norm(np.diff(self.positions, axis=0), axis=1)
        self.legs = np.sqrt(ways) * self.random.uniform(0.9, 2.0, (FLIGHTS, len(ways)))
        self.holds = np.array([*(w.hold for w in self.mission.waypoints), 0.0])
        self.keep_to_given_times()

    def keep_to_given_times(self):
        given = [k for k, w in enumerate(self.mission.waypoints) if w.at is not None]
        for k in given:
            self.legs[:, : k + 1] *= self.mission.waypoints[k].at / self.whole(k + 1)
        least, greatest = self.mission.duration_limits
        held = np.sum(self.holds)
        if not given:
            self.legs *= (np.clip(self.whole() + held, least, greatest) - held) / self.whole()

    def whole(self, count=None):
        return np.sum(self.legs[:, :count], axis=1, keepdims=True)

    def energies(self):
        spent, mass = np.zeros(FLIGHTS), self.mass
        still = np.zeros((FLIGHTS, 3))
        goal = self.positions[-1] + still, still, still
        here = self.positions[0] + still, still, still
        for k, leg in enumerate(self.legs.T):
            is_last = k == len(self.mission.waypoints)
            there = goal if is_last else self.passage(k)
            spent += self.leg(here, there, leg[:, None], mass)
            spent += self.holds[k] * self.power(np.zeros((1, 3)), mass)
            mass -= 0.0 if is_last else self.mission.waypoints[k].release
            here = there
        return spent + self.stored(mass) - self.stored(self.mass)

    def passage(self, k):
        passed = self.mission.waypoints[k]
        off, swerve, turning = self.random.normal(size=(3, FLIGHTS, 3))
        share = self.random.uniform(0.0, 1.0, (2, FLIGHTS, 1))
        off *= passed.radius * share[0] / np.linalg.norm(off, axis=1, keepdims=True)
        heading = self.positions[k + 2] - self.positions[k]
        velocity = share[1] * heading / np.mean(self.legs, axis=1, keepdims=True) + 0.3 * swerve
        speed = np.linalg.norm(velocity, axis=1, keepdims=True)
        velocity *= np.minimum(1.0, (passed.speed_max or inf) / speed)
        is_passed = passed.hold == 0.0
        return self.positions[k + 1] + off, velocity * is_passed, 0.5 * turning * is_passed

    def leg(self, here, there, duration, mass):
        """Energy of quintics between places, velocities and accelerations."""
        ends = np.stack([*here, *there]) * np.stack([duration**k for k in (0, 1, 2, 0, 1, 2)])
        powers = np.arange(6)
        rows = [share**powers for share in (0.0, 1.0)]
        slopes = [np.array([0, 1, 2 * e, 3 * e, 4 * e, 5 * e]) for e in (0.0, 1.0)]
        bends = [np.array([0, 0, 2, 6 * e, 12 * e, 20 * e]) for e in (0.0, 1.0)]
        table = np.stack([rows[0], slopes[0], bends[0], rows[1], slopes[1], bends[1]])
        terms = np.einsum("ij,jna->ina", np.linalg.inv(table), ends)
        nodes, widths = np.polynomial.legendre.leggauss(self.samples)
        # Beside the quintic, a swerve s^3 (1 - s)^3 that leaves the ends what they are.
        share, swerve = (nodes + 1) / 2, np.polynomial.Polynomial([0, 0, 0, 1, -3, 3, -1])
        off = 20.0 * self.random.normal(size=(FLIGHTS, 3))
        motion = []
        for order in (1, 2):
            powers_of = [np.polynomial.Polynomial.basis(k).deriv(order)(share) for k in range(6)]
            path = np.einsum("kt,kna->nta", np.array(powers_of), terms)
            path += np.einsum("t,na->nta", swerve.deriv(order)(share), off)
            motion.append(path / duration[:, :, None] ** order)
        velocity, acceleration = motion
        return duration[:, 0] / 2 * (self.power(acceleration, mass, velocity) @ widths)

    def stored(self, mass):
        return stored(mass)

    def power(self, acceleration, mass, _velocity=0.0):
        force = mass * (acceleration - self.wind + plain.GRAVITY * plain.UP)
        omega = np.sqrt(np.linalg.norm(force, axis=-1) / (4 * plain.KB))
        return np.where(omega <= FASTEST, 4 * plain.motor(omega, 0.0)[2], inf)


def stored(mass):
    """What rotors that hover with a mass hold, by gathering speed from rest."""
    hover = np.sqrt(mass * plain.GRAVITY / (4 * plain.KB))
    nodes, widths = np.polynomial.legendre.leggauss(12)
    omega = hover * (nodes + 1) / 2
    per_speed = (plain.motor(omega, 1.0)[2] - plain.motor(omega, -1.0)[2]) / 2
    return 4 * hover / 2 * widths @ per_speed


@pytest.mark.parametrize(
    "form", [f if f in QUICK else pytest.param(f, marks=pytest.mark.slow) for f in FORMS]
)
def test_no_flight_drawn_at_random_is_below_its_bound(planner, form):
    told = mission_of(form)
    found = certify(told, planner=planner)
    energies = Flights(told, seed=len(form)).energies()
    assert np.sum(energies < inf) > FLIGHTS / 2
    assert found.lower_bound_J <= np.min(energies)


LINEAR, QUADRATIC = 0.322, 0.038
PAYLOAD = 0.25
FAR = {"goal": {"position": [150.0, 40.0, 12.0]}}
# m/s and rad: from the goal.
AGAINST = (5.0, np.pi + np.arctan2(40.0, 150.0))
AIRSPEED_FORMS = {
    "fixed": FAR | {"duration": 22.0},
    "free": FAR | {"duration": "free"},
    "passed": FAR | {"duration": 26.0, "waypoints": [waypoint(80.0, 0.0, 20.0, radius=2.0)]},
    "delivered": FAR
    | {"duration": "free", "waypoints": [waypoint(80.0, 0.0, 20.0, release=PAYLOAD)]},
}


class AirspeedFlights(Flights):
    """Flights whose drag and power depend on the airspeed."""

    samples = 6

    def power(self, acceleration, mass, velocity=0.0):
        air = np.broadcast_to(velocity - self.wind, acceleration.shape).reshape(-1, 3)
        speed = np.sqrt(np.sum(air**2, axis=1, keepdims=True) + 1e-6)
        force = mass * (acceleration.reshape(-1, 3) + plain.GRAVITY * plain.UP)
        force = force + (LINEAR + QUADRATIC * speed) * air
        powers = map(self.power_of, force, air)
        return np.array(list(powers)).reshape(acceleration.shape[:-1])

    def power_of(self, force, air):
        thrust = np.linalg.norm(force)
        x, y, z = force / thrust
        body = np.array([0, 0, 0, *air, -np.arcsin(y), np.arctan2(x, z), 0, 0, 0, 0])
        omega = np.full(4, np.sqrt(thrust / (4 * plain.M100["kb"])))
        still = np.zeros(3)
        return plain.momentum_power(body, omega, np.zeros(4), still, plain.M100)[1]

    def stored(self, mass):
        return 2 * plain.M100["drum"] * mass * plain.GRAVITY / (4 * plain.M100["kb"])


@pytest.mark.slow
@pytest.mark.parametrize(("wind", "direction"), [(0.0, 0.0), (4.0, 2.0), AGAINST])
@pytest.mark.parametrize("form", AIRSPEED_FORMS)
def test_no_flight_through_air_is_below_its_bound(form, wind, direction):
    craft, mission = plain.M100, AIRSPEED_FORMS[form]
    fields = {
        "mass": "mass", "rotor_radius": "radius", "thrust_coefficient": "kb",
        "induced_power_factor": "induced", "profile_power_coefficient": "profile",
        "profile_advance_factor": "advance", "climb_power_factor": "climb",
        "descent_power_factor": "descent", "electronics_power": "electronics",
        "rotor_inertia": "drum", "torque_constant": "kt", "motor_resistance": "resistance",
    }  # fmt: skip
    drag = {"drag_linear": LINEAR, "drag_quadratic": QUADRATIC, "payload": PAYLOAD}
    told = scenario(
        vehicle={"use": "dji_matrice_100"} | {k: craft[v] for k, v in fields.items()} | drag,
        wind={"use": "constant", "speed": wind, "direction": direction, "coupling": "drag"},
        power={"model": "momentum", "air_density": craft["density"]},
        mission=mission,
    )
    found = certified(told)
    energies = AirspeedFlights(told, seed=len(form)).energies()
    assert found.lower_bound_J <= np.min(energies)
