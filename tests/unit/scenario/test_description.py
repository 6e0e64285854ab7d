"""What editors and people are told of the fields is what the loader takes."""

import json
import tomllib

import jsonschema
import pytest

from pyomo_quad.cli import main
from pyomo_quad.scenario import Scenario, ScenarioError, describe_fields, load_scenario
from pyomo_quad.scenario.description import writable_fields
from tests.command import SCENARIOS

SHIPPED = sorted(SCENARIOS.glob("*.toml"))
PAGES = ("README.md", "scenario.schema.json", "study.schema.json")


def schema_of(file):
    first = file.read_text(encoding="utf-8").splitlines()[0]
    named = file.parent / first.removeprefix("#:schema ")
    return json.loads(named.read_text(encoding="utf-8"))


def refused_by(schema, document):
    return [error.json_path for error in jsonschema.Draft7Validator(schema).iter_errors(document)]


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.stem)
def test_a_shipped_file_names_a_schema_that_takes_it(file):
    assert refused_by(schema_of(file), tomllib.loads(file.read_text(encoding="utf-8"))) == []


def test_the_shipped_pages_are_those_of_the_command(tmp_path, capsys):
    assert main(["schema", "--out", str(tmp_path)]) == 0
    assert [line.rpartition("/")[2] for line in capsys.readouterr().out.split()] == list(PAGES)
    for page in PAGES:
        made, shipped = ((folder / page).read_text("utf-8") for folder in (tmp_path, SCENARIOS))
        assert made == shipped


def test_schemas_go_to_a_folder_that_is_there(tmp_path, capsys):
    assert main(["schema", "--out", str(tmp_path / "none")]) == 2
    assert "is not a folder; create it first." in capsys.readouterr().err


@pytest.mark.parametrize(
    ("table", "field", "value"),
    [
        ("mission", "duration", -1.0),
        ("mission", "duration", "10 s"),
        ("mission", "durations", 10.0),
        ("wind", "coupling", "lift"),
        ("wind", "speed", 1e308),
        ("vehicle", "mass", 1e-9),
        ("solver", "elements", 1.5),
    ],
)
def test_what_the_loader_refuses_an_editor_marks(table, field, value):
    file = SCENARIOS / "paper_calm.toml"
    document = tomllib.loads(file.read_text(encoding="utf-8"))
    document.setdefault(table, {})[field] = value
    (where,) = set(refused_by(schema_of(file), document))
    assert where.startswith(f"$.{table}")
    with pytest.raises(ScenarioError, match=field):
        load_scenario(document)


def test_every_field_of_a_scenario_is_listed():
    held = {field.path for field in describe_fields(load_scenario(SCENARIOS / "paper_calm.toml"))}
    listed = {field.path: field for field in writable_fields(Scenario)}
    # Two are read from wind.file and wind.field, never written by hand; the others are
    # tables that are not there.
    absent = {"airspace.keep_in", "airspace.keep_out", "baseline.mpc", "mission.origin"}
    absent |= {"mission.waypoints", "wind.profile", "wind.turbulence"}
    absent |= {"battery.relaxation", "battery.thermal", "battery.health"}
    assert held - set(listed) == {"wind.series", "wind.grid", "airspace.ground", *absent}
    assert listed["mission.duration"].unit == "s"
    assert listed["solver.tolerance"].default == "1e-06"
    assert all(field.meaning for field in listed.values())


def test_fields_of_a_list_of_tables_are_described_one_by_one():
    told = load_scenario(
        SCENARIOS / "paper_calm.toml",
        {
            "airspace.keep_out": [
                {"name": "mast", "shape": "sphere", "centre": [3, 3, 9], "radius": 1}
            ]
        },
    ).with_values({"airspace.keep_out[0].radius": 2.0})
    held = {field.path: field for field in describe_fields(told)}
    radius = held["airspace.keep_out[0].radius"]
    assert (radius.value, radius.unit, radius.meaning) == (2.0, "m", "cylinder, sphere: radius")
    assert radius.origin == held["airspace.keep_out[0].centre"].origin == "overrides"
