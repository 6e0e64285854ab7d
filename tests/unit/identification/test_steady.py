"""Steady points: planted numbers come back, and what points cannot tell is said."""

import json

import numpy as np
import pandas as pd
import pytest

from pyomo_quad.cli import main
from pyomo_quad.identification.fitting import identify
from pyomo_quad.identification.motion import LoggedMotion, vehicle_scenario
from pyomo_quad.identification.steady import USED_SHARE, as_flights, identify_steady, read_steady
from pyomo_quad.scenario import ScenarioError
from tests.agreement import plain_quadrotor as plain
from tests.unit.identification import recorded


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("steady")
    (folder / "craft.toml").write_text(recorded.VEHICLE, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def scenario(folder):
    return vehicle_scenario(str(folder / "craft.toml"))


def plain_points(airspeeds, payloads=(0.0,), density=1.2):
    """Powers of level flight of the plain second writing of the vehicle."""
    rows = []
    for payload in payloads:
        for speed in airspeeds:
            air = np.array([speed, 0.0, 0.0])
            weight = (recorded.CRAFT["mass"] + payload) * plain.GRAVITY
            drag = recorded.DRAG[0] + recorded.DRAG[1] * np.sqrt(speed**2 + 1e-6)
            force = weight * plain.UP + drag * air
            rows.append((speed, payload, density, recorded._power(force, air, density)))
    return pd.DataFrame(
        rows, columns=["airspeed_m_s", "payload_kg", "air_density_kg_m3", "power_W"]
    )


def written(folder, points):
    file = folder / "points.csv"
    points.to_csv(file, index=False)
    return file


@pytest.mark.lengthy
def test_a_polar_gives_back_what_was_planted(folder, scenario):
    points = read_steady(written(folder, plain_points([0, 3, 6, 9, 12, 15])), scenario)
    start = scenario.with_values({"vehicle.drag_quadratic": 0.08})
    found = identify_steady(start, points)
    values = {one.name: one.value for one in found.parameters}
    assert all(one.is_determined for one in found.parameters)
    assert values["profile_power_coefficient"] == pytest.approx(plain.M100["profile"], rel=1e-2)
    assert values["induced_power_factor"] == pytest.approx(plain.M100["induced"], rel=1e-2)
    assert values["drag_quadratic"] == pytest.approx(recorded.DRAG[1], rel=2e-2)
    assert found.error_percent < 1e-2
    assert found.unseen_error_percent < 1.0
    computed = LoggedMotion(found.scenario, as_flights(points, found.scenario)).power()[::2]
    assert computed == pytest.approx(found.power, rel=1e-9)


def test_hover_alone_fixes_one_number_and_names_what_goes_with_it(folder, scenario):
    points = read_steady(written(folder, plain_points([0.0])), scenario)
    found = identify_steady(scenario, points)
    assert found.power[0] == pytest.approx(points["power_W"].iloc[0], rel=1e-6)
    assert sum(one.is_determined for one in found.parameters) == 1
    pair = {"profile_power_coefficient", "induced_power_factor"}
    assert any(set(told) == pair for told in found.together)
    assert ("drag_quadratic", "") in found.together
    assert any("one airspeed" in caution for caution in found.cautions)
    assert any("1 points for 1 fitted numbers" in caution for caution in found.cautions)


def test_payloads_at_hover_do_not_tell_induced_from_profile_power(folder, scenario):
    points = read_steady(written(folder, plain_points([0.0], [0, 0.5, 1, 2, 3])), scenario)
    names = ("profile_power_coefficient", "induced_power_factor", "electronics_power")
    found = identify_steady(scenario, points, names)
    kept = {one.name for one in found.parameters if one.is_determined}
    assert len(kept & set(names[:2])) == 1
    assert found.error_percent < 0.05


@pytest.mark.lengthy
def test_the_deviation_is_that_of_the_noise(folder, scenario):
    generator = np.random.default_rng(2)
    points = plain_points(np.linspace(0, 15, 13))
    points["power_W"] += 5.0 * generator.standard_normal(len(points))
    found = identify_steady(scenario, read_steady(written(folder, points), scenario))
    true = {
        "profile_power_coefficient": plain.M100["profile"],
        "induced_power_factor": plain.M100["induced"],
        "drag_quadratic": recorded.DRAG[1],
    }
    for one in found.parameters:
        assert abs(one.value - true[one.name]) < 4.0 * one.deviation
        assert one.deviation < 0.3 * max(true[one.name], 0.3)
    assert not any("points for" in caution for caution in found.cautions)


def test_an_endurance_is_the_pack_over_the_power(folder, scenario):
    (folder / "points.csv").write_text("payload,endurance_s\n0,1200\n1,600\n")
    points = read_steady(folder / "points.csv", scenario)
    power = points["power_W"].to_numpy()
    assert power[1] == pytest.approx(2 * power[0])
    pack = scenario.battery
    most = pack.cells_series * (pack.E0 + pack.A) * pack.capacity * 3600 * USED_SHARE
    assert 0.7 * most < power[0] * 1200 < most


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("speed\n3\n", "has neither power_W nor endurance_s; the columns are power_W (W)"),
        ("power_W\n", "has no row; give one point at least"),
        ("power_W\n-3\n", "power_W = -3 in row 1; must be a number > 0"),
        ("payload,power\n0,0.45\n", "which must be kilowatts; multiply it by 1000."),
        ("payload,power\n0,450000\n", "which must be milliwatts; divide it by 1000."),
        ("power_W\nmuch\n", "column power_W holds text"),
        ("power_W,airspeed_m_s\n3,\n", "airspeed_m_s = nan in row 1; must be a number"),
    ],
)
def test_tables_that_are_none_are_refused(text, told, folder, scenario):
    file = folder / "bad.csv"
    file.write_text(text)
    with pytest.raises(ScenarioError) as caught:
        read_steady(file, scenario)
    assert told in str(caught.value)
    with pytest.raises(ScenarioError, match=r"cannot be read; give a CSV of points; the columns"):
        read_steady(folder / "none.csv", scenario)


def test_the_command_writes_a_vehicle_that_a_scenario_takes(folder, capsys):
    file, out = written(folder, plain_points([0, 5, 10, 15])), folder / "out"
    base = ["--base", str(folder / "craft.toml"), "--figures", "none", "--out", str(out)]
    assert main(["identify", "--steady", str(file), *base]) == 0
    said = capsys.readouterr()
    assert "vehicle.induced_power_factor = 1." in said.out
    assert "all points have the same payload" in said.err
    fitted = vehicle_scenario(str(out / "vehicle.toml"))
    told = json.loads((out / "summary.json").read_text())["parameters"]
    assert fitted.vehicle.drag_quadratic == pytest.approx(told["drag_quadratic"]["value"], rel=1e-5)
    assert main(["identify", *base]) == 2
    assert "give LOGS of flights, or --steady CSV" in capsys.readouterr().err


@pytest.mark.lengthy
def test_few_and_coarse_rows_are_warned_of(scenario):
    """Three short flights at one row a second, whose climb begins and ends within a row."""
    frame = pd.concat([recorded.flight(k, 8.0, 0.0, seconds=24) for k in (1, 2, 3)])
    found = identify(scenario, frame.reset_index(drop=True))
    assert any("72 rows of 3 flights are few" in caution for caution in found.cautions)
    coarse = frame[frame.groupby("flight").cumcount() % 2 == 0].reset_index(drop=True)
    assert any("too coarse" in caution for caution in identify(scenario, coarse).cautions)
    many = recorded.flights()
    copies = [many.assign(flight=many["flight"] + 10 * k) for k in range(2)]
    many = pd.concat(copies, ignore_index=True)
    assert not any("are few" in one for one in identify(scenario, many).cautions)
