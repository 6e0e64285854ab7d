"""Wind that varies with height, and a vertical one, against the laws written anew in NumPy."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from pyomo_quad.model import build_model, inspect_model, parameter_values
from pyomo_quad.model.turbulence import turbulence_values
from pyomo_quad.model.typeset import typeset_equations
from pyomo_quad.model.wind import mean_wind
from pyomo_quad.study.check import reach_findings
from tests.declared_model import Instant, scenario
from tests.flights import PLANNER, certified, diagnosed

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


def measured(folder, heights, wind, times=()):
    """A wind of these heights, along x as the function says and along y half of it, in a file."""
    rows = [
        [*key, f"{z:.17g}", f"{wind(*key, z):.17g}", f"{0.5 * wind(*key, z):.17g}"]
        for key in ([(t,) for t in times] or [()])
        for z in heights
    ]
    header = ["time_s"] * bool(times) + ["height_m", "wind_x_m_per_s", "wind_y_m_per_s"]
    file = folder / f"wind_{len(heights)}.csv"
    file.write_text("\n".join(",".join(map(str, row)) for row in [header, *rows]) + "\n")
    return {"use": "calm", "file": str(file)}


def law(z):
    return 6.0 * (z / 8.0) ** 0.22


@pytest.mark.lengthy
def test_a_measured_profile_is_the_cubic_spline_and_nears_its_law_by_the_fourth_order(tmp_path):
    tried = np.linspace(3.1, 39.3, 60)
    errors = []
    for count in (8, 15, 29):
        heights = np.linspace(2.0, 40.0, count)
        instant = Instant.of(wind=measured(tmp_path, heights, law))
        found = speeds(instant, tried)
        np.testing.assert_allclose(found, CubicSpline(heights, law(heights))(tried), rtol=1e-9)
        along_y = speeds(instant, tried, "wind.velocity_y")
        np.testing.assert_allclose(along_y, 0.5 * found, rtol=1e-9)
        errors.append(np.abs(found - speeds_by_law(tried)).max())
    assert errors[-1] < 3e-3
    # The steps are halved twice; near the ends the law's own bend keeps the order a little lower.
    assert np.log2(errors[0] / errors[-1]) / 2 > 2.5


def speeds_by_law(heights):
    profile = {"law": "power", "exponent": 0.22, "reference_height": 8.0}
    return speeds(Instant.of(wind={"use": "constant", "speed": 6.0, "profile": profile}), heights)


@pytest.mark.lengthy
def test_beyond_the_measured_heights_the_wind_is_held_smoothly(tmp_path):
    instant = Instant.of(wind=measured(tmp_path, (2.0, 3.0, 5.0, 9.0), law))
    for beyond, end in (((-50.0, 0.0, 1.4), 2.0), ((9.6, 20.0, 1e4), 9.0)):
        np.testing.assert_allclose(speeds(instant, beyond), law(end), rtol=1e-9)
    for end in (2.0, 9.0):
        found = speeds(instant, np.linspace(end - 0.6, end + 0.6, 481))
        assert np.all(np.diff(found) >= -1e-12)
        assert np.max(np.abs(np.diff(found, 2))) < 0.05 * np.max(np.diff(found))


MANY = (tuple(np.linspace(0.0, 60.0, 40)), tuple(np.geomspace(0.5, 100.0, 40)))


@pytest.mark.lengthy
@pytest.mark.parametrize("heights", [(2.0, 12.0), (2.0, 5.0, 12.0), *MANY])
def test_few_heights_and_many(tmp_path, heights):
    def bent(z):
        return np.sin(z / 4.0)

    known = bent(np.array(heights))
    through = (
        CubicSpline if len(heights) > 3 else lambda z, v: np.poly1d(np.polyfit(z, v, len(z) - 1))
    )
    inner = np.linspace(heights[0] + 0.7, heights[-1] - 0.7, 33)
    instant = Instant.of(wind=measured(tmp_path, heights, bent))
    np.testing.assert_allclose(speeds(instant, inner), through(heights, known)(inner), atol=1e-9)


def test_a_wind_over_time_and_height_is_the_spline_of_both(tmp_path):
    times, heights = np.linspace(0.0, 12.0, 25), np.array([1.0, 2.0, 4.0, 7.0, 11.0])

    def gust(t, z):
        return 3.0 * np.sin(0.4 * t + 0.1 * z) + 0.2 * z

    wind = measured(tmp_path, heights, gust, tuple(times)) | {"time_offset": 1.3}
    instant = Instant.of(wind=wind)
    table = gust(times[:, None], heights)
    when = CubicSpline(times, table)(instant.t + 1.3)
    tried = np.array([1.6, 3.0, 6.1, 10.3])
    np.testing.assert_allclose(speeds(instant, tried), CubicSpline(heights, when)(tried), rtol=1e-9)
    np.testing.assert_allclose(speeds(instant, tried), gust(instant.t + 1.3, tried), atol=2e-2)


def test_gusts_lie_along_the_wind_at_ten_metres(tmp_path):
    """Not along the mean over all heights: between 4 and 16 m this wind turns from +x to +y."""
    file = tmp_path / "turning.csv"
    rows = [f"{z},{3.0 * (z <= 4.0)},{3.0 * (z > 4.0)}" for z in (0.0, 1.0, 2.0, 4.0, 16.0, 20.0)]
    file.write_text("\n".join(["height_m,wind_x_m_per_s,wind_y_m_per_s", *rows]))
    still = {"start": {"position": [0.0, 0.0, 10.0]}, "goal": {"position": [0.0, 0.0, 12.0]}}
    told = scenario(
        wind={"use": "calm", "file": str(file), "coupling": "drag"}
        | {"turbulence": {"intensity": "light"}},
        mission=still,
    )
    assert mean_wind(told) == pytest.approx((1.5, 1.5))
    direction = turbulence_values(told)["wind.turbulence.direction"]
    assert direction == pytest.approx(np.pi / 4)


@pytest.mark.lengthy
def test_what_does_not_know_heights_says_so_of_measured_ones(tmp_path):
    told = scenario(wind=measured(tmp_path, (0.0, 3.0, 5.0, 7.0), law) | {"coupling": "drag"})
    model = build_model(told)
    assert inspect_model(model).unit_errors == ()
    assert "wind.velocity_x" in {equation.name for equation in typeset_equations(model)}
    assert certified(told).reason.startswith("no bound is known in a wind that varies with height")
    assert mean_wind(told) == pytest.approx((law(7.0), 0.5 * law(7.0)))
    (said,) = (f.message for f in diagnosed(told) if f.subject == "wind.file")
    assert said.endswith(
        "covers 0 to 7 m, the mission goes from 0 to 8 m; outside, the wind is that of the nearest "
        "height: add the heights of the mission to the file."
    )


@pytest.mark.slow
def test_a_plan_in_a_measured_profile_is_that_in_its_law(tmp_path):
    heights = np.linspace(0.5, 20.0, 30)
    by_table = measured(tmp_path, heights, lambda z: -8.0 * (z / 10.0) ** 0.4)
    told = course(10.0, {"use": "calm", "file": by_table["file"], "speed": 0.0})
    growing = course(10.0, AGAINST | GROWING | {"speed": 8.0})
    table, formula = PLANNER.solve(told), PLANNER.solve(growing)
    assert table.is_verified
    assert table.to_frame()["z_m"].min() < 9.0
    assert table.energy == pytest.approx(formula.energy, rel=1e-2)


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


@pytest.mark.lengthy
def test_the_plan_dives_below_a_head_wind():
    growing = PLANNER.solve(course(10.0, AGAINST | GROWING))
    assert growing.is_verified
    flight = growing.to_frame()
    assert flight["z_m"].min() < 9.0
    # Above half a metre the table of the flight shows the wind of the law at its heights.
    expected = -4.0 * (flight["z_m"] / 10.0) ** 0.4
    np.testing.assert_allclose(flight["wind_x_m_per_s"], expected, rtol=1e-9)


@pytest.mark.slow
def test_higher_up_a_head_wind_costs_more():
    planner = PLANNER
    energies = [planner.solve(course(z, AGAINST | GROWING)).energy for z in (2.0, 10.0, 40.0)]
    assert energies == sorted(energies)
    even = planner.solve(course(10.0, AGAINST))
    assert even.to_frame()["z_m"].min() > 9.9
    # The course at the height of the reference is open to a plan in the growing wind too.
    assert energies[1] < even.energy < energies[2]


def test_no_bound_is_claimed():
    certificate = certified(course(10.0, AGAINST | GROWING))
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
    planner = PLANNER
    at_the_ground = told.with_values({"wind.profile": None, "wind.speed": 6.0 * 0.01**0.4})
    assert [finding.subject for finding in reach_findings(at_the_ground, planner)]
    assert not list(reach_findings(told, planner))
