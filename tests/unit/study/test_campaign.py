"""Flights per charge: as many as the closed form of the pack says, and what ends them."""

import subprocess
import sys
from math import floor

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad

from pyomo_quad.flight import Planner
from pyomo_quad.scenario import ScenarioError, load_scenario
from pyomo_quad.study.campaign import CHARGE_RESERVE, fly_campaign
from tests.command import SCENARIOS

pytestmark = pytest.mark.lengthy

HOVER_S = 60.0
SMALL = (
    f"mission.duration={HOVER_S}",
    "mission.goal.position=[0, 0, 0]",
    "solver.accuracy='standard'",
    "battery.capacity=0.4",
)


def hovering(*overrides, name="paper_calm"):
    return load_scenario(SCENARIOS / f"{name}.toml", [*SMALL, *overrides])


def hovering_time(scenario, power, from_percent, to_percent):
    """Return how long the pack gives a constant power, from its equations written again [s]."""
    pack = scenario.battery
    whole = pack.capacity * pack.cells_parallel
    resistance = pack.cell_resistance * pack.cells_series / pack.cells_parallel

    def slowness(drawn):
        open_circuit = pack.cells_series * (
            pack.E0
            - pack.K / (1 - drawn / whole)
            + pack.A * np.exp(-pack.B * drawn / pack.cells_parallel)
        )
        # The smaller root of R i^2 - U i + P = 0.
        root = np.sqrt(open_circuit**2 - 4 * resistance * power)
        return 3600.0 / ((open_circuit - root) / (2 * resistance))

    ends = [whole * (1 - percent / 100.0) for percent in (from_percent, to_percent)]
    return quad(slowness, *ends, epsabs=1e-9)[0]


@pytest.fixture(scope="module")
def hover():
    mission = hovering()
    return mission, fly_campaign([mission], [Planner()])


def test_hovers_per_charge_are_those_of_the_closed_form(hover):
    mission, campaign = hover
    power = campaign.flights[0].plan.energy / HOVER_S
    whole = hovering_time(mission, power, 100.0, 20.0)
    assert campaign.counts == (floor(whole / HOVER_S),)
    assert campaign.endings == (CHARGE_RESERVE,)
    for flight in campaign.flights:
        lasted = hovering_time(mission, power, flight.charge_at_start, flight.charge_at_end)
        assert lasted == pytest.approx(HOVER_S, rel=1e-5)


def test_each_flight_starts_where_the_last_one_ended(hover):
    table = hover[1].table()
    assert table.charge_at_start_percent.tolist()[1:] == pytest.approx(
        table.charge_at_end_percent.tolist()[:-1]
    )
    assert table.lowest_voltage_V.is_monotonic_decreasing
    assert (table.charge_at_end_percent >= 20.0).all()


def test_slow_drop_and_temperature_go_on_with_the_pack():
    mission = hovering(
        "battery.initial_state_of_charge=82.0",
        "battery.relaxation={resistance=0.01, time_constant=20.0}",
        "battery.thermal={heat_capacity=20.0, activation_energy=2e4}",
    )
    first, second, *_ = fly_campaign([mission], [Planner()]).flights
    held = [flight.plan.trajectories for flight in (first, second)]
    for name in ("battery.charge_drawn", "battery.relaxation_voltage", "battery.temperature"):
        column = held[0].state_names.index(name)
        ended, begun = held[0].states[-1, column], held[1].states[0, column]
        assert begun == pytest.approx(ended, rel=1e-9)
        assert ended > held[0].states[0, column]


@pytest.mark.slow
def test_a_voltage_limit_ends_a_charge_before_its_reserve(hover):
    voltages = [flight.lowest_voltage_V for flight in hover[1].flights]
    between = (voltages[0] + voltages[1]) / 2
    mission = hovering(f"limits.battery_voltage_min={between}")
    campaign = fly_campaign([mission], [Planner()])
    assert campaign.counts == (1,)
    assert campaign.endings == ("battery voltage",)


@pytest.mark.slow
def test_missions_take_turns_on_one_pack_and_go_on_with_the_next():
    short, long = hovering("mission.duration=50"), hovering("mission.duration=100")
    campaign = fly_campaign([short, long], [Planner(), Planner()], charges=2)
    table = campaign.table()
    assert set(table.duration_s[::2]) == {50.0}
    assert set(table.duration_s[1::2]) == {100.0}
    assert len(campaign.counts) == len(campaign.endings) == 2
    second = table[table.charge == 2]
    assert second.charge_at_start_percent.iloc[0] == pytest.approx(100.0)
    # The second pack begins with the mission that the first one could not fly.
    assert second.duration_s.iloc[0] != table[table.charge == 1].duration_s.iloc[-1]


def test_missions_of_other_packs_are_refused_in_one_line():
    other = hovering("battery.capacity=0.7")
    with pytest.raises(ScenarioError, match="missions in a row need one pack") as refused:
        fly_campaign([hovering(), other], [Planner(), Planner()])
    assert "\n" not in str(refused.value)


def run(*arguments, cwd):
    command = [sys.executable, "-m", "pyomo_quad", "campaign", *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, check=False)


def test_the_command_writes_table_and_figure_and_says_how_often(tmp_path):
    options = [f"--set={value}" for value in (*SMALL, "battery.capacity=0.2")]
    done = run(str(SCENARIOS / "paper_calm.toml"), *options, "--charges=2", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "reports" / "paper_calm-campaign"
    table = pd.read_csv(folder / "campaign.csv")
    counts = table.groupby("charge").size().tolist()
    assert counts[0] == counts[1] >= 1
    for charge, count in enumerate(counts, start=1):
        said = f"Charge {charge}: {count} flight"
        assert said in done.stdout
        assert said in (folder / "report.md").read_text(encoding="utf-8")
    assert (folder / "figures" / "campaign.svg").exists()


def test_a_bad_number_of_charges_is_refused_in_one_line(tmp_path):
    done = run(str(SCENARIOS / "paper_calm.toml"), "--charges=0", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "must be a whole number >= 1" in done.stderr
