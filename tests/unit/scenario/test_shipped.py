"""What `pyomo-quad init` starts from: every shipped scenario, renamed, in a folder of its own."""

import json
import tomllib

import jsonschema
import pandas as pd
import pytest

from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.scenario import ScenarioError, load_scenario
from pyomo_quad.scenario.description import shipped_scenarios, started_scenario


@pytest.mark.parametrize("template", sorted(shipped_scenarios()))
def test_a_scenario_begun_from_each_is_its_own_and_is_allowed(
    template, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert main(["init", "own", "--from", template]) == ExitCode.VERIFIED
    assert "Written to own.toml. Fly it: pyomo-quad run own.toml" in capsys.readouterr().out
    text = (tmp_path / "own.toml").read_text()
    original = shipped_scenarios()[template].read_text()
    assert text.count("#") > 5
    begun, shipped = tomllib.loads(text), tomllib.loads(original)
    assert begun == shipped | {"name": "own"}
    assert load_scenario("own.toml").name == "own"
    # The editor's schema, named in the first line, lies beside it and takes the file.
    assert text.startswith("#:schema ./scenario.schema.json\n")
    schema = json.loads((tmp_path / "scenario.schema.json").read_text())
    jsonschema.validate(begun, schema)


def test_a_delivery_an_inspection_and_the_paper_are_there():
    assert {"delivery", "inspection", "paper", "parcel", "street"} <= set(shipped_scenarios())


@pytest.mark.slow
@pytest.mark.parametrize("template", ["parcel", "delivery", "inspection"])
def test_what_is_begun_is_flown(template, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["init", "own", "--from", template, "--quiet"]) == ExitCode.VERIFIED
    assert main(["solve", "own.toml", "--figures", "none", "--quiet"]) == ExitCode.VERIFIED
    zones = load_scenario("own.toml").airspace.keep_out
    for row in pd.read_csv("reports/own/plan.csv").itertuples():
        for zone in zones:
            assert zone.depth((row.x_m, row.y_m, row.z_m)) < 1e-3


def test_init_asks_for_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["init", "--quiet"]) == ExitCode.VERIFIED
    (file,) = tmp_path.glob("*.toml")
    assert load_scenario(file).name == file.stem


def test_nothing_is_overwritten(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.toml").write_text("mine")
    (tmp_path / "scenario.schema.json").write_text("mine too")
    assert main(["init", "own"]) == ExitCode.BAD_INPUT
    assert "own.toml: exists already; give another NAME" in capsys.readouterr().err
    assert (tmp_path / "own.toml").read_text() == "mine"
    assert main(["init", "other"]) == ExitCode.VERIFIED
    assert (tmp_path / "scenario.schema.json").read_text() == "mine too"


def test_what_is_no_template_or_no_name_is_refused():
    with pytest.raises(ScenarioError, match=r"--from moon: must be one of .*paper"):
        started_scenario("moon", "own")
    with pytest.raises(ScenarioError, match=r'NAME = "../own"; must be 1 to 64 letters'):
        started_scenario("paper", "../own")
