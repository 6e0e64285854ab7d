"""Wind that varies with height, and a vertical one, against the laws written anew in NumPy."""

import numpy as np
import pytest

from pyomo_quad.flight import Planner
from pyomo_quad.model import build_model, inspect_model, parameter_values
from pyomo_quad.study.certificate import certify
from pyomo_quad.study.check import reach_findings
from tests.declared_model import Instant, scenario

POWER = {"law": "power", "exponent": 0.22, "reference_height": 8.0}
LOGARITHMIC = {"law": "logarithmic", "roughness": 0.05}
LAWS = {
    "power": (POWER, lambda z: (z / 8.0) ** 0.22),
    "logarithmic": (LOGARITHMIC, lambda z: np.log(z / 0.05) / np.log(10.0 / 0.05)),
    "over a town": (
        {"law": "logarithmic", "roughness": 1.5, "reference_height": 40.0},
        lambda z: np.log(z / 1.5) / np.log(40.0 / 1.5),
    ),
}
BREEZE = {"use": "constant", "speed": 5.0, "direction": 0.7}


def at_height(instant, z):
    return instant.set(body=(0.0, 0.0, z) + (0.0,) * 9)


def speeds(instant, heights, name="wind.velocity_x"):
    return np.array([at_height(instant, z).read(name) for z in heights])


@pytest.mark.parametrize("law", LAWS)
def test_the_law_is_that_of_the_textbook(law):
    profile, factor = LAWS[law]
    heights = np.array([2.1, 5.0, 8.0, 10.0, 40.0, 300.0])
    instant = Instant.of(wind=BREEZE | {"profile": profile})
    for name, share in (("velocity_x", np.cos(0.7)), ("velocity_y", np.sin(0.7))):
        found = speeds(instant, heights, f"wind.{name}")
        np.testing.assert_allclose(found, 5.0 * share * factor(heights), rtol=1e-12)


def test_harmonics_gusts_and_measured_winds_grow_alike(tmp_path):
    rows = [f"{t},{np.sin(t)},{np.cos(t)}" for t in range(12)]
    file = tmp_path / "wind.csv"
    file.write_text("\n".join(["time_s,wind_x_m_per_s,wind_y_m_per_s", *rows]))
    for wind in ({"use": "paper_table_2"}, {"use": "calm", "file": str(file)}):
        even, growing = Instant.of(wind=wind), Instant.of(wind=wind | {"profile": POWER})
        for z in (1.0, 30.0):
            at_height(even, z), at_height(growing, z)
            for name in ("wind.velocity_x", "wind.velocity_y"):
                expected = even.read(name) * (z / 8.0) ** 0.22
                assert growing.read(name) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("law", LAWS)
def test_near_and_under_the_ground_the_wind_is_finite_smooth_and_never_falls_with_height(law):
    profile, factor = LAWS[law]
    least = max(0.1, profile.get("roughness", 0.0))
    instant = Instant.of(wind=BREEZE | {"direction": 0.0, "profile": profile})
    heights = np.linspace(least - 0.6, least + 1.0, 641)
    found = speeds(instant, heights) / 5.0
    assert np.all(np.diff(found) >= -1e-14)
    # Straight lines between the samples, 2.5 mm apart, miss a kink by its slope; a curve by 1e-3.
    bends = np.abs(np.diff(found, 2))
    assert np.max(bends) < 0.05 * np.max(np.diff(found)) + 1e-14
    np.testing.assert_allclose(
        speeds(instant, (-1e4, least - 1.0)) / 5.0, factor(least), atol=1e-12
    )


@pytest.mark.parametrize("profile", [POWER, LOGARITHMIC])
@pytest.mark.parametrize("coupling", ["acceleration", "drag"])
def test_units_and_numbers_are_declared(coupling, profile):
    told = scenario(wind=BREEZE | {"coupling": coupling, "profile": profile, "vertical": 0.5})
    model = build_model(told)
    assert inspect_model(model).unit_errors == ()
    for name, number in parameter_values(told).items():
        assert model.find_component(name).value == pytest.approx(number), name


def test_an_updraft_lifts_as_its_coupling_says():
    vehicle = {"drag_linear": 0.3, "drag_quadratic": 0.0}
    updraft = {"use": "calm", "vertical": 1.4, "profile": POWER}
    still = Instant.of(vehicle=vehicle, wind={"use": "calm", "coupling": "drag"})
    pushed = Instant.of(wind=updraft, vehicle=vehicle)
    dragged = Instant.of(wind=updraft | {"coupling": "drag"}, vehicle=vehicle)
    mass = dragged.model.vehicle.mass.value
    before = still.hover().rates()["dvz_dt"]
    assert pushed.hover().rates()["dvz_dt"] - before == pytest.approx(1.0 * 1.4, rel=1e-9)
    assert dragged.hover().rates()["dvz_dt"] - before == pytest.approx(0.3 * 1.4 / mass, rel=1e-9)


def course(height, wind):
    return scenario(
        vehicle={"use": "dji_phantom_2", "drag_linear": 0.4},
        wind={"use": "constant", "speed": 4.0, "coupling": "drag"} | wind,
        mission={
            "start": {"position": [0.0, 0.0, height]},
            "goal": {"position": [30.0, 0.0, height]},
            "duration": 10.0,
        },
    )


GROWING = {"profile": {"law": "power", "exponent": 0.4}}
AGAINST, ALONG = {"direction": np.pi}, {"direction": 0.0}


def test_the_plan_dives_below_a_head_wind():
    growing = Planner().solve(course(10.0, AGAINST | GROWING))
    assert growing.is_verified
    flight = growing.to_frame()
    assert flight["z_m"].min() < 9.0
    # Above half a metre the table of the flight shows the wind of the law at its heights.
    expected = -4.0 * (flight["z_m"] / 10.0) ** 0.4
    np.testing.assert_allclose(flight["wind_x_m_per_s"], expected, rtol=1e-9)


@pytest.mark.slow
def test_higher_up_a_head_wind_costs_more():
    planner = Planner()
    energies = [planner.solve(course(z, AGAINST | GROWING)).energy for z in (2.0, 10.0, 40.0)]
    assert energies == sorted(energies)
    even = planner.solve(course(10.0, AGAINST))
    assert even.to_frame()["z_m"].min() > 9.9
    # The course at the height of the reference is open to a plan in the growing wind too.
    assert energies[1] < even.energy < energies[2]


def test_no_bound_is_claimed():
    certificate = certify(course(10.0, AGAINST | GROWING))
    assert certificate.lower_bound_J is None
    assert certificate.reason == (
        "no bound is known in a wind that varies with height: its mean depends on the path."
    )


def test_no_mission_is_ruled_out_by_the_wind_at_another_height():
    # With the wind at the ground behind it, this vehicle would be too weak for its mission.
    tail_wind = {"use": "constant", "speed": 6.0, "coupling": "drag"} | ALONG
    told = scenario(
        vehicle={"use": "dji_phantom_2", "drag_linear": 1.0},
        wind=tail_wind | GROWING,
        limits={"thrust_max": 15.0},
        mission={
            "start": {"position": [0.0, 0.0, 10.0]},
            "goal": {"position": [100.0, 0.0, 10.0]},
            "duration": 12.0,
        },
    )
    planner = Planner()
    at_the_ground = told.with_values({"wind.profile": None, "wind.speed": 6.0 * 0.01**0.4})
    assert [finding.subject for finding in reach_findings(at_the_ground, planner)]
    assert not list(reach_findings(told, planner))
