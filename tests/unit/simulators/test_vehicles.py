"""Vehicles of RotorPy: their files load, fly there, and their bodies are the same body turned."""

from importlib import util
from itertools import product

import numpy as np
import pandas as pd
import pytest

from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.flight import Planner, outside_plant
from pyomo_quad.flight.outside_plant import ACROSS, MASSLESS_ROTORS, OutsidePlant, Pilot
from pyomo_quad.report.document import REPORT_NAME
from pyomo_quad.scenario import Reference, ScenarioError, load_scenario
from pyomo_quad.simulators.report import write_outside_report
from pyomo_quad.simulators.study import (
    BREEZE,
    CASES,
    CAUSES,
    DRAG_CASES,
    EXACT,
    OUR_HEADING,
    STIFF,
    TOLD,
    OutsideColumn,
    OutsideStudy,
    Plant,
    arrivals,
)
from pyomo_quad.simulators.vehicles import NAMES, rotorpy_parameters, vehicle_file
from tests.scenario_files import write_scenario

has_rotorpy = pytest.mark.skipif(util.find_spec("rotorpy") is None, reason="no RotorPy")


@has_rotorpy
@pytest.mark.parametrize("name", NAMES)
def test_the_file_is_the_vehicle_that_rotorpy_flies(name, tmp_path, capsys):
    """Slowly turning in still air, where drag is nothing: its body moves as RotorPy's own does."""
    assert main(["rotorpy-vehicle", name, "--out", str(tmp_path / f"{name}.toml")]) == 0
    assert f'vehicle.use = "{name}.toml" in a scenario beside it' in capsys.readouterr().out
    still = f'vehicle = {{ use = "{name}.toml", attitude = "euler" }}'
    scenario = load_scenario(write_scenario(tmp_path, still))
    assert scenario.provenance["vehicle.mass"] == f"file {name}.toml"
    dynamics = Planner().dynamics(scenario)
    theirs = OutsidePlant(
        scenario,
        dynamics,
        parameters=rotorpy_parameters(name),
        frame=ACROSS,
        habits=MASSLESS_ROTORS,
    )
    hover = scenario.vehicle.hover_speed(scenario.gravity)
    turning = hover * np.array([1.02, 0.99, 1.01, 0.97])
    x = np.array([
        turning[int(state[-2]) - 1] if "omega" in state else 0.0 for state in dynamics.state_names
    ])  # fmt: skip
    rates = theirs.rates(0.0, theirs.started(x, ()), lambda _t, _x, _own: (np.zeros(4), ()))
    declared = dict(zip(dynamics.state_names, dynamics.rates(0.0, x, np.zeros(4)), strict=True))
    assert rates[5] == pytest.approx(declared["rigid_body.vz"], rel=1e-12)
    held, turned = rotorpy_parameters(name), theirs.turned_back(rates[10:13])
    # The product of inertia that turning the body brings, and that the file leaves out.
    left_out = abs(held["Ixx"] - held["Iyy"]) / (held["Ixx"] + held["Iyy"])
    found = [declared[f"rigid_body.{axis}"] for axis in "pqr"]
    allowed = (left_out + left_out**2) * np.linalg.norm(found) + 1e-9
    assert turned == pytest.approx(found, abs=allowed, rel=0)


def test_names_that_are_none_are_refused(tmp_path, monkeypatch, capsys):
    with pytest.raises(ScenarioError, match="must be one of hummingbird, crazyflie"):
        vehicle_file("bumblebee")

    def missing(name):
        raise ModuleNotFoundError(name=name.partition(".")[0])

    monkeypatch.setattr(outside_plant, "import_module", missing)
    monkeypatch.chdir(tmp_path)
    for command in (["rotorpy-vehicle", "crazyflie"], ["outside-plant"]):
        assert main(command) == ExitCode.BAD_INPUT
        assert "pip install 'pyomo_quad[rotorpy]'" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_flights_are_counted_that_two_integrators_confirm():
    """Of every outside plant: counts of some plants could not be found again in the table."""
    rows = [
        (Plant.DECLARED, "adaptive", True, True),
        (Plant.ROTORPY, "adaptive", True, True),
        (Plant.AT_500_HZ, "adaptive", False, True),
        (Plant.AT_100_HZ, "adaptive", True, False),
        (Plant.ROTORPY, "se3", False, False),
        (Plant.ROTORPY, STIFF, True, True),
    ]
    names = (
        OutsideColumn.PLANT,
        OutsideColumn.CONTROLLER,
        OutsideColumn.ARRIVED,
        OutsideColumn.VERIFIED,
    )
    flights = pd.DataFrame(rows, columns=[name.value for name in names])
    assert arrivals(flights, "adaptive") == (1, 2, 1)
    assert arrivals(flights, "se3") == (0, 0, 1)


UNCONFIRMED = {
    (Plant.AT_100_HZ, str(Pilot.ADAPTIVE)),
    (Plant.WITHOUT_SLEW_LIMIT, str(Pilot.SE3)),
}


@has_rotorpy
def test_the_report_says_how_far_apart_flights_end(tmp_path):
    """Of flights whose numbers say which they are."""
    flights = list(
        product(
            (*CASES, *NAMES),
            Plant,
            (*Pilot, TOLD, STIFF, OUR_HEADING),
            (Reference.PLAN, Reference.QUINTIC, Reference.STEP),
        )
    )
    rows = [
        {
            OutsideColumn.CASE: case,
            OutsideColumn.PLANT: plant.value,
            OutsideColumn.CONTROLLER: str(controller),
            OutsideColumn.FOLLOWED: followed.value,
            OutsideColumn.APART: 1e-6 * (k + 1),
            OutsideColumn.ENERGY: 700.0 + k,
            OutsideColumn.ENERGY_DIFFERENCE: 0.1,
            OutsideColumn.MISS: 0.5,
            OutsideColumn.ARRIVED: case == EXACT,
            OutsideColumn.VERIFIED: (plant, controller) not in UNCONFIRMED,
        }
        for k, (case, plant, controller, followed) in enumerate(flights)
    ]
    times = np.linspace(0.0, 10.0, 5)
    tracks = {
        (case, plant, pilot): (times, 1e-3 * times)
        for case, plant in CAUSES.values()
        for pilot in (Pilot.OPEN_LOOP, Pilot.ADAPTIVE)
    }
    study = OutsideStudy(flights=pd.DataFrame(rows), tracks=tracks, lag_s=0.0125)
    write_outside_report(tmp_path, study)
    text = (tmp_path / REPORT_NAME).read_text()
    alone = EXACT, Plant.ROTORPY, Pilot.OPEN_LOOP, Reference.PLAN
    assert f"plan made with exact attitude ends {1e-6 * (flights.index(alone) + 1):.2g} m" in text
    table = pd.read_csv(tmp_path / "flights.csv")
    counts = {}
    for controller in ("adaptive", "se3"):
        mine = table[(table.controller == controller) & (table.plant != "declared")]
        sure = mine[mine.verified]
        counts[controller] = f"{sure.arrived.sum()} of {len(sure)}"
        left = f"{len(mine) - len(sure)} of `{controller}`"
        assert f"{counts[controller]} of `{controller}`" in text
        assert left in text.partition("not verified and left out are")[2].partition("\n")[0]
        assert arrivals(table, controller) == (
            sure.arrived.sum(),
            len(sure),
            len(mine) - len(sure),
        )
    assert f"feedback {counts['adaptive']} verified flights of our controller arrive" in text
    assert f"and {counts['se3']} of RotorPy's own" in text
    for case in DRAG_CASES:
        assert f"| `{case}`: {CASES[case][0]} | " in text
    for cause, (case, plant) in CAUSES.items():
        ends = [
            f"{1e-6 * (flights.index((case, plant, pilot, Reference.PLAN)) + 1):.2g} | 0.100"
            if (plant, pilot) not in UNCONFIRMED
            else "not verified | not verified"
            for pilot in (Pilot.OPEN_LOOP, Pilot.ADAPTIVE)
        ]
        assert f"| {cause} | `{case}`, {plant.value} | {' | '.join(ends)} |" in text
    leap = flights.index((EXACT, Plant.ROTORPY, Pilot.SE3, Reference.STEP))
    assert f"| `se3` | within the limit | {700 + leap}.00 | 0.5 | yes |" in text
    assert "| `se3` | as fast as asked | not verified | not verified | no |" in text
    # What is not verified is named where it would have explained something, and not explained.
    assert "our controller's flight is not verified, so that the table has no number of it" in text
    told = flights.index((BREEZE, Plant.ROTORPY, TOLD, Reference.QUINTIC))
    assert f"told the air's force, it ends 0.5 m from the goal for {700 + told}.00 J" in text
    assert "with their lag, of 12.5 ms" in text
    assert (tmp_path / "figures" / "causes.svg").is_file()
    assert len(table) == len(rows)
