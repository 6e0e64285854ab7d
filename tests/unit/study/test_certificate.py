"""When there is a certificate, what it rests on in each model, and the thrust a flight needs."""

from math import sqrt

import numpy as np
import pytest

from pyomo_quad.study.certificate import ThrustMoments
from tests.declared_model import AIRSPACE, Instant, momentum_demand, scenario
from tests.flights import certified

# Of a fit to seven values, relative to the largest of them.
ROUNDING = 1e-12
QUADRATIC = {"drag_quadratic": 0.01}
PARCELS = [{"position": [1.0, 1.0, 1.0], "release": 0.1}, {"position": [4.0, 4.0, 6.0]}]
BOUNDED = ("motor", "shaft", "constant_efficiency", "motor_with_friction")


def remainder_in_alpha(model, omega):
    """Fit power at one speed by a quadratic in alpha; return its square and what it misses.

    Both are shares of the largest power.
    """
    at = Instant.of(power={"model": model, "regeneration": True})
    shares = np.linspace(-1.0, 1.0, 7)
    powers = np.array(
        [
            at.set(omega=(omega,) * 4, alpha=(3000.0 * share,) * 4).read("power.rotor_power", 1)
            for share in shares
        ]
    )
    powers /= np.max(np.abs(powers))
    fit = np.polynomial.polynomial.polyfit(shares, powers, 2)
    missed = np.polynomial.polynomial.polyval(shares, fit) - powers
    return fit[2], np.max(np.abs(missed))


@pytest.mark.parametrize("omega", [1.0, 300.0, 912.0, 1047.0])
@pytest.mark.parametrize("model", BOUNDED)
def test_alpha_enters_linearly_and_by_a_square_that_costs(model, omega):
    # What the bound rests on: the linear part integrates to zero, the square is not negative.
    square, missed = remainder_in_alpha(model, omega)
    assert square >= -ROUNDING
    assert missed < ROUNDING


def test_alpha_enters_the_efficiency_function_otherwise():
    _, missed = remainder_in_alpha("efficiency", 912.0)
    assert missed > 1e-3


def test_momentum_demand_is_read_off_the_declared_balance():
    wind = {"use": "constant", "speed": 2.0, "coupling": "drag"}
    demand = momentum_demand(scenario(wind=wind, vehicle={"payload": 0.2, "drag_linear": 0.3}))
    assert demand.is_linear
    np.testing.assert_allclose(demand.mass, 1.5)
    np.testing.assert_allclose(demand.drag, 0.3)
    motion = {"velocity": np.array([1.0, 2.0, 3.0]), "acceleration": np.array([0.5, 0.0, -1.0])}
    needed = 1.5 * np.array([0.5, 0.0, 8.81]) + 0.3 * np.array([1.0 - 2.0, 2.0, 3.0])
    np.testing.assert_allclose(demand.thrust(4.0, **motion), needed, rtol=1e-12)


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("tables", "reason"),
    [
        ({"power": {"model": "efficiency"}}, "power.model efficiency has no bound"),
        (
            {"vehicle": {"use": "dji_matrice_100"}, "power": {"model": "momentum"}},
            "no drag limits the airspeed; give limits.speed_max",
        ),
        (
            {"wind": {"use": "paper_table_2", "coupling": "drag"}, "vehicle": QUADRATIC},
            "changes with time if power or drag depends on the airspeed",
        ),
        (
            {
                "wind": {"use": "calm", "coupling": "drag"},
                "vehicle": QUADRATIC,
                "power": {"model": "motor_with_friction"},
            },
            "power.model motor_with_friction has no bound here: it is not convex in thrust",
        ),
        (
            {
                "wind": {"use": "calm", "coupling": "drag"},
                "vehicle": QUADRATIC | {"payload": 0.1},
                "mission": {"waypoints": PARCELS, "order": "best"},
            },
            "a mass that changes where the order is open",
        ),
        ({"model": "own.py:build"}, "a user's own model"),
        ({"mission": {"goal": {"position": [0.0, 0.0, 8.0]}, "duration": 0.3}}, "no flight meets"),
        ({"limits": {"rotor_speed_min": 1047.19, "rotor_speed_max": 1047.0}}, "no flight meets"),
    ],
)
def test_where_there_is_none_the_reason_is_given(tables, reason):
    found = certified(scenario(**tables) if "model" not in tables else own_model())
    assert not found.applies
    assert found.lower_bound_J is None
    assert found.gap_percent(700.0) is None
    assert reason in found.reason


def own_model():
    return scenario().with_values({"model": "own.py:build"})


def test_zones_leave_the_bound_what_it_is_and_it_says_so():
    free, kept_out = certified(scenario()), certified(scenario(airspace=AIRSPACE))
    assert kept_out.lower_bound_J == free.lower_bound_J
    assert kept_out.reason.endswith(", and so for those of them that stay within the airspace too.")


def test_the_gap_is_relative_to_the_energy():
    found = certified(scenario())
    assert found.gap_percent(2 * found.lower_bound_J) == pytest.approx(50.0)
    assert "momentum balance" in found.reason


def test_the_bound_does_not_depend_on_how_far_the_speed_limit_is():
    usual = certified(scenario()).lower_bound_J
    far = certified(scenario(limits={"rotor_speed_max": 2e4})).lower_bound_J
    assert far == pytest.approx(usual, rel=1e-6)


def test_a_measured_wind_is_integrated_too(tmp_path):
    times = np.linspace(0.0, 10.0, 101)
    rows = "\n".join(f"{t},{1.0 + 0.1 * np.sin(0.5 * t)},0.5" for t in times)
    (tmp_path / "wind.csv").write_text(f"time_s,wind_x_m_per_s,wind_y_m_per_s\n{rows}\n")
    measured = certified(scenario(wind={"use": "calm", "file": str(tmp_path / "wind.csv")}))
    silent = {"amplitudes": [0.0, 0.0, 0.0], "gust_amplitude": 0.0}
    harmonic = {"amplitudes": [0.1, 0.0, 0.0], "gust_amplitude": 0.0}
    formula = certified(scenario(wind={"use": "paper_table_2", "x": harmonic, "y": silent}))
    assert measured.lower_bound_J == pytest.approx(formula.lower_bound_J, rel=1e-7)


MASS, WEIGHT = 1.3, 1.3 * 9.81


def moments(displacement, duration, **tables):
    demand = momentum_demand(scenario(**tables))
    return ThrustMoments(demand, np.array(displacement), duration)


@pytest.mark.parametrize(("height", "duration"), [(8.0, 1.0), (30.0, 4.0), (-20.0, 2.0)])
def test_least_peak_of_a_vertical_flight_by_hand(height, duration):
    # Full thrust up, then full thrust down: with a = (u - mg)/m and b = (u + mg)/m the height is
    # T^2 a b / 2 (a + b) = T^2 (u^2 - (mg)^2) / 4 m u.
    force = 4 * MASS * abs(height) / duration**2
    expected = force / 2 + sqrt((force / 2) ** 2 + WEIGHT**2)
    found = moments([0.0, 0.0, height], duration).least_peak()
    assert found == pytest.approx(expected, rel=1e-3)
    assert found <= expected * (1 + 2e-4)


def test_least_peak_in_place_is_the_mean_thrust():
    held = moments([0.0, 0.0, 0.0], 5.0, wind={"use": "constant", "speed": 4.0})
    np.testing.assert_allclose(held.mean_thrust, [-MASS * 4.0, 0.0, WEIGHT], rtol=1e-9)
    assert held.least_peak() == pytest.approx(np.hypot(MASS * 4.0, WEIGHT), rel=1e-9)


def test_drag_adds_its_share_of_the_mean_velocity():
    wind = {"use": "calm", "coupling": "drag"}
    held = moments([6.0, 0.0, 8.0], 10.0, wind=wind, vehicle={"drag_linear": 0.5})
    np.testing.assert_allclose(held.mean_thrust, [0.3, 0.0, WEIGHT + 0.4], atol=1e-12)
