"""The committed report on the paper against the same numbers computed anew at reduced cost."""

from pathlib import Path

import pandas as pd
import pytest

from pyomo_quad.paper.experiments import (
    BaselineCase,
    Experiment,
    FlightCase,
    fly_baseline_case,
    fly_case,
    wind_cases,
)
from pyomo_quad.paper.readings import Reading
from pyomo_quad.paper.report import TOLERANCES
from pyomo_quad.paper.rotor_map import chattering_floors
from pyomo_quad.paper.study import pack_facts
from pyomo_quad.scenario import PowerModel, Reference

FOLDER = Path("reports/paper")
SMOOTH_POWERS = (PowerModel.MOTOR, PowerModel.MOTOR_WITH_FRICTION)


def committed(table):
    return pd.read_csv(FOLDER / f"{table}.csv")


def check(table, row, found):
    for held in (tolerance for tolerance in TOLERANCES if tolerance.table == table):
        for column in set(held.columns) & found.keys():
            assert found[column] == pytest.approx(float(row[column]), rel=held.relative), column


def energies(flown):
    return {"energy_J": flown.flight.energy_J, "hover_energy_J": flown.hover_energy_J}


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("experiment", "model"),
    [
        pytest.param(experiment, model, marks=[pytest.mark.slow] * ((row + column) % 2))
        for row, experiment in enumerate(Experiment)
        for column, model in enumerate(SMOOTH_POWERS)
    ],
)
def test_the_optima_of_both_experiments_are_those_committed(experiment, model):
    frame = committed("experiments")
    row = frame[(frame.experiment == experiment) & (frame.power_model == model)].iloc[0]
    flown = fly_case(FlightCase(experiment=experiment, power_model=model, is_quick=True))
    check("experiments", row, energies(flown))


@pytest.mark.lengthy
def test_the_readings_of_the_wind_are_those_committed():
    frame = committed("wind")
    cases = wind_cases(is_quick=True)
    assert len(frame) == len(cases)
    for (_, row), case in zip(frame.iterrows(), cases, strict=True):
        assert (row.coupling, row.frequency_unit) == (case.coupling, case.frequency_unit)
    check("wind", frame.iloc[-1], energies(fly_case(cases[-1])))


@pytest.mark.lengthy
def test_a_controlled_flight_is_that_committed():
    case = BaselineCase(
        experiment=Experiment.WIND, power_model=PowerModel.MOTOR, reference=Reference.QUINTIC
    )
    flight = fly_baseline_case(case).flight
    frame = committed("baselines")
    chosen = (frame.experiment == case.experiment) & (frame.power_model == case.power_model)
    row = frame[chosen & (frame.flight == flight.name)].iloc[0]
    check("baselines", row, {"energy_J": flight.energy_J})


@pytest.mark.lengthy
def test_the_packs_are_those_committed():
    for (_, row), facts in zip(committed("batteries").iterrows(), pack_facts(), strict=True):
        assert row.battery == facts.battery
        found = {name: getattr(facts, name) for name in ("hover_power_W", "greatest_power_W")}
        check("batteries", row, found | {"stored_energy_J": facts.stored_energy_J})


@pytest.mark.lengthy
@pytest.mark.parametrize("reading", Reading)
def test_the_floors_are_those_committed(reading):
    frame = committed("floors")
    chosen = frame[frame.reading == reading]
    bounds = tuple(chosen.rotor_acceleration_max_rad_per_s2)
    for (_, row), (_, floor) in zip(
        chosen.iterrows(), chattering_floors(reading, bounds), strict=True
    ):
        check("floors", row, {"floor_J": floor})


def test_every_file_named_in_the_report_is_there():
    report = (FOLDER / "report.md").read_text(encoding="utf-8")
    for name in (*(f"{tolerance.table}.csv" for tolerance in TOLERANCES), "timings.json"):
        assert name in report
        assert (FOLDER / name).exists()
    pictures = sorted((FOLDER / "figures").glob("*.png"))
    assert pictures
    for picture in pictures:
        assert f"figures/{picture.name}" in report
        assert picture.with_suffix(".svg").exists()


def test_the_report_inserts_the_committed_optimum():
    report = (FOLDER / "report.md").read_text(encoding="utf-8")
    frame = committed("experiments")
    motor = frame[(frame.experiment == 1) & (frame.power_model == PowerModel.MOTOR)].iloc[0]
    assert f"{motor.energy_J:.2f}" in report
