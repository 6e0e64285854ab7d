"""Every message about a scenario, through the file and through --set."""

import re
import tomllib
from pathlib import Path

import pytest
from pydantic import BaseModel

from pyomo_quad.scenario import FeasibilityError, PyomoQuadError, ScenarioError, load_scenario
from pyomo_quad.scenario.fields import merge, spell
from pyomo_quad.scenario.resolution import LARGEST_FILE_BYTES
from tests.scenario_files import write_scenario, write_wind

CASES = tomllib.loads(Path(__file__).with_name("scenario_messages.toml").read_text("utf-8"))
REFERENCES = ("baseline", "references")
FREE = 'mission.duration = "free"'
WIND = 'wind.file = "wind.csv"'


def cases(name):
    """Give a test every case of a table of the data file."""
    return pytest.mark.parametrize("case", CASES[name])


def refuses(case, error, source, load, *arguments):
    """Check the message by which a case is refused: one line, with its source and text."""
    whole = case.get("message")
    pattern = case.get("pattern") or re.escape(whole or case["part"])
    with pytest.raises(error, match=pattern) as caught:
        load(*arguments)
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    assert message.startswith(source)
    if whole is not None:
        assert message == source + whole


@pytest.mark.parametrize(
    ("case", "error", "is_of_set"),
    [
        *((case, ScenarioError, True) for case in CASES["refused"]),
        *((case, ScenarioError, False) for case in CASES["disagreeing"]),
        *((case, FeasibilityError, False) for case in CASES["infeasible"]),
    ],
)
def test_lines_of_a_scenario(tmp_path, case, error, is_of_set):
    file = write_scenario(tmp_path, *case["lines"])
    refuses(case, error, f"{file}: ", load_scenario, file)
    file = write_scenario(tmp_path)
    refuses(
        case, error, "--set: " if is_of_set else f"{file}: ", load_scenario, file, case["lines"]
    )


NESTED = {"override": "gravity=" + "[" * 10_000, "part": "must be a TOML value, such as 12.0"}


@pytest.mark.parametrize("case", [*CASES["override"], NESTED])
def test_override_that_is_none(tmp_path, case):
    file = write_scenario(tmp_path)
    refuses(case, ScenarioError, "--set: ", load_scenario, file, [case["override"]])


TOO_DEEP = r"not valid TOML \(nested too deep\); correct it\."
# What is no text, or too much for a data file.
BROKEN = [
    {"text": b"name = '\xff'", "pattern": r"not valid TOML \(.*\); correct it\."},
    {"text": b"a = " + b"[" * 100_000, "pattern": TOO_DEEP},
    {"text": b"a" + b".a" * 50_000 + b" = 1", "pattern": TOO_DEEP},
    {
        "text": b"#" * (LARGEST_FILE_BYTES + 1),
        "part": "larger than 1000000 bytes; a scenario is a short",
    },
]


@pytest.mark.parametrize("case", [*CASES["file"], *BROKEN])
def test_broken_file(tmp_path, case):
    file, text = tmp_path / "broken.toml", case["text"]
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    refuses(case, ScenarioError, f"{file}: ", load_scenario, file)


@pytest.mark.parametrize("name", ["missing.toml", ".", "nul\0byte.toml"])
def test_file_that_cannot_be_read(tmp_path, name):
    with pytest.raises(ScenarioError, match=r"cannot be read \(.*\); give an existing TOML file"):
        load_scenario(tmp_path / name)


@cases("wind")
def test_wind_file(tmp_path, case):
    if "table" in case:
        (tmp_path / "wind.csv").write_text(case["table"])
    else:
        write_wind(tmp_path, case["times"], case.get("speeds"))
    file = write_scenario(tmp_path, WIND, *case.get("lines", ()))
    refuses(case, ScenarioError, f"{file}: {WIND}; ", load_scenario, file)


def test_wind_file_that_is_no_text(tmp_path):
    (tmp_path / "wind.csv").write_bytes(b"\x89PNG\xff\x00")
    file = write_scenario(tmp_path, WIND)
    with pytest.raises(ScenarioError, match="is not a CSV text file; save it as comma-separated"):
        load_scenario(file)


def test_wind_by_height_has_no_other_profile_and_any_duration(tmp_path):
    (tmp_path / "wind.csv").write_text("height_m,wind_x_m_per_s,wind_y_m_per_s\n0,2,3\n9,4,6")
    assert load_scenario(write_scenario(tmp_path, FREE, WIND)).wind.varies_with_place
    file = write_scenario(tmp_path, WIND, 'wind.profile = {law = "power", exponent = 0.2}')
    with pytest.raises(ScenarioError, match=r"profile cannot be used with a wind\.file that has"):
        load_scenario(file)


@cases("values")
def test_values_of_a_program(tmp_path, case):
    scenario = load_scenario(write_scenario(tmp_path))
    refuses(case, PyomoQuadError, "", scenario.with_values, {case["path"]: case["value"]})


def finite_numbers(table, path=()):
    """Walk over all fields of numbers, the tables in tables included."""
    for name in type(table).model_fields:
        value = getattr(table, name)
        if isinstance(value, BaseModel):
            yield from finite_numbers(value, (*path, name))
        elif isinstance(value, float) or (value and isinstance(value, tuple)):
            yield (*path, name), value


def test_no_number_is_without_bounds(tmp_path):
    """Whatever field one tries: 1e308 is refused, by itself or in a list, in one line."""
    write_wind(tmp_path, range(6))
    scenario = load_scenario(write_scenario(tmp_path))
    numbers = [(path, old) for path, old in finite_numbers(scenario) if path != REFERENCES]
    assert len(numbers) > 60
    for path, old in numbers:
        for value in (1e308, -1e308):
            new = [value] * len(old) if isinstance(old, tuple) else value
            with pytest.raises(PyomoQuadError, match=re.escape(spell(path))) as caught:
                scenario.with_values({spell(path): new})
            first, *others = str(caught.value).splitlines()
            assert spell(path) in first
            # A table that a field begins may need more of its fields.
            assert all("is missing; give it" in line for line in others)


@cases("missing")
def test_what_is_missing_comes_with_an_example_that_works(tmp_path, case):
    file, given = tmp_path / "hop.toml", "\n".join(case["lines"])
    file.write_text(given)
    refuses(case, ScenarioError, f"{file}: ", load_scenario, file)
    rest = {"name": "hop", "mission": {"goal": {"position": [1, 2, 3]}, "duration": 5}}
    suggested = tomllib.loads(case["part"].partition("For example: ")[2])
    whole = merge(merge(rest, tomllib.loads(given)), suggested)
    assert load_scenario(whole).name in {"hop", "delivery"}
