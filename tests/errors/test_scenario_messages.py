"""Every message about a scenario, through the file and through --set."""

import re
import tomllib

import pytest
from pydantic import BaseModel

from pyomo_quad.scenario import FeasibilityError, PyomoQuadError, ScenarioError, load_scenario
from pyomo_quad.scenario.fields import merge, spell
from pyomo_quad.scenario.resolution import LARGEST_FILE_BYTES
from tests.scenario_files import write_scenario, write_wind

REFERENCES = ("baseline", "references")

# Line of the scenario -> message after the source.
REFUSED = {
    "mission.duration = -10": "mission.duration = -10 s; must be > 0.",
    "mission.duration = 0": "mission.duration = 0 s; must be > 0.",
    "mission.duration = nan": "mission.duration = nan s; must be finite.",
    'mission.duration = "ten"': 'mission.duration = "ten"; must be a number in s or "free".',
    "mission.duration = true": 'mission.duration = true; must be a number in s or "free".',
    "mission.duration = 1979-05-27": (
        'mission.duration = 1979-05-27; must be a number in s or "free".'
    ),
    "mission.duration = 1e9": (
        "mission.duration = 1e+09 s; must be from 0.001 to 86400: "
        "no quadrotor stays aloft for more than a day."
    ),
    "mission.duration_max = 3": (
        "mission: duration_max is for a free duration, duration = 5 s is fixed; "
        'leave duration_max out or give duration = "free".'
    ),
    'mission.aim = "time"': (
        "mission: aim is for a free duration, duration = 5 s is fixed; "
        'leave aim out or give duration = "free".'
    ),
    'mission.aim = "speed"': "mission.aim = \"speed\"; must be one of 'energy' or 'time'.",
    'mission.yaw = "left"': "mission.yaw = \"left\"; must be one of 'free' or 'kept'.",
    "mission.price_of_time = -1.0": "mission.price_of_time = -1 W; must be >= 0.",
    "mission.goal.position = [1.0, inf, 2.0]": (
        "mission.goal.position[1] = inf m; must be finite."
    ),
    "mission.goal.position = [1.0, 2.0]": (
        "mission.goal.position is too short; give mission.goal.position[2] too, in m."
    ),
    "mission.goal.position = [1.0, 2.0, 3.0, 4.0]": (
        "mission.goal.position = [1.0, 2.0, 3.0, 4.0]; must be a list of at most 3 values."
    ),
    "mission.goal.position = 5.0": "mission.goal.position = 5 m; must be a list in brackets.",
    "vehicle.mas = 1.0": "unknown key vehicle.mas; did you mean vehicle.mass?",
    "mision.goal.yaw = 1.0": "unknown key mision; did you mean mission?",
    "duration = 4.0": "unknown key duration; did you mean mission.duration?",
    "power.zzz = 1": (
        "unknown key power.zzz; known keys here: model, efficiency, torque_floor, "
        "efficiency_floor, air_density, regeneration, smoothing."
    ),
    "vehicle.mass = -1.3": "vehicle.mass = -1.3 kg; must be > 0.",
    "vehicle.payload = -0.1": "vehicle.payload = -0.1 kg; must be >= 0.",
    "battery.K = 11.0": (
        "battery: K = 11 V leaves a full cell -6.8 V; must be below E0 + A = 4.2028 V; correct K, "
        "E0 or A."
    ),
    "vehicle = 3": "vehicle = 3; must be a table.",
    "vehicle.use = 7": "vehicle.use = 7; must be text in quotes.",
    'vehicle.use = "dji_phantom"': (
        "vehicle.use = \"dji_phantom\"; no vehicle named 'dji_phantom'; "
        "there are dji_matrice_100, dji_phantom_2; did you mean dji_phantom_2?"
    ),
    'battery.use = "lead"': (
        "battery.use = \"lead\"; no battery named 'lead'; "
        "there are matrice_100_pack, paper_cell, phantom_2_pack; choose one of these."
    ),
    'wind.forecast.use = "paper_table"': (
        "wind.forecast.use = \"paper_table\"; no wind named 'paper_table'; "
        "there are calm, constant, paper_table_2; did you mean paper_table_2?"
    ),
    'wind.forecast.forecast.use = "calm"': "wind: forecast.forecast is not allowed; remove it.",
    'wind.profile = {law = "power"}': ("wind.profile: law = power needs exponent; give exponent."),
    'wind.profile = {law = "logarithmic", exponent = 0.1}': (
        "wind.profile: law = logarithmic needs roughness; give roughness."
    ),
    'wind.profile = {law = "power", exponent = 0.1, roughness = 0.1}': (
        "wind.profile: roughness has no part in law = power; leave roughness out."
    ),
    'wind.profile = {law = "logarithmic", exponent = 0.1, roughness = 0.1}': (
        "wind.profile: exponent has no part in law = logarithmic; leave exponent out."
    ),
    'wind.profile = {law = "logarithmic", roughness = 6.0}': (
        "wind.profile: roughness = 6 m; must be below half of reference_height = 10 m; "
        "lower it or raise the height."
    ),
    'wind.profile = {law = "power", exponent = -0.1}': (
        "wind.profile.exponent = -0.1; must be > 0."
    ),
    'wind.profile = {law = "power", exponent = 3.0}': (
        "wind.profile.exponent = 3; must be from 0.001 to 1: "
        "the wind over cities grows with height to the power of 0.4."
    ),
    'wind.profile = {law = "log", roughness = 0.1}': (
        "wind.profile.law = \"log\"; must be one of 'power' or 'logarithmic'."
    ),
    'wind.profile = {law = "power", exponent = 0.1, reference_height = 0.0}': (
        "wind.profile.reference_height = 0 m; must be > 0."
    ),
    "wind.profile = 3": "wind.profile = 3; must be a table.",
    "wind.vertical = 1e3": (
        "wind.vertical = 1000 m/s; must be from -150 to 150: "
        "the strongest gust measured on earth had 113 m/s."
    ),
    "wind.series.times = [0.0]": (
        "wind.series.times is not set by hand; name a CSV file in wind.file."
    ),
    'power.model = "motr"': (
        "power.model = \"motr\"; must be one of 'motor', 'efficiency', 'shaft', "
        "'constant_efficiency', 'motor_with_friction' or 'momentum'."
    ),
    "mission.target = 1": "unknown key mission.target; did you mean mission.goal?",
    "power.regeneration = 1": "power.regeneration = 1; must be true or false.",
    "power.efficiency = 1.2": "power.efficiency = 1.2; must be <= 1.",
    "solver.elements = 4.5": "solver.elements = 4.5; must be a whole number.",
    "solver.elements = 0": "solver.elements = 0; must be >= 1.",
    "limits.state_of_charge_min = 100.0": (
        "limits.state_of_charge_min = 100 percent; must be < 100."
    ),
    "limits.speed_max = 0": "limits.speed_max = 0 m/s; must be > 0.",
    "airspace.clearance = -1": "airspace.clearance = -1 m; must be >= 0.",
    "zone.bottom = 9": "unknown key zone; known keys here: name, title, gravity, model, vehicle, "
    "limits, battery, wind, power, mission, air, airspace, solver, baseline.",
    "limits.rotor_speed_max = -1.0": "limits.rotor_speed_max = -1 rad/s; must be > 0.",
    'baseline.references = ["step", "spline"]': (
        "baseline.references[1] = \"spline\"; must be one of 'step', 'quintic', "
        "'minimum_snap', 'plan' or 'cruise'."
    ),
    'name = "../../etc"': (
        "name = \"../../etc\"; must be 1 to 64 letters, digits, '_', '-' or '.', "
        "starting with a letter or digit."
    ),
    'title = "two\\nlines"': 'title = "two?lines"; must be one line.',
    'model = "builder"': 'model = "builder"; must be file.py:function.',
    'wind.file = "missing.csv"': (
        'wind.file = "missing.csv"; cannot be read (No such file or directory); '
        "give an existing CSV file."
    ),
}

_MAST = 'name = "mast", shape = "cylinder", radius = 0.5, bottom = 0'
_BOX = 'name = "hall", shape = "box", low = [4, 0, 0]'
# Keep-out as written -> message after the list's own name.
ZONES_REFUSED = {
    f"{{ {_MAST}, centre = [3, 5] }}": (
        "[0]: cylinder mast has centre, radius, bottom, top; give top."
    ),
    f"{{ {_MAST}, centre = [3, 5], top = 9, low = [0, 0, 0] }}": (
        "[0]: cylinder mast has centre, radius, bottom, top; remove low."
    ),
    f"{{ {_MAST}, centre = [3, 5, 0], top = 9 }}": (
        "[0]: cylinder mast has centre, radius, bottom, top; its centre must be 2 numbers."
    ),
    f"{{ {_MAST}, centre = [3, 5], top = -1 }}": (
        "[0]: cylinder mast has centre, radius, bottom, top; top must be above bottom."
    ),
    f"{{ {_BOX}, high = [5, 0, 3] }}": (
        "[0]: box hall has low, high; high[1] must be above low[1]."
    ),
    '{ name = "balloon", shape = "sphere", centre = [3, 5], radius = 1 }': (
        "[0]: sphere balloon has centre, radius; its centre must be 3 numbers."
    ),
    '{ name = "balloon", shape = "sphere", centre = [3, 5, 6], radius = 0 }': (
        "[0].radius = 0 m; must be > 0."
    ),
    '{ name = "balloon", shape = "ball", centre = [3, 5, 6], radius = 1 }': (
        "[0].shape = \"ball\"; must be one of 'cylinder', 'sphere' or 'box'."
    ),
    '{ shape = "sphere", centre = [3, 5, 6], radius = 1 }': (
        '[0].name is missing; give it. For example: airspace.keep_out[0].name = "church"'
    ),
    '{ name = "a b", shape = "sphere", centre = [3, 5, 6], radius = 1 }': (
        "[0].name = \"a b\"; must be 1 to 64 letters, digits, '_', '-' or '.', starting with a "
        "letter or digit."
    ),
    f"{{ {_BOX}, hight = [5, 2, 3] }}": (
        "unknown key airspace.keep_out[0].hight; did you mean airspace.keep_out[0].high?"
    ),
}


@pytest.mark.parametrize(("zone", "message"), ZONES_REFUSED.items())
def test_a_keep_out_that_is_none(tmp_path, zone, message):
    whole = message if message.startswith("unknown") else f"airspace.keep_out{message}"
    with pytest.raises(ScenarioError, match=re.escape(whole)) as caught:
        load_scenario(write_scenario(tmp_path, f"airspace.keep_out = [{zone}]"))
    assert one_line(caught).endswith(f": {whole}")


_BALLOON = 'name = "balloon", shape = "sphere", radius = 1'
# Lines of the scenario, which flies from (0, 0, 0) to (1, 2, 3) -> message.
OUTSIDE = {
    ("airspace.floor = 0.5",): (
        "mission.start.position = [0.0, 0.0, 0.0] m is below airspace.floor = 0.5 m; raise it or "
        "lower the floor."
    ),
    ("airspace.ceiling = 2.5",): (
        "mission.goal.position = [1.0, 2.0, 3.0] m is above airspace.ceiling = 2.5 m; lower it or "
        "raise the ceiling."
    ),
    (f"airspace.keep_out = [{{ {_BALLOON}, centre = [1, 2, 3.75] }}]",): (
        "mission.goal.position = [1.0, 2.0, 3.0] m is inside keep-out balloon by 0.25 m; move one "
        "of them."
    ),
    (f"airspace.keep_out = [{{ {_BALLOON}, centre = [0, 1.5, 0] }}]", "airspace.clearance = 0.6"): (
        "mission.start.position = [0.0, 0.0, 0.0] m is inside keep-out balloon with its clearance "
        "of 0.6 m by 0.1 m; move one of them."
    ),
    ("airspace.floor = 5.0", "airspace.ceiling = 5.0"): (
        "airspace: floor = 5 m; must be below ceiling = 5 m."
    ),
    ("airspace.keep_out = [{0}, {0}]".format(f"{{ {_BALLOON}, centre = [9, 9, 9] }}"),): (
        "airspace: keep_out has two zones named balloon; name each zone once."
    ),
}


@pytest.mark.parametrize(("lines", "message"), OUTSIDE.items())
def test_places_outside_of_the_airspace(tmp_path, lines, message):
    with pytest.raises(ScenarioError, match=re.escape(message)) as caught:
        load_scenario(write_scenario(tmp_path, *lines))
    assert one_line(caught).endswith(f": {message}")


INFEASIBLE = {
    "limits.rotor_speed_max = 800.0": (
        "hover needs 912.3 rad/s per rotor, limits.rotor_speed_max is 800 rad/s; "
        "raise the limit or lower the mass."
    ),
    "limits.thrust_max = 5.0": (
        "hover needs 12.75 N of thrust, limits.thrust_max is 5 N; "
        "raise the limit or lower the mass."
    ),
}


def test_momentum_needs_a_radius(tmp_path):
    file = write_scenario(tmp_path, 'power.model = "momentum"')
    with pytest.raises(ScenarioError, match=r"vehicle\.rotor_radius is missing") as caught:
        load_scenario(file)
    assert one_line(caught) == (
        f"{file}: vehicle.rotor_radius is missing; power.model momentum needs the radius of one "
        "rotor in m."
    )


ENDS = ("start", "goal")
FREE = 'mission.duration = "free"'
# Lines of a scenario whose duration is free -> message after the source.
REFUSED_WHERE_FREE = {
    ("mission.duration_min = 5.0", "mission.duration_max = 3.0"): (
        "mission: duration_min = 5 s; must be at most duration_max = 3 s; "
        "lower the one or raise the other."
    ),
    ("mission.goal.position = [0.0, 0.0, 0.0]",): (
        'mission: duration = "free" with the goal at the start; the least flight is none at all: '
        "give duration_min or a fixed duration."
    ),
    ("mission.price_of_time = -1.0",): "mission.price_of_time = -1 W; must be >= 0.",
}


def one_line(caught):
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    return message


@pytest.mark.parametrize(("line", "message"), REFUSED.items())
def test_message_through_the_file(tmp_path, line, message):
    file = write_scenario(tmp_path, line)
    with pytest.raises(ScenarioError, match=re.escape(message)) as caught:
        load_scenario(file)
    assert one_line(caught) == f"{file}: {message}"


@pytest.mark.parametrize(("line", "message"), REFUSED.items())
def test_message_through_set(tmp_path, line, message):
    with pytest.raises(ScenarioError, match=re.escape(message)) as caught:
        load_scenario(write_scenario(tmp_path), [line])
    assert one_line(caught) == f"--set: {message}"


@pytest.mark.parametrize(("lines", "message"), REFUSED_WHERE_FREE.items())
def test_message_about_a_free_duration(tmp_path, lines, message):
    with pytest.raises(ScenarioError, match=re.escape(message)) as caught:
        load_scenario(write_scenario(tmp_path), [FREE, *lines])
    assert one_line(caught) == f"--set: {message}"


PLACE = "{ position = [1.0, 1.0, 1.0]%s }"
# Waypoints, and other fields -> message after the source.
REFUSED_WAYPOINTS = {
    (PLACE % ", at = 6.0", ""): (
        "mission: waypoints[0].at = 6 s; must be below duration = 5 s; pass it earlier or fly "
        "longer."
    ),
    (f"{PLACE % ', at = 3.0'}, {{ position = [2.0, 1.0, 1.0], at = 2.0 }}", ""): (
        "mission: waypoints[1].at = 2 s; must be later than 3 s, when waypoints[0] is left at the "
        "earliest; give rising times."
    ),
    (f"{PLACE % ', hold = 2.0'}, {{ position = [2.0, 1.0, 1.0], at = 1.5 }}", ""): (
        "mission: waypoints[1].at = 1.5 s; must be later than 2 s, when waypoints[0] is left at "
        "the earliest; give rising times."
    ),
    (PLACE % ", at = 6.0", 'mission.duration = "free"\nmission.duration_max = 5.5'): (
        "mission: waypoints[0].at = 6 s; must be below duration_max = 5.5 s; pass it earlier or "
        "fly longer."
    ),
    (PLACE % ", hold = 5.0", ""): (
        "mission: waypoints hold until 5 s at the earliest; must be below duration = 5 s; hold "
        "less or fly longer."
    ),
    (PLACE % ", release = 0.4", "vehicle.payload = 0.1"): (
        "mission.waypoints release 0.4 kg in all; must be at most vehicle.payload = 0.1 kg; "
        "release less or carry more."
    ),
    (PLACE % ", hold = -1.0", ""): "mission.waypoints[0].hold = -1 s; must be >= 0.",
    (PLACE % ", radius = -1.0", ""): "mission.waypoints[0].radius = -1 m; must be >= 0.",
    (PLACE % ", speed_max = 0.0", ""): "mission.waypoints[0].speed_max = 0 m/s; must be > 0.",
    ("{ hold = 1.0 }", ""): "mission.waypoints[0].position is missing; give it in m. For example:",
    (f"{PLACE % ''}, {PLACE % ''}", ""): (
        "mission: waypoints[1] is the very place of waypoints[0]; leave one out, and give hold to "
        "stay."
    ),
    ("{ position = [1.0, 2.0, 3.0] }", ""): (
        "mission: goal is the very place of waypoints[0]; leave one out, and give hold to stay."
    ),
    (f"{PLACE % ''}, {{ position = [2.0, 0.0, 0.0] }}, {PLACE % ''}", 'mission.order = "best"'): (
        'mission: waypoints[2] is the very place of waypoints[0]; order = "best" passes each place '
        "once: leave one out."
    ),
    (PLACE % ", at = 2.0", 'mission.order = "best"'): (
        'mission: waypoints[0].at = 2 s fixes a time; order = "best" chooses it: leave at out or '
        "give the order."
    ),
    (
        ", ".join(f"{{ position = [{k}.0, 9.0, 1.0] }}" for k in range(11)),
        'mission.order = "best"',
    ): (
        'mission: order = "best" of 11 waypoints; must be at most 10; give the order or leave some '
        "out."
    ),
}


@pytest.mark.parametrize(("given", "message"), REFUSED_WAYPOINTS.items())
def test_message_about_waypoints(tmp_path, given, message):
    waypoints, other = given
    lines = [f"mission.waypoints = [{waypoints}]", *filter(None, other.split("\n"))]
    with pytest.raises(ScenarioError, match=re.escape(message)) as caught:
        load_scenario(write_scenario(tmp_path), lines)
    assert message in one_line(caught)


@pytest.mark.parametrize(
    ("airspace", "message"),
    [
        ("floor = 2.5", "mission.waypoints[0].position = [1.0, 1.0, 1.0] m"),
        ("ceiling = 0.5", "mission.waypoints[0].position = [1.0, 1.0, 1.0] m"),
    ],
)
def test_a_waypoint_outside_the_airspace(tmp_path, airspace, message):
    height = 3.0 if "floor" in airspace else 0.0
    ends = [f"mission.{end}.position = [0.0, {k}.0, {height}]" for k, end in enumerate(ENDS)]
    lines = [*ends, f"mission.waypoints = [{PLACE % ''}]", f"airspace.{airspace}"]
    with pytest.raises(ScenarioError, match=re.escape(message)) as caught:
        load_scenario(write_scenario(tmp_path), lines)
    assert message in one_line(caught)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (
            ["mission.duration_max = 20.0"],
            (
                "wind from 0 to 9 s does not cover the mission from 0 to 20 s; give a longer file "
                "or shorten mission.duration_max."
            ),
        ),
        (["wind.time_offset = 9.0"], "wind from 0 to 9 s does not cover the mission from 9 to"),
        (["wind.time_offset = -1.0"], "wind from 0 to 9 s does not cover the mission from -1 to"),
    ],
)
def test_a_measured_wind_covers_a_free_duration(tmp_path, lines, message):
    write_wind(tmp_path, range(10))
    file = write_scenario(tmp_path, FREE, 'wind.file = "wind.csv"', *lines)
    with pytest.raises(ScenarioError, match=re.escape(message)) as caught:
        load_scenario(file)
    assert one_line(caught).startswith(f'{file}: wind.file = "wind.csv"; ')


@pytest.mark.parametrize(("line", "message"), INFEASIBLE.items())
@pytest.mark.parametrize("through_set", [False, True])
def test_infeasible_hover(tmp_path, line, message, through_set):
    file = write_scenario(tmp_path, *([] if through_set else [line]))
    with pytest.raises(FeasibilityError, match=re.escape(message)) as caught:
        load_scenario(file, [line] if through_set else [])
    assert one_line(caught) == f"{file}: {message}"


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("mission.duration", '"mission.duration" is not PATH=VALUE; write for example'),
        ("mission.goal.position[\u0661] = 1", '[\u0661] = 1" is not PATH=VALUE'),
        ("a b = 1", '"a b = 1" is not PATH=VALUE; write for example'),
        ("mission.duration=", "mission.duration = ; must be a TOML value, such as 12.0"),
        ("gravity=1\nname=2", "gravity = 1?name=2; must be a TOML value, such as 12.0"),
        ("gravity=" + "[" * 10_000, "must be a TOML value, such as 12.0"),
        ("mission.goal.position[3]=1.0", "mission.goal.position[3] = 1; there is no such place"),
        ("mission.duration.unit=1.0", "mission.duration.unit = 1; there is no such place"),
    ],
)
def test_override_that_is_none(tmp_path, override, message):
    with pytest.raises(ScenarioError, match=re.escape(message)) as caught:
        load_scenario(write_scenario(tmp_path), [override])
    assert one_line(caught).startswith("--set: ")


def test_missing_field(tmp_path):
    file = tmp_path / "short.toml"
    file.write_text('name = "short"\nmission.goal.position = [1.0, 2.0, 3.0]\n')
    with pytest.raises(ScenarioError, match=r"mission\.duration is missing; give it in s\."):
        load_scenario(file)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"mission = [", r"not valid TOML \(.*\); correct it\."),
        (b"name = '\xff'", r"not valid TOML \(.*\); correct it\."),
        (b"a = " + b"[" * 100_000, r"not valid TOML \(nested too deep\); correct it\."),
        (b"a" + b".a" * 50_000 + b" = 1", r"not valid TOML \(nested too deep\); correct it\."),
        (b"a = [[[[[[[[[[1]]]]]]]]]]", r"nested deeper than 8 levels; a scenario is a shallow"),
        (b"#" * (LARGEST_FILE_BYTES + 1), r"larger than 1000000 bytes; a scenario is a short"),
    ],
)
def test_broken_file(tmp_path, content, message):
    file = tmp_path / "broken.toml"
    file.write_bytes(content)
    with pytest.raises(ScenarioError, match=message) as caught:
        load_scenario(file)
    assert one_line(caught).startswith(f"{file}: ")


@pytest.mark.parametrize("name", ["missing.toml", ".", "nul\0byte.toml"])
def test_file_that_cannot_be_read(tmp_path, name):
    with pytest.raises(ScenarioError, match=r"cannot be read \(.*\); give an existing TOML file"):
        load_scenario(tmp_path / name)


@pytest.mark.parametrize(
    ("times", "wind", "message"),
    [
        ([0, 1, 3, 2, 4, 5, 6], None, "time 2 s follows 3 s; times must rise"),
        ([0, 1, 2, 2, 4, 5, 6], None, "time 2 s follows 2 s; times must rise"),
        ([0, 1, 2, 3, 4, 10], None, "gap of 6 s after 4 s; steps must be <= 5 s, fill the gap"),
        (
            [0, 1, 2, 3, 4],
            None,
            (
                "wind from 0 to 4 s does not cover the mission from 0 to 5 s; "
                "give a longer file or shorten mission.duration"
            ),
        ),
        ([1, 2, 3, 4, 5, 6], None, "wind from 1 to 6 s does not cover the mission"),
        ([0, 2, 6], None, "3 rows; must have 4 to 200000"),
        ([0, 1, 2, 6], [0, 1, "nan", 0], "line 4 holds a number that is not finite"),
        ([0, 1, 2, 6], [0, 1, "", 0], "line 4 must hold 3 numbers"),
        ([0, 1, 2, 6], [0, 1, "=1+1", 0], "line 4 must hold 3 numbers"),
        ([0, 1, "2_0", 60], None, "line 4 must hold 3 numbers"),
        ([0, 1, 2, 6], [0, 1, "2_0", 0], "line 4 must hold 3 numbers"),
        ([0, 1, 2, 6], [0, 1, "\u0662", 0], "line 4 must hold 3 numbers"),
        ([0, 1, 2, 6], [0, 1, "\uff11.5", 0], "line 4 must hold 3 numbers"),
        ([0, 1, 2, 6], [0, 1, "0x10", 0], "line 4 must hold 3 numbers"),
        ([0, 1, 2, 6], [0, 1, "1e999", 0], "line 4 holds a number that is not finite"),
    ],
)
def test_wind_file(tmp_path, times, wind, message):
    write_wind(tmp_path, times, wind)
    file = write_scenario(tmp_path, 'wind.file = "wind.csv"')
    with pytest.raises(ScenarioError, match=re.escape(message)) as caught:
        load_scenario(file)
    assert one_line(caught).startswith(f'{file}: wind.file = "wind.csv"; ')


BY_HEIGHT = "height_m,wind_x_m_per_s,wind_y_m_per_s"


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (BY_HEIGHT + "\n1,2,3", "1 rows; must have 2 to 200000"),
        (BY_HEIGHT + "\n1,2,3\n1,2,3", "height 1 m follows 1 m; heights must rise"),
        (BY_HEIGHT + "\n3,2,3\n1,2,3", "height 1 m follows 3 m; heights must rise"),
        (BY_HEIGHT + "\n1,2,3\n2,2", "line 3 must hold 3 numbers"),
        (BY_HEIGHT + "\n1,2,3\n2,2,nan", "line 3 holds a number that is not finite"),
        (BY_HEIGHT + "\n1,2,3\n2,151,3", "line 3 has a wind of 151 m/s; must be within 150 m/s"),
        (
            BY_HEIGHT + "\n1,2,3\n2e6,2,3",
            "line 3 is of 2e+06 m; heights must be within 100000 m",
        ),
        (
            BY_HEIGHT + "".join(f"\n{z},2,3" for z in range(41)),
            "41 heights; must have 2 to 40",
        ),
        (
            "height_m,time_s,wind_x_m_per_s,wind_y_m_per_s",
            "time_s,wind_x_m_per_s,wind_y_m_per_s, with height_m in place of or after time_s for",
        ),
        (
            "time_s," + BY_HEIGHT + "\n0,1,2,3\n0,2,2,3\n1,1,2,3\n1,3,2,3",
            "for the heights of 0 s; every time must have the same heights, in the same order.",
        ),
        (
            "time_s," + BY_HEIGHT + "\n0,1,2,3\n0,2,2,3\n1,1,2,3\n2,2,2,3",
            "the rows of 1 s are not for the heights of 0 s;",
        ),
        (
            "time_s," + BY_HEIGHT + "\n0,1,2,3\n0,2,2,3\n1,1,2,3\n1,2,2,3\n2,1,2,3",
            "the rows of 2 s are not for the heights of 0 s;",
        ),
        (
            "time_s," + BY_HEIGHT + "\n0,1,2,3\n0,2,2,3\n9,1,2,3\n9,2,2,3",
            "2 times; must have at least 4.",
        ),
        (
            "time_s," + BY_HEIGHT + "".join(f"\n{t},{z},2,3" for t in range(5) for z in (1, 2)),
            "wind from 0 to 4 s does not cover the mission from 0 to 5 s;",
        ),
    ],
)
def test_wind_file_by_height(tmp_path, table, message):
    (tmp_path / "wind.csv").write_text(table)
    file = write_scenario(tmp_path, 'wind.file = "wind.csv"')
    with pytest.raises(ScenarioError, match=re.escape(message)) as caught:
        load_scenario(file)
    assert one_line(caught).startswith(f'{file}: wind.file = "wind.csv"; ')


def test_wind_by_height_has_no_other_profile_and_any_duration(tmp_path):
    (tmp_path / "wind.csv").write_text(BY_HEIGHT + "\n0,2,3\n9,4,6")
    line = 'wind.file = "wind.csv"'
    assert load_scenario(write_scenario(tmp_path, FREE, line)).wind.varies_with_height
    file = write_scenario(tmp_path, line, 'wind.profile = {law = "power", exponent = 0.2}')
    with pytest.raises(ScenarioError, match="profile has no part in a wind whose file has heights"):
        load_scenario(file)


def test_wind_file_with_other_columns(tmp_path):
    (tmp_path / "wind.csv").write_text("t,x,y\n0,1,2\n")
    file = write_scenario(tmp_path, 'wind.file = "wind.csv"')
    with pytest.raises(ScenarioError, match="first line must be time_s,wind_x_m_per_s,wind_y_m"):
        load_scenario(file)


def test_wind_file_that_is_no_text(tmp_path):
    (tmp_path / "wind.csv").write_bytes(b"\x89PNG\xff\x00")
    file = write_scenario(tmp_path, 'wind.file = "wind.csv"')
    with pytest.raises(ScenarioError, match="is not a CSV text file; save it as comma-separated"):
        load_scenario(file)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"mission.duration": -1.0}, r"mission\.duration = -1 s; must be > 0"),
        ({"vehicle.mas": 1.0}, r"unknown key vehicle\.mas; did you mean vehicle\.mass\?"),
        ({"no path": 1.0}, r"'no path' is not the path of a field"),
        ({"vehicle.payload": 5.0}, r"hover needs .* rad/s per rotor"),
    ],
)
def test_with_values(tmp_path, values, message):
    scenario = load_scenario(write_scenario(tmp_path))
    with pytest.raises(PyomoQuadError, match=message):
        scenario.with_values(values)


# A number that no vehicle on earth can have -> what is allowed, and why.
UNSOUND = {
    "wind.speed = 1e308": (
        "wind.speed = 1e+308 m/s; must be from -150 to 150: the strongest gust measured on earth "
        "had 113 m/s."
    ),
    "wind.x.amplitudes = [0.0, 1e200, 0.0]": "each must be from -150 to 150: the strongest gust",
    "wind.y.mean = -1e5": "wind.y.mean = -100000 m/s; must be from -150 to 150: the strongest gust",
    "mission.duration = 1e6": (
        "mission.duration = 1e+06 s; must be from 0.001 to 86400: no quadrotor stays aloft for "
        "more than a day."
    ),
    "mission.goal.position = [1e300, 0.0, 0.0]": "each must be from -100000 to 100000: a quadrotor",
    "vehicle.Ix = 1e-12": (
        "vehicle.Ix = 1e-12 kg*m^2; must be from 1e-09 to 1e+06: a gram at a millimetre has 1e-9, "
        "ten tonnes at ten metres have 1e6."
    ),
    "vehicle.thrust_coefficient = 1e300": "must be from 1e-12 to 100: a rotor of a centimetre",
    "battery.E0 = 1e9": "must be from 0.1 to 100: the cells of all chemistries have 1 to 5 V.",
    "limits.rotor_acceleration_max = 1e-300": "must be from 0.01 to 1e+08: a rotor takes",
    "baseline.gains.rotor = 1e9": "must be from 0.001 to 10000: no loop is faster than",
    "gravity = 1e-30": "must be from 0.1 to 100: it is 9.81 on earth, 1.62 on the moon",
    "solver.tolerance = 1e-16": "must be from 1e-11 to 0.1: sums of thousands of terms are rounded",
    "solver.elements = 100000": (
        "solver: elements = 100000 of degree = 4 make 400000 points; must make at most 50000: more "
        "do not fit into memory"
    ),
}


@pytest.mark.parametrize("line", UNSOUND)
def test_numbers_that_nothing_real_has(line, tmp_path):
    with pytest.raises(ScenarioError, match=re.escape(UNSOUND[line])):
        load_scenario(write_scenario(tmp_path, line))
    with pytest.raises(ScenarioError, match=re.escape(UNSOUND[line])):
        load_scenario(write_scenario(tmp_path), [line])


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
            assert len(str(caught.value).splitlines()) == 1


def test_wind_file_stronger_than_any_wind(tmp_path):
    write_wind(tmp_path, range(7), [0.0, 1.0, 2.0, 1e308, 0.0, 0.0, 0.0])
    file = write_scenario(tmp_path, 'wind.file = "wind.csv"')
    message = (
        r"line 5 has a wind of 1e\+308 m/s; must be within 150 m/s: the strongest gust measured"
    )
    with pytest.raises(ScenarioError, match=message):
        load_scenario(file)
    write_wind(tmp_path, [1e300, 2e300, 3e300, 4e300])
    with pytest.raises(
        ScenarioError, match=r"line 2 is of 1e\+300 s; times must be within 1e\+09 s"
    ):
        load_scenario(file)


@pytest.mark.parametrize(
    ("given", "example"),
    [
        ("", 'name is missing; give it. For example: name = "delivery"'),
        (
            'name = "hop"',
            "For example: mission = { goal = { position = [6.0, 7.0, 8.0] }, duration = 10.0 }",
        ),
        (
            'name = "hop"\nmission.duration = 5.0',
            "is missing; give it. For example: mission.goal = { position = [6.0, 7.0, 8.0] }",
        ),
        (
            'name = "hop"\nmission.goal.position = [1.0, 2.0, 3.0]',
            "mission.duration is missing; give it in s. For example: mission.duration = 10.0",
        ),
    ],
)
def test_what_is_missing_comes_with_an_example_that_works(given, example, tmp_path):
    file = tmp_path / "hop.toml"
    file.write_text(given)
    with pytest.raises(ScenarioError, match=re.escape(example)):
        load_scenario(file)
    rest = {"name": '"hop"', "mission": "{ goal = { position = [1, 2, 3] }, duration = 5 }"}
    suggested = tomllib.loads(example.partition("For example: ")[2])
    whole = merge(
        merge(
            tomllib.loads("\n".join(f"{k} = {v}" for k, v in rest.items())), tomllib.loads(given)
        ),
        suggested,
    )
    assert load_scenario(whole).name in {"hop", "delivery"}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"mission.yaw": "kept", "mission.goal.yaw": 1.0},
            (
                'mission: yaw = "kept" where start, waypoints and goal have several headings; give '
                'all of them the same, or yaw = "free".'
            ),
        ),
        (
            {"mission.yaw": "kept", "vehicle.attitude": "paper"},
            (
                'mission.yaw = "kept" under vehicle.attitude = "paper"; must be "free" where '
                "rotors that gather speed do not turn the body: leave it out, or give "
                'vehicle.attitude = "euler".'
            ),
        ),
    ],
)
def test_a_yaw_that_cannot_be_kept(tmp_path, changes, message):
    with pytest.raises(ScenarioError, match=re.escape(message)):
        load_scenario(write_scenario(tmp_path), changes)
