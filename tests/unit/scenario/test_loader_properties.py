"""Whatever a file or an override holds, the answer is a scenario or one line for each fault."""

import json

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from pyomo_quad.scenario import PyomoQuadError, Scenario, load_scenario, scenario_from_mapping
from pyomo_quad.scenario.fields import set_value, spell
from pyomo_quad.scenario.messages import field_paths
from tests.scenario_files import LINES, write_scenario

ENOUGH = settings(
    max_examples=150,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
VALID = {
    "name": "hop",
    "mission": {
        "duration": 5.0,
        "goal": {"position": [1.0, 2.0, 3.0]},
        "waypoints": [{"position": [1.0, 1.0, 1.0]}],
    },
    "airspace": {
        "keep_out": [{"name": "balloon", "shape": "sphere", "centre": [9.0, 9.0, 9.0], "radius": 1}]
    },
}
PATHS = sorted(field_paths(Scenario))

toml_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=3)
    ),
    max_leaves=8,
)


def scenario_or_lines(make):
    try:
        assert isinstance(make(), Scenario)
    except PyomoQuadError as error:
        lines = str(error).splitlines()
        assert 1 <= len(lines) <= 21
        assert all(line.strip() for line in lines)


@pytest.mark.lengthy
@ENOUGH
@given(st.sampled_from(PATHS), toml_values)
@example(("wind", "series"), {"\r": None})
def test_any_value_at_any_field(path, value):
    scenario_or_lines(lambda: scenario_from_mapping(set_value(VALID, path, value)))


@pytest.mark.lengthy
@ENOUGH
@given(st.dictionaries(st.text(max_size=10), toml_values, max_size=4))
def test_any_tables(tables):
    scenario_or_lines(lambda: scenario_from_mapping(tables))


@ENOUGH
@given(st.binary(max_size=200))
def test_any_bytes_after_a_valid_start(tmp_path, tail):
    file = write_scenario(tmp_path)
    file.write_bytes(file.read_bytes() + tail)
    scenario_or_lines(lambda: load_scenario(file))


@pytest.mark.lengthy
@ENOUGH
@given(st.binary(max_size=200))
def test_any_wind_file(tmp_path, content):
    (tmp_path / "wind.csv").write_bytes(b"time_s,wind_x_m_per_s,wind_y_m_per_s\n" + content)
    file = write_scenario(tmp_path, 'wind.file = "wind.csv"')
    scenario_or_lines(lambda: load_scenario(file))


@ENOUGH
@given(st.text(max_size=60))
def test_any_override(tmp_path, text):
    file = write_scenario(tmp_path)
    scenario_or_lines(lambda: load_scenario(file, [text]))


@ENOUGH
@given(st.sampled_from(PATHS), st.text(max_size=40))
def test_any_text_as_the_value_of_an_override(tmp_path, path, text):
    file = write_scenario(tmp_path)
    scenario_or_lines(lambda: load_scenario(file, [f"{spell(path)}={text}"]))


@pytest.mark.lengthy
@ENOUGH
@given(
    duration=st.floats(min_value=0.1, max_value=1e4),
    goal=st.tuples(*[st.floats(min_value=-1e4, max_value=1e4)] * 3),
    payload=st.floats(min_value=0.0, max_value=0.3),
)
def test_valid_numbers_arrive_unchanged(tmp_path, duration, goal, payload):
    file = write_scenario(
        tmp_path,
        f"mission.duration = {duration!r}",
        f"mission.goal.position = {json.dumps(goal)}",
        f"vehicle.payload = {payload!r}",
    )
    scenario = load_scenario(file)
    assert scenario.mission.duration == duration
    assert scenario.mission.goal.position == goal
    assert scenario.vehicle.payload == payload


@pytest.mark.parametrize("field", LINES)
def test_one_wrong_letter_in_a_key_is_found(tmp_path, field):
    file = write_scenario(tmp_path)
    file.write_text(file.read_text().replace(f"{field} =", f"{field}x ="))
    with pytest.raises(PyomoQuadError, match=rf"unknown key {field}x; did you mean {field}\?"):
        load_scenario(file)
