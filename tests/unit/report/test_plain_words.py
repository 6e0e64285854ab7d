"""The opening of a report, in words of no field, and energies as charge, time and range."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pyomo_quad.flight import PlanStatus
from pyomo_quad.flight.margins import RiskTaken
from pyomo_quad.flight.planning import solve_scenario
from pyomo_quad.report import Figures
from pyomo_quad.report.report import climb_of, write_run_report, write_solve_report
from pyomo_quad.scenario import load_scenario
from pyomo_quad.study.headline import headline_of
from tests.declared_model import scenario
from tests.synthetic_run import (
    LOWER_BOUND_J,
    synthetic_failure,
    synthetic_flight,
    synthetic_plan,
    synthetic_run,
    with_tuned_autopilot,
)


def opening(folder):
    """The paragraph on what was asked, found and meant."""
    parts = (folder / "report.md").read_text(encoding="utf-8").split("\n\n")
    return next(part for part in parts if part.startswith("**Asked:**"))


@pytest.fixture(scope="module")
def run():
    return synthetic_run("scenarios/paper_calm.toml")


@pytest.fixture(scope="module")
def report(run, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    write_run_report(folder, run, Figures.NONE)
    return folder


def test_a_run_opens_with_what_was_asked_found_and_meant(run, report):
    said = opening(report)
    assert [part.split("**")[0] for part in re.split(r"\*\*(?=[A-Z])", said)[1:]] == [
        "Asked:",
        "Found:",
        "It means:",
    ]
    assert "from (0, 0, 0) m, yaw 0° to (6, 7, 8) m, yaw 0°, from hover to hover in 10 s" in said
    assert f"a flight of {run.plan.energy:.2f} J" in said
    gap = 100 * (run.plan.energy - LOWER_BOUND_J) / run.plan.energy
    assert f"can save more than {gap:.2f} % of this energy (the gap to the lower bound)" in said
    floor = 100 * run.plan.hover_energy_J / run.plan.energy
    assert f"hovering for the same time takes {floor:.1f} % of it." in said


def test_a_flight_that_takes_less_than_hovering_is_told_so(tmp_path):
    run = synthetic_run("scenarios/paper_calm.toml")
    run.plan.hover_energy_J = 1.25 * run.plan.energy
    write_run_report(tmp_path, run, Figures.NONE)
    assert "hovering for the same time takes 25.0 % more, because rotors" in opening(tmp_path)


def test_a_charge_is_told_in_minutes_and_metres(run, report):
    charge = run.flights[0].frame["state_of_charge_percent"]
    used = charge.iloc[0] - charge.iloc[-1]
    minutes, metres = 100 / used * 10 / 60, 100 / used * np.sqrt(6**2 + 7**2 + 8**2)
    said = opening(report)
    assert f"{used:.2f} % of the battery" in said
    assert f"a full charge lasts {minutes:.1f} minutes or {metres:.0f} m" in said


def test_energies_stand_beside_battery_hovering_and_range(run, report):
    text = (report / "report.md").read_text(encoding="utf-8")
    table = text[text.index("**The same energies as charge, hover time and range**") :].split(
        "\n\n"
    )[1]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines()]
    assert rows[0] == ["Flight", "Energy (J)", "Battery (%)", "Hovering (min)", "Range (m)"]
    held = {row[0].strip("`"): [float(cell) for cell in row[1:]] for row in rows[2:]}
    assert list(held) == [flight.name for flight in run.flights]
    path = np.sqrt(6**2 + 7**2 + 8**2)  # the synthetic flights go straight
    for flight in run.flights:
        energy, _, minutes, metres = held[flight.name]
        assert energy == pytest.approx(flight.energy_J, abs=0.01)
        hover_power = run.plan.hover_energy_J / 10.0
        assert minutes == pytest.approx(energy / hover_power / 60.0, abs=1e-3)
        assert metres == pytest.approx(energy / run.plan.energy * path, abs=0.02)


def test_terms_are_told_before_they_head_a_column(report):
    text = (report / "report.md").read_text(encoding="utf-8")
    terms = (
        ("To complete", "To complete (J)"),
        ("Hovering", "Hovering (J)"),
        ("gap", "Gap to the bound (%)"),
    )
    for term, column in terms:
        assert text.index(f"**{term}** is") < text.index(column)
    told = text[text.index("## Lower bound: the least that any flight can take") :]
    assert told.split("\n\n")[1].startswith("The plan comes from a local search")


@pytest.mark.parametrize(
    ("status", "said"),
    [
        (PlanStatus.INFEASIBLE, "**Found:** no flight within the limits of the vehicle."),
        (PlanStatus.NOT_CONVERGED, "**Found:** no flight, and no proof that there is none."),
        (PlanStatus.INTERRUPTED, "**Found:** no flight, and no proof that there is none."),
        (PlanStatus.SOLVED, "**It means:** do not fly it"),
        (PlanStatus.VERIFIED, "no small change of this flight saves energy"),
    ],
)
def test_a_solve_opens_with_its_outcome_in_plain_words(run, status, said, tmp_path):
    flight = synthetic_flight(run.scenario, "optimal")
    failure = synthetic_failure() if status is PlanStatus.INFEASIBLE else None
    plan = synthetic_plan(run.scenario, flight, status, failure=failure)
    write_solve_report(tmp_path, plan, figures=Figures.NONE)
    assert said in opening(tmp_path)


@pytest.mark.lengthy
def test_a_solve_whose_time_ran_out_says_what_happened_and_what_it_reached(tmp_path):
    """No table tells of an optimal flight, and nothing is promised that is not said."""
    told = scenario(
        mission={"waypoints": [{"position": [3.0, 4.0, 4.0]}]}, solver={"time_limit": 1e-3}
    )
    plan = solve_scenario(told)
    assert plan.status is PlanStatus.NOT_CONVERGED
    write_solve_report(tmp_path, plan, figures=Figures.NONE)
    text = (tmp_path / "report.md").read_text(encoding="utf-8").replace("\\_", "_")
    assert "given up after solver.time_limit = 0.001 s; allow more time" in text
    assert f"Reached: mesh 1 with {plan.mesh.points} points, {plan.energy:.6g} J, iteration" in text
    last = plan.iterations[-1]
    assert f"iteration {last.iteration}, infeasibility {last.infeasibility:.1e}" in text
    for promised in ("optimal flight", "vehicle's limits", "mission must change", "drawn below"):
        assert promised not in text


def test_a_wind_that_was_not_told_is_said_at_once(tmp_path):
    write_run_report(tmp_path, synthetic_run("scenarios/wind_untold.toml"), Figures.NONE)
    assert "these numbers apply to the forecast wind; the tables below show the flights" in (
        opening(tmp_path)
    )


def climb_said(folder, run):
    write_run_report(folder, run, Figures.NONE)
    text = (folder / "report.md").read_text(encoding="utf-8")
    return next((part for part in text.split("\n\n") if "Climbing costs too little" in part), None)


def test_a_climb_that_the_power_model_gives_away_is_said_beside_the_numbers(run, report):
    text = (report / "report.md").read_text(encoding="utf-8")
    said = next(part for part in text.split("\n\n") if "Climbing costs too little" in part)
    vehicle, climb_m = run.scenario.vehicle, 8.0
    potential = vehicle.total_mass * run.scenario.gravity * climb_m
    assert said.startswith(
        "**Climbing costs too little in this power model.** The mission climbs 8 m, "
    )
    assert f"adds {potential:.1f} J of potential energy" in said
    spent = run.plan.energy - run.plan.hover_energy_J
    assert f"the plan takes only {spent:.2f} J more than hovering" in said


@pytest.mark.parametrize(
    ("overrides", "above_hover_J"),
    [
        ((), 150.0),
        (("power.model='momentum'", "vehicle.rotor_radius=0.12"), 2.0),
        (("mission.start.position=[0, 0, 9]",), 2.0),
    ],
    ids=["paid for", "priced", "a descent"],
)
def test_a_climb_that_is_paid_for_is_not_called_free(overrides, above_hover_J, tmp_path):
    run = synthetic_run("scenarios/paper_calm.toml", overrides)
    run.plan.hover_energy_J = run.plan.energy - above_hover_J
    assert climb_said(tmp_path, run) is None


def test_the_saving_is_over_the_tuned_autopilot_with_its_settings(tmp_path):
    run = with_tuned_autopilot(synthetic_run("scenarios/paper_calm.toml"))
    write_run_report(tmp_path, run, Figures.NONE)
    text = (tmp_path / "report.md").read_text(encoding="utf-8")
    headline = next(part for part in text.split("\n\n") if part.startswith("> "))
    rival = run.tuning.flight.energy_J
    saved = 100 * (1 - run.plan.energy / rival)
    assert headline.splitlines()[0].endswith(
        f" and 10 s: {saved:.2f} % less energy than an autopilot tuned for least energy "
        f"({rival:.2f} J, 10 s, at most 8.38 m/s, 4.7 m/s² and 32.1 m/s³). "
        "Flights in gusts were not simulated."
    )
    tried = pd.read_csv(tmp_path / "autopilot.csv")
    assert tried.speed_asked_m_per_s.tolist() == [6.0, 8.38]
    assert tried.speed_reached_m_per_s.tolist() == [5.2, 8.38]
    assert tried.broken_limits.tolist() == ["tilt", "none"]
    assert "| 6.00 | 5.20 | 3.00 | 3.00 | 4.00 | 10.00 |" in text


def test_the_share_of_flights_that_hold_stands_in_the_headline():
    run = synthetic_run("scenarios/paper_calm.toml")
    paper = run.plan.energy / 1.02
    run.plan.risk = RiskTaken(
        asked=0.05, predicted=0.03, failed=10, flown=400, is_satisfied=True, paper_energy_J=paper
    )
    said = headline_of(run).words
    assert (
        "In turbulence, 390 of 400 simulated flights arrive and keep every limit (97.5 %)." in said
    )
    more = run.plan.energy - paper
    assert said.endswith(f"a broken limit at or below 5 % cost {more:.3g} J (2 %).")
    run.plan.risk = replace(run.plan.risk, failed=90, is_satisfied=False)
    lacking = f"A risk of 5 % was not reached; the margins cost {more:.3g} J (2 %)."
    assert headline_of(run).words.endswith(lacking)


RESULTS = " ".join(Path("docs/evidence/results.md").read_text(encoding="utf-8").split())


def test_the_book_says_that_climbing_is_free_where_the_energies_stand():
    scenario = load_scenario("scenarios/paper_calm.toml")
    _, potential = climb_of(scenario)
    frame = pd.read_csv("reports/paper_calm/comparison.csv").set_index("flight")
    spent = frame.excess_energy_J["optimal"]
    first_table = RESULTS.index("| optimum | adaptive, smooth reference")
    said = RESULTS[first_table : RESULTS.index("Free to choose its time")]
    assert f"8 m are {potential:.0f} J of potential energy" in said
    assert f"{spent:.2f} J more than hovering" in said
