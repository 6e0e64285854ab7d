"""A scenario is completed from default, library, file and overrides, in this order."""

import json
import pickle

import pytest

from pyomo_quad.scenario import (
    Attitude,
    Scenario,
    ScenarioError,
    load_scenario,
    scenario_from_mapping,
)
from tests.command import SCENARIOS
from tests.scenario_files import write_scenario, write_wind

REPORTS = SCENARIOS.parent / "reports"


def test_layers_in_order(tmp_path):
    file = write_scenario(tmp_path, "vehicle.payload = 0.1", "vehicle.mass = 1.2")
    scenario = load_scenario(file, ["vehicle.payload=0.2"])
    assert scenario.vehicle.total_mass == pytest.approx(1.4)
    said = scenario.provenance
    assert said["vehicle.payload"] == "--set"
    assert said["vehicle.mass"] == "scenario"
    assert said["vehicle.Ix"] == "library dji_phantom_2"
    assert said["battery.use"] == "default"
    assert said["solver.degree"] == "default"


def test_last_override_wins(tmp_path):
    scenario = load_scenario(write_scenario(tmp_path), ["gravity=1.0", "gravity=2"])
    assert scenario.gravity == 2.0


def test_override_of_one_number_of_a_list(tmp_path):
    scenario = load_scenario(write_scenario(tmp_path), ["mission.goal.position[2]=9"])
    assert scenario.mission.goal.position == (1.0, 2.0, 9.0)


def test_override_takes_bare_words_as_text(tmp_path):
    assert load_scenario(write_scenario(tmp_path), ["wind.use=paper_table_2"]).wind.x.mean == 1.0


def test_thrust_limits_follow_the_rotor_speed_limit(tmp_path):
    scenario = load_scenario(write_scenario(tmp_path), ["limits.rotor_speed_max=1000.0"])
    kb, kappa, arm = 3.8305e-6, 2.2518e-8, 0.175
    assert scenario.limits.thrust_max == pytest.approx(4 * kb * 1e6)
    assert scenario.limits.roll_moment_max == pytest.approx(arm * kb * 1e6)
    assert scenario.limits.pitch_moment_max == pytest.approx(arm * kb * 1e6)
    assert scenario.limits.yaw_moment_max == pytest.approx(2 * kappa * 1e6)


def test_derived_limits_follow_changed_values(tmp_path):
    scenario = load_scenario(write_scenario(tmp_path))
    changed = scenario.with_values({"vehicle.thrust_coefficient": 2 * 3.8305e-6})
    assert changed.limits.thrust_max == pytest.approx(2 * scenario.limits.thrust_max)


def test_with_values_keeps_earlier_overrides(tmp_path):
    scenario = load_scenario(write_scenario(tmp_path), ["gravity=3.7"])
    changed = scenario.with_values({"mission.goal.position[0]": 4.0, "wind.use": "constant"})
    assert changed.gravity == 3.7
    assert changed.mission.goal.position == (4.0, 2.0, 3.0)
    assert changed.wind.speed == 1.0
    assert scenario.wind.speed == 0.0


@pytest.mark.parametrize(
    ("line", "cause"),
    [
        ("vehicle.drag_linear=0.1", "drag_linear"),
        ("vehicle.drag_quadratic=0.1", "drag_quadratic"),
        ("vehicle.rotor_drag_plane=1e-5", "rotor_drag_plane"),
        ("vehicle.rotor_drag_axis=1e-5", "rotor_drag_axis"),
        ("vehicle.parasitic_drag=[0.0, 0.0, 0.01]", "parasitic_drag"),
        ("vehicle.translational_lift=1e-5", None),
    ],
)
@pytest.mark.parametrize("wind", ["calm", "constant"])
def test_the_wind_acts_through_the_drag_of_a_vehicle_that_has_any(tmp_path, wind, line, cause):
    lines = [f"wind.use={wind}", "vehicle.drag_linear=0.0", line]
    scenario = load_scenario(write_scenario(tmp_path), lines)
    expected, why = ("acceleration", "no drag") if cause is None else ("drag", f"vehicle.{cause}")
    assert scenario.wind.coupling == expected
    assert scenario.provenance["wind.coupling"] == f"default: the vehicle has {why}"


def test_the_coupling_by_default_follows_the_vehicle_and_gives_way_to_what_is_said(tmp_path):
    scenario = load_scenario(write_scenario(tmp_path))
    assert scenario.wind.coupling == "drag"
    assert scenario.with_values({"vehicle.drag_linear": 0.0}).wind.coupling == "acceleration"
    printed = scenario.with_values({"wind.coupling": "acceleration"})
    assert printed.wind.coupling == "acceleration"
    assert printed.with_values({"vehicle.drag_linear": 0.5}).wind.coupling == "acceleration"


def test_the_papers_own_winds_act_as_it_prints(tmp_path):
    scenario = load_scenario(write_scenario(tmp_path), ["wind.use=paper_table_2"])
    assert scenario.wind.coupling == "acceleration"
    assert scenario.provenance["wind.coupling"] == "library paper_table_2"
    for name in ("paper_calm", "paper_free", "paper_wind", "paper_free_wind", "wind_untold"):
        shipped = load_scenario(SCENARIOS / f"{name}.toml")
        assert {shipped.wind.coupling, shipped.as_forecast().wind.coupling} == {"acceleration"}


def test_a_forecast_has_the_coupling_of_the_wind_unless_it_is_given_its_own(tmp_path):
    lines = ["wind.use=constant", "wind.forecast.use=paper_table_2"]
    scenario = load_scenario(write_scenario(tmp_path), lines)
    assert scenario.as_forecast().wind.coupling == "drag"
    assert scenario.provenance["wind.forecast.coupling"] == "wind.coupling"
    own = load_scenario(write_scenario(tmp_path), [*lines, "wind.forecast.coupling=acceleration"])
    assert (own.wind.coupling, own.as_forecast().wind.coupling) == ("drag", "acceleration")


def test_forecast_is_a_wind_of_its_own(tmp_path):
    lines = ["wind.use=paper_table_2", "wind.coupling=drag", "wind.forecast.use=calm"]
    scenario = load_scenario(write_scenario(tmp_path), lines)
    told = scenario.as_forecast()
    assert scenario.wind.x.mean == 1.0
    assert told.wind.x.mean == 0.0
    assert told.wind.coupling == scenario.wind.coupling
    assert told.as_forecast() is told


def test_wind_file_is_read_beside_the_scenario(tmp_path):
    write_wind(tmp_path, [0, 1, 2, 3, 4, 5], [0, 1, 2, 3, 4, 5])
    scenario = load_scenario(write_scenario(tmp_path, 'wind.file = "wind.csv"'))
    assert scenario.wind.series.times == (0, 1, 2, 3, 4, 5)
    assert scenario.wind.series.wind_y == (0, 1, 2, 3, 4, 5)
    assert scenario.provenance["wind.series.times"] == "file wind.csv"


def test_a_record_keeps_the_wind_of_a_file_that_is_no_longer_there(tmp_path):
    write_wind(tmp_path, [0, 1, 2, 3, 4, 5], [0, 1, 2, 3, 4, 5])
    scenario = load_scenario(write_scenario(tmp_path, 'wind.file = "wind.csv"'))
    (tmp_path / "wind.csv").unlink()
    record = Scenario.model_validate(scenario.model_dump(mode="json"))
    assert record.with_values({"mission.duration": 4.0}).wind == scenario.wind
    with pytest.raises(ScenarioError, match="does not cover the mission from 0 to 6 s"):
        record.with_values({"mission.duration": 6.0})
    for told in ({"wind.file": "other.csv"}, {"wind": {"use": "calm", "file": "other.csv"}}):
        with pytest.raises(ScenarioError, match=r"other\.csv"):
            record.with_values(told)


def test_wind_time_offset_moves_the_mission_along_the_file(tmp_path):
    write_wind(tmp_path, list(range(10, 17)))
    lines = ('wind.file = "wind.csv"', "wind.time_offset = 11.0")
    assert load_scenario(write_scenario(tmp_path, *lines)).wind.series.times[0] == 10


def test_resolved_scenario_survives_json_and_pickle(tmp_path):
    scenario = load_scenario(write_scenario(tmp_path), ["wind.use=paper_table_2"])
    again = Scenario.model_validate(scenario.model_dump(mode="json"))
    assert again == scenario
    assert hash(again) == hash(scenario)
    assert pickle.loads(pickle.dumps(scenario)) == scenario
    assert again.with_values({"vehicle.mass": 1.2}).vehicle.mass == 1.2


def test_own_model_need_not_hover(tmp_path):
    lines = ('model = "drop.py:build"', "limits.rotor_speed_max = 1.0")
    assert load_scenario(write_scenario(tmp_path, *lines)).model == "drop.py:build"


def test_mapping_serves_as_a_file():
    tables = {
        "name": "hop",
        "mission": {"duration": 5, "goal": {"position": [1, 2, 3]}},
    }
    scenario = scenario_from_mapping(tables)
    assert scenario.mission.goal.position == (1.0, 2.0, 3.0)
    assert isinstance(scenario.mission.duration, float)


TABLES = {"name": "hop", "mission": {"duration": 5, "goal": {"position": [1, 2, 3]}}}


@pytest.mark.parametrize(
    "overrides",
    [
        ["mission.duration=8.0", "vehicle.payload=0.1"],
        {"mission.duration": 8.0, "vehicle.payload": 0.1},
        {"mission": {"duration": 8.0}, "vehicle": {"payload": 0.1}},
    ],
)
def test_a_mapping_says_what_a_file_and_set_would(tmp_path, overrides):
    scenario = load_scenario(TABLES, overrides)
    assert scenario == load_scenario(write_scenario(tmp_path), overrides)
    assert (scenario.mission.duration, scenario.vehicle.payload) == (8.0, 0.1)
    assert scenario.mission.goal.position == (1.0, 2.0, 3.0)


def test_one_override_may_stand_alone():
    assert load_scenario(TABLES, "mission.duration=8.0").mission.duration == 8.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (({**TABLES, "mision": 1},), r"scenario: unknown key mision; did you mean mission\?"),
        ((TABLES, {"mission.duratoin": 1}), r"overrides: unknown key mission.duratoin; did you"),
        ((TABLES, {"": 1}), r'overrides: "" is not the path of a field; write for example'),
        ((TABLES, {"a.b" * 3000: 1}), r"is not the path of a field"),
        ((TABLES, [".".join("a" * 3000) + "=1"]), r"--set: .* is not PATH=VALUE; write for"),
    ],
)
def test_a_mapping_is_refused_as_a_file_is(given, message):
    with pytest.raises(ScenarioError, match=message) as caught:
        load_scenario(*given)
    assert len(str(caught.value)) < 300


def test_scenario_cannot_be_changed(tmp_path):
    scenario = load_scenario(write_scenario(tmp_path))
    with pytest.raises(ValueError, match="frozen"):
        scenario.gravity = 1.0


OWN_VEHICLE = """
use = "dji_phantom_2"
[fields]
title = "Mine"
drag_linear = 0.3
[fields.mass]
value = 1.1
source = "weighed"
[limits]
roll_max = 0.6
"""


def test_vehicle_from_a_file_beside_the_scenario(tmp_path):
    (tmp_path / "mine.toml").write_text(OWN_VEHICLE)
    file = write_scenario(tmp_path, 'vehicle.use = "mine.toml"', "vehicle.drag_linear = 0.4")
    scenario = load_scenario(file)
    assert scenario.vehicle.use == "mine.toml"
    assert scenario.vehicle.mass == 1.1
    assert scenario.vehicle.drag_linear == 0.4
    assert scenario.vehicle.Ix == 0.081
    assert scenario.limits.roll_max == 0.6
    assert scenario.provenance["vehicle.mass"] == "file mine.toml"
    # A stored scenario is complete: its vehicle's file may have gone.
    stored = Scenario.model_validate_json(scenario.model_dump_json())
    (tmp_path / "mine.toml").unlink()
    assert stored.with_values({"vehicle.payload": 0.2}).vehicle.total_mass == pytest.approx(1.3)


def test_what_a_vehicle_file_inherits_names_the_library_that_gave_it(tmp_path):
    (tmp_path / "mine.toml").write_text(OWN_VEHICLE)
    file = write_scenario(tmp_path, 'vehicle.use = "mine.toml"', "air.height = 2000.0")
    said = load_scenario(file).provenance
    assert said["vehicle.use"] == "scenario"
    assert said["vehicle.mass"] == said["limits.roll_max"] == "file mine.toml"
    inherited = ("vehicle.Ix", "vehicle.efficiency_map.cubic", "limits.pitch_max")
    assert {said[field] for field in inherited} == {"library dji_phantom_2"}
    assert said["vehicle.thrust_coefficient"].startswith("library dji_phantom_2, in air of ")


def test_a_copy_of_the_librarys_file_is_the_same_vehicle(tmp_path):
    from importlib import resources

    library = resources.files("pyomo_quad.scenario").joinpath("library")
    for kind, name in (("vehicles", "dji_phantom_2"), ("batteries", "paper_cell")):
        text = library.joinpath(kind, f"{name}.toml").read_text(encoding="utf-8")
        (tmp_path / f"{name}.toml").write_text(text)
    named = write_scenario(tmp_path, 'battery.use = "paper_cell"')
    library_own = load_scenario(named)
    uses = {"vehicle.use": "dji_phantom_2.toml", "battery.use": "paper_cell.toml"}
    own = load_scenario(named, uses)
    assert own.limits == library_own.limits
    for table in ("vehicle", "battery"):
        ours, theirs = getattr(own, table), getattr(library_own, table)
        assert ours.model_copy(update={"use": theirs.use}) == theirs


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, r'vehicle.use = "mine.toml"; .*mine.toml: cannot be read \(No such file'),
        ("mass = 1.0", r"unknown key mass; a file of vehicles has \[fields\] and \[limits\]"),
        ("fields = 3", r"mine.toml: fields = 3; must be a table"),
        ("use = 3", r"mine.toml: use = 3; must be text in quotes"),
        ('use = "drone"', r"no vehicle named 'drone'"),
        ('use = "dji_phantom_2"\n[fields]\nmass = -1.0', r"mine.toml: vehicle.mass = -1 kg; must"),
        ("[fields]\nmass = 1.0", r"vehicle.title is missing; give it"),
        ("[fields", r"mine.toml: not valid TOML"),
    ],
)
def test_a_vehicle_file_that_is_none(tmp_path, text, message):
    if text is not None:
        (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(ScenarioError, match=message):
        load_scenario(write_scenario(tmp_path, 'vehicle.use = "mine.toml"'))


@pytest.mark.parametrize("name", ["paper_calm", "paper_wind", "wind_untold"])
def test_records_of_the_papers_scenarios_stay_as_they_were_written(name):
    written = json.loads((REPORTS / name / "summary.json").read_text())["scenario_resolved"]
    scenario = load_scenario(SCENARIOS / f"{name}.toml")
    assert scenario.vehicle.attitude is Attitude.PAPER
    # What the flight is compared with may grow.
    recorded = scenario.model_dump(mode="json") | {"baseline": written["baseline"]}
    assert recorded == written
    assert Scenario.model_validate(written).vehicle == scenario.vehicle


def test_attitude_is_exact_unless_the_file_or_an_older_record_means_another(tmp_path):
    scenario = load_scenario(write_scenario(tmp_path))
    assert scenario.vehicle.attitude is Attitude.EULER
    assert scenario.provenance["vehicle.attitude"] == "default"
    record = scenario.model_dump(mode="json")
    assert record["vehicle"]["attitude"] == "euler"
    assert Scenario.model_validate(record) == scenario
    del record["vehicle"]["attitude"]
    older = Scenario.model_validate(record)
    assert older.vehicle.attitude is Attitude.PAPER
    assert older.with_values({"gravity": 9.8}).vehicle.attitude is Attitude.PAPER
