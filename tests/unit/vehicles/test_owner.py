"""Vehicles from what their owners know: against published tests, closed forms and measurements."""

import tomllib
from math import pi, sqrt

import numpy as np
import pytest

from pyomo_quad.cli import main, own_vehicle
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.flight import Planner
from pyomo_quad.scenario import ScenarioError, load_scenario
from pyomo_quad.vehicles import uncertainty
from pyomo_quad.vehicles.files import example_mission, scenario_of
from pyomo_quad.vehicles.inertia import MassModel
from pyomo_quad.vehicles.owner import Known, estimate_vehicle
from pyomo_quad.vehicles.pack import pack_of
from pyomo_quad.vehicles.propulsion import propeller_of
from pyomo_quad.vehicles.uncertainty import AIRSPEEDS, power_band

ARGUMENTS = (
    *("--mass", "1.5", "--arm", "0.225", "--propeller", "10x4.5", "--kv", "920"),
    *("--battery", "4S5000", "--hover-current", "15", "--hover-voltage", "14.8"),
)
RHO = 1.225


def known(**changes):
    told = {"name": "own", "mass": 1.5, "propeller": propeller_of("10x4.5")}
    return Known(**(told | changes))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("own")
    assert main(["vehicle", "own", *ARGUMENTS, "--out", str(folder), "--quiet"]) == 0
    (folder / "hop.toml").write_text(example_mission("own"))
    return folder


def test_a_propeller_agrees_with_its_static_test():
    """UIUC, APC Slow Flyer 10x4.7: C_T and C_P at 4029, 5147 and 6226 revolutions per minute."""
    propeller = propeller_of("10x4.7")
    for speed, c_t, c_p in ((4029, 0.1136, 0.0466), (5147, 0.1213, 0.0500), (6226, 0.1261, 0.0524)):
        n, d = speed / 60, 0.254
        thrust, power = c_t * RHO * n**2 * d**4, c_p * RHO * n**3 * d**5
        hover = propeller.hover(thrust, RHO)
        assert hover.shaft_power == pytest.approx(power, rel=0.1)
        assert hover.speed == pytest.approx(2 * pi * n, rel=0.08)


def test_a_rotor_takes_more_than_an_ideal_one_and_small_ones_lose_more():
    large, small = propeller_of("15x5").hover(9.0, RHO), propeller_of("1.8x1").hover(0.07, RHO)
    assert large.ideal_power == pytest.approx(
        9.0 * sqrt(9.0 / (2 * RHO * pi * (7.5 * 0.0254) ** 2))
    )
    assert 0.3 < small.figure_of_merit < large.figure_of_merit < 0.8
    assert small.drive_efficiency < 0.5 < large.drive_efficiency < 0.9


def test_a_measured_hover_is_what_the_vehicle_takes(made):
    scenario = load_scenario(made / "hop.toml")
    assert Planner().steady_flight(scenario).hover_power == pytest.approx(15 * 14.8, rel=1e-4)
    assert scenario.battery.use == "own_pack.toml"
    assert scenario.battery.cells_series == 4
    assert scenario.vehicle.voltage_constant == pytest.approx(920 * 2 * pi / 60, rel=1e-5)
    assert scenario.vehicle.efficiency_map is None
    assert scenario.contradictions == ()


def test_every_number_has_a_source(made):
    ranged = {"estimated", "fitted to the hover measurement"}
    for file in ("own.toml", "own_pack.toml"):
        written = tomllib.loads((made / file).read_text())
        tables = [held for held in written.values() if isinstance(held, dict)]
        numbers = {name: one for held in tables for name, one in held.items() if name != "title"}
        assert len(numbers) >= 8
        for name, one in numbers.items():
            kind = one["source"].partition(":")[0]
            assert kind in ranged | {"given", "computed"}, name
            assert ("; range " in one["source"]) is (kind in ranged), name


@pytest.mark.parametrize("rotors", [4, 6, 8])
def test_inertias_are_those_of_the_parts_added_up(rotors):
    """The ring of motors and of rods by points; no part is heavier than the vehicle."""
    model = MassModel(mass=2.0, pack_mass=0.6, arm=0.3, rotors=rotors)
    angles = 2 * pi * np.arange(rotors) / rotors
    tips = 0.22 * 1.4 / rotors * np.sum((0.3 * np.sin(angles)) ** 2)
    along = np.linspace(0, 1, 2001)
    rods = 0.15 * 1.4 / rotors * np.sum((0.3 * np.sin(angles)) ** 2) * np.trapezoid(along**2, along)
    x, y, z = model.moments()
    assert x > tips + rods
    assert x == pytest.approx(tips + rods, rel=0.25)
    assert z < x + y
    assert y > x
    heavy = MassModel(mass=1.0, pack_mass=3.0, arm=0.3, rotors=4)
    assert heavy.empty == 0.5


def test_a_cell_has_the_voltages_that_it_is_said_to_have():
    cell = {name: one.value for name, one in pack_of("4S5000").fields().items()}

    def voltage(charge):
        drawn = (1 - charge) * cell["capacity"]
        return cell["E0"] - cell["K"] / charge + cell["A"] * np.exp(-cell["B"] * drawn)

    assert voltage(1.0) == pytest.approx(4.17, abs=0.01)
    assert voltage(0.5) == pytest.approx(3.78, abs=0.01)
    assert voltage(0.1) == pytest.approx(3.54, abs=0.01)
    assert pack_of("6s2p9000 mAh").fields()["capacity"].value == 4.5


@pytest.mark.lengthy
@pytest.mark.parametrize("rotors", [6, 8])
def test_more_rotors_hover_on_the_same_power_per_disc(rotors):
    """Twice the mass on twice the discs takes twice the power, but for the electronics."""
    four = estimate_vehicle(known())
    more = estimate_vehicle(known(mass=1.5 * rotors / 4, rotors=rotors))
    without = []
    for one in (four, more):
        power = Planner().steady_flight(scenario_of(one)).hover_power
        assert power == pytest.approx(one.estimated_hover_W, rel=1e-3)
        without.append(power - one.fields["electronics_power"].value)
    assert without[1] == pytest.approx(without[0] * rotors / 4, rel=1e-3)


@pytest.mark.lengthy
def test_the_band_holds_the_power_and_a_measured_hover_narrows_it():
    planner = Planner()
    guessed = power_band(estimate_vehicle(known()), planner)
    measured = power_band(
        estimate_vehicle(known(hover_power=222.0, hover_said="15 A at 14.8 V")), planner
    )
    for band in (guessed, measured):
        assert np.all(band.low < band.power)
        assert np.all(band.power < band.high)
        assert len(band.power) == len(AIRSPEEDS)
        shares = [share for _, share in band.ranked()]
        assert shares == sorted(shares, reverse=True)
    hover = [float(b.high[0] - b.low[0]) / float(b.power[0]) for b in (guessed, measured)]
    assert hover[1] < 0.1
    assert hover[0] > 0.25
    assert "hover" in guessed.causes[0].measurement
    assert "--steady" in measured.ranked()[0][0].measurement


@pytest.mark.slow
def test_the_command_says_what_helps_most(tmp_path, capsys):
    told = ["vehicle", "own", "--mass", "1.5", "--propeller", "10x4.5", "--out", str(tmp_path)]
    assert main(told) == ExitCode.VERIFIED
    said = capsys.readouterr().out
    for part in ("power W:", "Least certain: ", "The measurement that helps most: "):
        assert part in said
    assert example_mission("own").splitlines()[1] in said
    assert main(told) == ExitCode.BAD_INPUT
    assert "own.toml: exists already" in capsys.readouterr().err


def test_both_files_of_a_vehicle_are_written_or_none(tmp_path, capsys):
    (tmp_path / "own_pack.toml").write_text("mine")
    told = ["vehicle", "own", *ARGUMENTS, "--out", str(tmp_path), "--quiet"]
    assert main(told) == ExitCode.BAD_INPUT
    assert "own_pack.toml: exists already; give another NAME" in capsys.readouterr().err
    assert [file.name for file in tmp_path.iterdir()] == ["own_pack.toml"]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ((), "needs --mass in kg and --propeller in inches at least"),
        (("--mass", "1.5", "--propeller", "ten"), "must be DIAMETERxPITCH in inches"),
        (("--mass", "-1", "--propeller", "10x4.5"), "--mass -1 kg; must be > 0."),
        (
            ("--mass", "1.5", "--propeller", "10x4.5", "--battery", "big"),
            "must be the cells in series and the mAh",
        ),
        (
            ("--mass", "1.5", "--propeller", "10x4.5", "--hover-voltage", "15"),
            "give --hover-current in A too",
        ),
        (
            ("--mass", "1.5", "--propeller", "10x4.5", "--hover-current", "15"),
            "give --hover-voltage in V or --battery",
        ),
        (
            (
                "--mass",
                "1.5",
                "--propeller",
                "10x4.5",
                "--battery",
                "4S5000",
                "--hover-current",
                "1",
            ),
            "ideal rotors of this size and mass take",
        ),
        (("--mass", "1.5", "--propeller", "10x4.5", "--rotors", "5"), "must be one of 4, 6, 8."),
        (
            ("--mass", "1.5", "--propeller", "10x4.5", "--battery", "4S5000", "--kv", "200"),
            "rpm/V: at 4S 5000 mAh the rotors turn at",
        ),
    ],
)
def test_what_no_vehicle_has_is_refused_in_a_line(arguments, told, tmp_path, capsys):
    assert main(["vehicle", "own", *arguments, "--out", str(tmp_path)]) == ExitCode.BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert told in line
    assert not list(tmp_path.iterdir())


def test_a_terminal_is_asked_for_what_is_not_given(tmp_path, monkeypatch, capsys):
    answers = {
        "mass aloft, kg": ["much", "1.5"],
        "propeller": ["10x4.5"],
        "centre to motor": [""],
        "kv of": ["920"],
        "battery": [""],
        "current in hover": ["15"],
        "voltage in hover": ["14.8"],
    }

    def prompt(text, **_options):
        return next(left for start, left in answers.items() if text.startswith(start)).pop(0)

    monkeypatch.setattr(own_vehicle.typer, "prompt", prompt)
    monkeypatch.setattr(own_vehicle, "is_asked", lambda **_: True)
    monkeypatch.setattr(own_vehicle, "_lines", lambda *_: ["done"])
    monkeypatch.setattr(uncertainty, "power_band", lambda *_: None)
    assert main(["vehicle", "own", "--out", str(tmp_path)]) == ExitCode.VERIFIED
    assert "must be a number" in capsys.readouterr().err
    assert not any(answers.values())
    (tmp_path / "hop.toml").write_text(example_mission("own"))
    scenario = load_scenario(tmp_path / "hop.toml")
    assert scenario.vehicle.mass == 1.5
    assert Planner().steady_flight(scenario).hover_power == pytest.approx(222.0, rel=1e-4)


def test_a_name_is_no_path(tmp_path):
    with pytest.raises(ScenarioError, match="--propeller"):
        propeller_of("99x99")
    assert main(["vehicle", "../own", *ARGUMENTS, "--out", str(tmp_path)]) == ExitCode.BAD_INPUT


@pytest.mark.slow
def test_a_mission_of_40_m_is_flown_at_once(made, monkeypatch):
    monkeypatch.chdir(made)
    assert main(["run", "hop.toml", "--figures", "none", "--quiet"]) == ExitCode.VERIFIED
