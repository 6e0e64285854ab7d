"""Identified and predicted vehicles against flights of the plain second writing."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pyomo_quad.cli import main
from pyomo_quad.identification.fitting import FITTABLE, identify
from pyomo_quad.identification.logs import read_logs
from pyomo_quad.identification.motion import LoggedMotion, vehicle_scenario
from pyomo_quad.identification.report import write_identification
from pyomo_quad.identification.rivals import measures
from pyomo_quad.identification.validation import scores
from pyomo_quad.report import Figures
from pyomo_quad.scenario import load_scenario
from tests.agreement import plain_quadrotor as plain
from tests.unit.identification import recorded

M100 = Path("scenarios/flights/m100")
PLANTED = {
    "profile_power_coefficient": plain.M100["profile"],
    "climb_power_factor": plain.M100["climb"],
    "descent_power_factor": plain.M100["descent"],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    recorded.flights().to_csv(folder / "flights.csv", index=False)
    recorded.flights(noise_W=40.0).to_parquet(folder / "noisy.parquet")
    (folder / "craft.toml").write_text(recorded.VEHICLE, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def identified(folder):
    frame = read_logs(folder / "flights.csv")
    return identify(vehicle_scenario(str(folder / "craft.toml")), frame)


@pytest.mark.lengthy
def test_planted_numbers_come_back(identified):
    for one in identified.parameters:
        assert one.value == pytest.approx(PLANTED[one.name], rel=1e-4), one.name
        assert one.is_determined
        assert not one.is_at_bound


def test_a_fit_to_its_own_vehicle_is_exact_on_flights_unseen(identified):
    found = scores(identified.frame, identified.cross_validated)
    assert found.flights == 5
    assert found.mean_absolute_error_percent < 1e-3
    assert [trial.name for trial in identified.trials] == ["heavy to light", "slow to fast"]
    assert all(t.scores.mean_absolute_error_percent < 1e-2 for t in identified.trials)


def test_what_slow_cruise_draws_beyond_the_fit(identified):
    frame, power = identified.frame, identified.fitted_power
    is_slow = (frame["phase"] == 2).to_numpy() & (identified.airspeeds < 6.0)
    drawn = frame.assign(power_W=power + 30.0 * is_slow)
    found = replace(identified, frame=drawn)
    assert found.excess(0.0, 6.0) == pytest.approx(30.0)
    assert found.excess(6.0, 20.0) == pytest.approx(0.0, abs=1e-9)
    assert np.isnan(found.excess(90.0, 99.0))


@pytest.mark.slow
def test_deviation_is_that_of_the_noise(folder):
    scenario = vehicle_scenario(str(folder / "craft.toml"))
    found = identify(scenario, read_logs(folder / "noisy.parquet"))
    for one in found.parameters:
        assert one.deviation > 0.0
        assert abs(one.value - PLANTED[one.name]) < 5.0 * one.deviation, one.name


@pytest.mark.slow
def test_what_flights_cannot_tell_is_kept(folder):
    scenario = vehicle_scenario(str(folder / "craft.toml"))
    hovering = recorded.flights()
    hovering = hovering[hovering["phase"] == 2]
    hovering.loc[:, "vel_up_m_s"] = 0.0
    hovering.to_csv(folder / "level.csv", index=False)
    found = identify(scenario, read_logs(folder / "level.csv"), FITTABLE)
    kept = {one.name: one for one in found.parameters if not one.is_determined}
    assert "descent_power_factor" in kept
    for name, one in kept.items():
        assert one.value == getattr(scenario.vehicle, name)
        assert one.deviation == 0.0


@pytest.mark.lengthy
def test_commands_write_what_they_say(folder, capsys):
    out, again = folder / "identified", folder / "predicted"
    base = ["--base", str(folder / "craft.toml"), "--figures", "none"]
    assert main(["identify", str(folder / "flights.csv"), *base, "--out", str(out)]) == 0
    assert "cross-validated by flight: 0.00 %" in capsys.readouterr().out
    vehicle = ["--vehicle", str(out / "vehicle.toml")]
    # As autopilots write them: a file for each flight, which all call it the first.
    alone = [folder / f"day_{number}.csv" for number in range(1, 6)]
    for file, (_, rows) in zip(alone, recorded.flights().groupby("flight"), strict=True):
        rows.assign(flight=1).to_csv(file, index=False)
    assert main(["predict", *map(str, alone), *vehicle, "--out", str(again)]) == 0
    table = pd.read_csv(again / "predictions.csv")
    assert list(table) == ["flight", "measured_energy_J", "predicted_energy_J", "error_percent"]
    assert table["flight"].tolist() == [f"day_{number} 1" for number in range(1, 6)]
    measured = recorded.flights().groupby("flight")["power_W"].sum()
    np.testing.assert_allclose(table["measured_energy_J"], measured, rtol=1e-9)
    np.testing.assert_allclose(table["predicted_energy_J"], measured, rtol=1e-4)
    summary = json.loads((again / "summary.json").read_text())
    assert {"mean_absolute_error_percent", "bias_percent", "power_rmse_W"} <= set(summary)
    report = (out / "report.md").read_text()
    assert "`vehicle.profile_power_coefficient`" in report
    asked = next(line for line in report.splitlines() if line.startswith("**Asked:**"))
    assert "**Found:** 3 numbers, with which the declared equations give the energy" in asked
    assert "**It means:** for flights like these" in asked


def test_the_vehicle_file_is_taken_by_scenarios(folder):
    source = folder / "flown.toml"
    source.write_text(
        'name = "flown"\nvehicle = { use = "craft.toml" }\nwind = { coupling = "drag" }\n'
        'power = { model = "momentum" }\n'
        "mission = { goal = { position = [5, 0, 0] }, duration = 5 }\n"
    )
    assert load_scenario(source).vehicle.electronics_power == plain.M100["electronics"]


@pytest.mark.slow
def test_only_listed_flights_are_fitted(folder, capsys):
    listed = folder / "list.csv"
    listed.write_text("flight,split\n1,fit\n2,fit\n3,extra\n4,fit\n5,extra\n")
    arguments = ["identify", str(folder / "flights.csv"), "--base", str(folder / "craft.toml")]
    arguments += ["--flights", str(listed), "--out", str(folder / "listed"), "--figures", "none"]
    assert main(arguments) == 0
    assert "3 flights" in capsys.readouterr().out


@pytest.mark.slow
def test_the_matrice_100_is_known_from_its_flights():
    frame = read_logs(M100 / "flights.parquet")
    listed = pd.read_csv(M100 / "flight_list.csv").set_index("flight")["split"]
    scenario = vehicle_scenario("dji_matrice_100")
    frame = frame[frame["flight"].map(listed) == "fit"].reset_index(drop=True)
    found = identify(scenario, frame)
    judged = scores(frame, found.cross_validated)
    assert judged.flights == 120
    assert judged.mean_absolute_error_percent < 2.1
    assert abs(judged.bias_percent) < 0.5
    assert judged.power_rmse_W < 54.0
    errors = {t.name: t.scores.mean_absolute_error_percent for t in found.trials}
    assert errors["heavy to light"] < 2.5
    assert errors["slow to fast"] < 3.0
    # The library holds what the flights say, to the digits that it gives.
    for one in found.parameters:
        assert abs(one.value - getattr(scenario.vehicle, one.name)) < 0.1 * one.deviation
    shipped = scores(frame, LoggedMotion(scenario, frame).power())
    assert shipped.mean_absolute_error_percent < 2.1


@pytest.mark.lengthy
def test_halves_of_the_flights_confirm_each_other_and_the_base_is_named(identified):
    """A base that was fitted to the same flights would agree with them whatever they were."""
    for one in identified.parameters:
        assert one.first_half == pytest.approx(PLANTED[one.name], rel=1e-3), one.name
        assert one.second_half == pytest.approx(PLANTED[one.name], rel=1e-3), one.name
    sources = {one.name: one.base_source for one in identified.parameters}
    assert "craft.toml" in sources["profile_power_coefficient"]
    scenario = vehicle_scenario("dji_matrice_100")
    library = identify(scenario, identified.frame, ("climb_power_factor",))
    assert "identified from the 120 flights" in library.parameters[0].base_source


def test_the_error_stands_beside_its_rivals_and_where_the_gain_is(identified, tmp_path):
    write_identification(tmp_path, identified, "craft", Figures.NONE)
    table = pd.read_csv(tmp_path / "models.csv").set_index("model")
    rivals, own = table.iloc[:-1], table.iloc[-1]
    text = (tmp_path / "report.md").read_text()
    headline = next(line for line in text.splitlines() if line.startswith("> "))
    for name, error in rivals["mean_absolute_error_percent"].items():
        assert re.search(rf"{name}, \d numbers?, {error:.2f} %", headline)
    for column in ("mean_absolute_error_percent", "power_rmse_W", "extrapolation_2_error_percent"):
        assert own[column] < rivals[column].min()
        best = f"{rivals[column].idxmin()} {rivals[column].min():.2f}"
        assert best in headline.partition("err less than the best of them in the ")[2]
    assert "; not in the" not in headline


def test_a_rival_that_errs_less_is_said_to():
    models = pd.DataFrame(
        {
            "model": ["one number", "six numbers", "ours"],
            "mean_absolute_error_percent": [2.06, 1.85, 1.86],
            "power_rmse_W": [71.2, 61.3, 49.2],
        }
    )
    energy, power = measures(models, ())
    assert (energy.is_gain, energy.rival, energy.best) == (False, "six numbers", 1.85)
    assert (power.is_gain, power.rival, power.best) == (True, "six numbers", 61.3)
