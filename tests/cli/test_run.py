"""`pyomo-quad run` and `compare` through the command: optimum, baselines, proof, documents."""

import json
import shutil

import pandas as pd
import pytest

from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.report.report import find_run
from pyomo_quad.scenario import load_scenario
from tests.command import IMPOSSIBLE, PAPER_CALM, QUICK, SCENARIOS, run_here

pytestmark = pytest.mark.lengthy

FIRST_COLUMNS = [
    "scenario",
    "flight",
    "duration_s",
    "energy_J",
    "owed_energy_J",
    "hover_energy_J",
    "excess_energy_J",
    "lower_bound_J",
    "optimality_gap_percent",
    "saving_percent",
    "saving_of_excess_percent",
    "terminal_miss_m",
    "arrived",
    "limits_kept",
    "broken_limits",
    "verified",
    "peak_power_W",
]
FLIGHTS = [
    "optimal",
    "adaptive/cruise tuned",
    "adaptive/step",
    "adaptive/quintic",
    "adaptive/minimum_snap",
    "adaptive/plan",
    "mpc/estimated",
    "open_loop/plan",
]

# Each flight that is planned again takes as long as all others together.
NONE = "--set=baseline.mpc.knowledge=[]"
ESTIMATED = ("baseline.mpc.knowledge=['estimated']", "baseline.mpc.interval=2.5")


@pytest.fixture(scope="module")
def wind(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wind") / "report"
    options = [f"--set={field}" for field in ESTIMATED]
    return run_here("run", str(SCENARIOS / "paper_wind.toml"), *options, out=folder)


def test_run_is_verified_and_compared(wind):
    assert (wind.status, wind.complaints) == (ExitCode.VERIFIED, [])
    frame = pd.read_csv(wind.folder / "comparison.csv")
    assert list(frame.columns)[: len(FIRST_COLUMNS)] == FIRST_COLUMNS
    assert frame["flight"].tolist() == FLIGHTS
    rows = frame.set_index("flight")
    assert rows.loc["adaptive/quintic", "terminal_miss_m"] < 0.05
    assert rows["arrived"].all()
    assert (rows["energy_J"] > rows["lower_bound_J"]).all()
    settled = rows["energy_J"] + rows["owed_energy_J"]
    saved = 100 * (1 - settled["optimal"] / settled["adaptive/quintic"])
    assert rows.loc["adaptive/quintic", "saving_percent"] == pytest.approx(saved, rel=1e-6)
    # The tuned autopilot has the same time, and is above the bound of all flights.
    assert rows.loc["adaptive/cruise tuned", "duration_s"] == pytest.approx(10.0)
    saving = rows.loc["adaptive/cruise tuned", "saving_percent"]
    assert wind.summary["headline"]["against"]["saving_percent"] == pytest.approx(saving)
    assert f"{saving:.2f} % less energy than an autopilot tuned" in wind.out.splitlines()[0]


def test_the_table_of_flights_fits_a_terminal(wind):
    table = [line.rstrip() for line in wind.out.splitlines() if line.startswith(" ")]
    assert max(map(len, table)) <= 80
    flown = [line for line in table if line.endswith("arrived")]
    assert [line.split("  ")[0].strip() for line in flown] == FLIGHTS


def test_optimum_is_within_a_percent_of_the_best(wind):
    certificate = wind.summary["certificate"]
    assert certificate["applies"]
    assert 0 < certificate["gap_percent"] < 1
    assert f"{certificate['lower_bound_J']:.3f} J" in wind.out


def test_controls_flown_by_the_controllers_plant_cost_what_the_plan_says(wind):
    energy = {flight["flight"]: flight["energy_J"] for flight in wind.summary["flights"]}
    assert energy["open_loop/plan"] == pytest.approx(wind.summary["energy_J"], rel=1e-6)


def test_run_writes_every_document(wind):
    names = {file.name for file in wind.folder.iterdir()}
    documents = {"report.md", "report.html", "comparison.csv", "comparison.md", "plan.csv"}
    assert documents | {"summary.json", "figures"} <= names
    assert {"fly", "certify", "solve", "report"} <= set(wind.summary["wall_s"])


@pytest.mark.slow
def test_run_of_an_impossible_mission_compares_nothing(tmp_path, capsys):
    folder = tmp_path / "report"
    status = main(["run", PAPER_CALM, *IMPOSSIBLE, "--out", str(folder), "--json"])
    summary = json.loads(capsys.readouterr().out)
    assert status == ExitCode.NOT_SOLVED
    assert (summary["status"], summary["flights"]) == ("infeasible", [])
    assert summary["certificate"]["gap_percent"] is None
    assert (folder / "report.md").read_text().startswith("# Failed, infeasible: ")


@pytest.mark.slow
def test_a_wind_that_the_optimiser_was_not_told(tmp_path, capsys):
    folder = tmp_path / "report"
    arguments = ["run", str(SCENARIOS / "wind_untold.toml"), *QUICK, "--out", str(folder)]
    assert main([*arguments, NONE, '--set=baseline.references=["plan"]']) == ExitCode.VERIFIED
    assert (
        "the plan was made for a forecast that differs from the actual wind."
        in capsys.readouterr().out
    )
    rows = pd.read_csv(folder / "comparison.csv").set_index("flight")
    assert rows["arrived"].to_dict() == {
        "optimal": True,
        "adaptive/plan": True,
        "open_loop/plan": False,
    }
    assert rows["saving_percent"].isna().all()
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["certificate"]["gap_percent"] is None


def test_compare_makes_one_table(tmp_path, capsys):
    folder = tmp_path / "table"
    files = [str(SCENARIOS / f"paper_{name}.toml") for name in ("calm", "wind")]
    references = '--set=baseline.references=["quintic"]'
    arguments = ["compare", *files, *QUICK, NONE, references, "--figures=png", "--out", str(folder)]
    assert main(arguments) == ExitCode.VERIFIED
    frame = pd.read_csv(folder / "comparison.csv")
    flights = ["optimal", "adaptive/quintic", "open_loop/plan"]
    assert frame["scenario"].tolist() == ["paper_calm"] * 3 + ["paper_wind"] * 3
    assert frame["flight"].tolist() == flights * 2
    assert "adaptive/quintic" in capsys.readouterr().out
    assert "(figures/energy_compared.png)" in (folder / "comparison.md").read_text()
    page = (folder / "report.html").read_text()
    assert page.count("<img") == 1
    # Names may break at slashes.
    assert page.replace("<wbr>", "").count("adaptive/quintic") >= 4


def test_compare_takes_a_finished_run_that_matches_from_its_folder(
    wind, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(wind.folder, tmp_path / "reports" / "paper_wind")
    options = [f"--set={field}" for field in ESTIMATED]
    assert main(["compare", str(SCENARIOS / "paper_wind.toml"), *options]) == ExitCode.VERIFIED
    said = capsys.readouterr().out
    assert "paper_wind: read from reports/paper_wind, which holds the same run." in said
    made = tmp_path / "reports" / "comparison" / "comparison.csv"
    assert made.read_text() == (wind.folder / "comparison.csv").read_text()


def replace_in(file, old, new):
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("summary.json", '"duration": 10.0', '"duration": 9.0'),
        ("summary.json", '"verified": true,\n  "accuracy"', '"verified": false,\n  "accuracy"'),
        ("summary.json", '"pyomo_quad": "', '"pyomo_quad": "0.'),
        ("summary.json", "{", "["),
        ("comparison.csv", "energy_J", "energy_kJ"),
        ("comparison.csv", "True", "perhaps"),
    ],
)
def test_a_run_of_something_else_or_a_damaged_one_is_not_taken(wind, tmp_path, name, old, new):
    folder = shutil.copytree(wind.folder, tmp_path / "run")
    scenario = load_scenario(SCENARIOS / "paper_wind.toml", ESTIMATED)
    assert find_run(folder, scenario) is not None
    assert find_run(folder, scenario.with_values({"mission.duration": 9.0})) is None
    replace_in(folder / name, old, new)
    assert find_run(folder, scenario) is None


def test_a_run_whose_search_for_margins_chose_the_gains_is_taken(wind, tmp_path):
    folder = shutil.copytree(wind.folder, tmp_path / "run")
    scenario = load_scenario(SCENARIOS / "paper_wind.toml", ESTIMATED)
    summary = json.loads((folder / "summary.json").read_text())
    summary["scenario_resolved"]["baseline"]["gains"]["position"] = 2.0
    (folder / "summary.json").write_text(json.dumps(summary))
    assert find_run(folder, scenario) is None
    summary["risk"] = {"gains": {"position": 2.0}}
    (folder / "summary.json").write_text(json.dumps(summary))
    assert find_run(folder, scenario) is not None
    assert find_run(folder, scenario.with_values({"baseline.gains.position": 1.7})) is None


def test_compare_refuses_before_it_solves(tmp_path, capsys):
    assert main(["compare", PAPER_CALM, str(tmp_path / "no.toml")]) == ExitCode.BAD_INPUT
    assert "no.toml: cannot be read" in capsys.readouterr().err
