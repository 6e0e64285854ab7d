"""The comparison against arithmetic done by hand."""

from dataclasses import replace
from math import acos, cos, nan

import numpy as np
import pandas as pd
import pytest

from pyomo_quad.flight import Flight
from pyomo_quad.scenario import scenario_from_mapping
from pyomo_quad.study.certificate import Certificate
from pyomo_quad.study.comparison import ComparisonColumn as Column
from pyomo_quad.study.comparison import (
    against_hovering,
    combine,
    compare_flights,
    has_arrived,
)

MISSION = {"goal": {"position": [3.0, 0.0, 4.0]}, "duration": 4.0}
BOUND = Certificate(lower_bound_J=380.0, hover_energy_J=400.0, applies=True, reason="")
NO_BOUND = Certificate(lower_bound_J=None, hover_energy_J=400.0, applies=False, reason="")


def scenario(**tables):
    return scenario_from_mapping({"name": "hop", "mission": MISSION} | tables)


def frame(**columns):
    """Five rows, one per second; at the goal from the fourth on."""
    share = np.array([0.0, 0.25, 0.5, 1.0, 1.0])
    flown = {
        "time_s": np.arange(5.0),
        "x_m": 3 * share,
        "y_m": 0 * share,
        "z_m": 4 * share,
        "phi_rad": np.array([0.0, 0.3, 0.0, 0.0, 0.0]),
        "theta_rad": np.array([0.0, 0.4, -0.45, 0.0, 0.0]),
        "power_W": np.array([100.0, 140.0, 90.0, 80.0, 90.0]),
        "state_of_charge_percent": np.array([90.0, 89.0, 88.5, 88.0, 87.5]),
    }
    flown |= {f"alpha_{j}_rad_per_s2": 10.0 * j * share for j in (1, 2, 4)}
    flown["alpha_3_rad_per_s2"] = -70.0 * share
    return pd.DataFrame(flown | columns)


def flight(name, energy, miss=0.0, speed=0.0, table=None, **more):
    return Flight(
        name=name,
        frame=frame() if table is None else table,
        energy_J=energy,
        duration_s=4.0,
        terminal_miss={"rigid_body.vx": 0.6 * speed, "rigid_body.vz": 0.8 * speed},
        terminal_miss_m=miss,
        max_violation=0.0,
        worst_constraint="limits.thrust_limit",
        is_verified=True,
        wall_s=1.0,
        **more,
    )


def compared(*flights, certificate=BOUND, told=None):
    return compare_flights(told or scenario(), flights, certificate, 400.0).set_index(Column.FLIGHT)


def test_columns_stand_in_the_order_of_the_table():
    row = compare_flights(scenario(), [flight("optimal", 410.0)], BOUND, 400.0)
    assert list(row) == [
        *("scenario", "flight", "duration_s", "energy_J", "owed_energy_J", "hover_energy_J"),
        "excess_energy_J",
        *("lower_bound_J", "optimality_gap_percent", "saving_percent", "saving_of_excess_percent"),
        *("terminal_miss_m", "arrived", "limits_kept", "broken_limits", "verified"),
        *("peak_power_W", "peak_tilt_rad"),
        *("peak_rotor_acceleration_rad_per_s2", "time_inside_0p1_m_s", "battery_used_percent"),
    ]


def test_savings_are_of_the_rows_energy_and_of_its_excess():
    table = compared(flight("optimal", 410.0), flight("adaptive/quintic", 425.0))
    row = table.loc["adaptive/quintic"]
    assert row[Column.EXCESS_ENERGY] == 25.0
    assert row[Column.SAVING] == pytest.approx(100 * 15 / 425)
    assert row[Column.SAVING_OF_EXCESS] == pytest.approx(60.0)
    assert row[Column.OPTIMALITY_GAP] == pytest.approx(100 * 45 / 425)
    assert np.isnan(table.loc["optimal", Column.SAVING])
    assert table.loc["optimal", Column.LOWER_BOUND] == 380.0


@pytest.mark.parametrize("stray", [{"miss": 0.051}, {"speed": 0.11}, {"miss": np.inf}])
def test_what_did_not_arrive_takes_no_part_in_a_saving(stray):
    astray = flight("adaptive/step", 430.0, **stray)
    table = compared(flight("optimal", 410.0), astray, flight("adaptive/quintic", 425.0))
    assert not table.loc["adaptive/step", Column.ARRIVED]
    assert table.loc["adaptive/step", [Column.SAVING, Column.OPTIMALITY_GAP]].isna().all()
    assert table.loc["adaptive/quintic", Column.SAVING] > 0


def test_what_an_end_state_owes_counts_in_saving_excess_and_gap():
    # Spent 409 J and owes 6 J: as dear as a flight that ends at the goal for 415 J.
    owing = flight("adaptive/plan", 409.0, owed_energy_J=6.0)
    table = compared(flight("optimal", 410.0), owing, flight("adaptive/quintic", 415.0))
    row, same = table.loc["adaptive/plan"], table.loc["adaptive/quintic"]
    assert row[Column.OWED_ENERGY] == 6.0
    assert row[Column.ENERGY] == 409.0
    summed = [Column.EXCESS_ENERGY, Column.SAVING, Column.SAVING_OF_EXCESS, Column.OPTIMALITY_GAP]
    assert row[summed].tolist() == same[summed].tolist()
    assert row[Column.SAVING] == pytest.approx(100 * 5 / 415)


@pytest.mark.parametrize(
    "out_of_play",
    [{"broken_limits": ("mast by 0.43 m", "ceiling by 1 m")}, {"owed_energy_J": nan}],
)
def test_a_flight_that_broke_a_limit_or_has_no_price_is_held_to_no_bound(out_of_play):
    rival = flight("adaptive/quintic", 379.0, **out_of_play)
    table = compared(flight("optimal", 410.0), rival)
    row = table.loc["adaptive/quintic"]
    compared_by = [Column.SAVING, Column.SAVING_OF_EXCESS, Column.LOWER_BOUND]
    assert row[[*compared_by, Column.OPTIMALITY_GAP]].isna().all()
    assert row[Column.LIMITS_KEPT] == ("broken_limits" not in out_of_play)
    assert row[Column.BROKEN_LIMITS] == "; ".join(out_of_play.get("broken_limits", ["none"]))
    assert table.loc["optimal", Column.BROKEN_LIMITS] == "none"


def test_what_an_end_far_from_the_goal_would_owe_is_not_said():
    astray = flight("adaptive/step", 400.0, miss=60.0, owed_energy_J=-30.0)
    row = compared(flight("optimal", 410.0), astray).loc["adaptive/step"]
    assert np.isnan(row[Column.OWED_ENERGY])
    assert row[Column.EXCESS_ENERGY] == 0.0


def test_an_optimum_that_did_not_arrive_saves_nothing():
    table = compared(flight("optimal", 410.0, miss=1.0), flight("adaptive/quintic", 425.0))
    assert table[Column.SAVING].isna().all()


def test_just_inside_both_thresholds_is_arrived():
    assert has_arrived(flight("x", 1.0, miss=0.05, speed=0.1 - 1e-12))


def test_energy_below_hover_has_no_share_above_it():
    table = compared(flight("optimal", 390.0), flight("adaptive/quintic", 395.0))
    assert table.loc["adaptive/quintic", Column.SAVING] == pytest.approx(100 * 5 / 395)
    assert np.isnan(table.loc["adaptive/quintic", Column.SAVING_OF_EXCESS])


def test_an_optimum_below_hovering_saves_no_share_of_what_lies_above_it():
    """It would save more than all of it: 105 J of the 5 J that the quintic takes above hovering."""
    table = compared(flight("optimal", 300.0), flight("adaptive/quintic", 405.0))
    row = table.loc["adaptive/quintic"]
    assert row[Column.SAVING] == pytest.approx(100 * 105 / 405)
    assert np.isnan(row[Column.SAVING_OF_EXCESS])
    assert against_hovering(-100.0) == "100.00 J less than hovering"
    assert against_hovering(5.0, digits=1) == "5.0 J more than hovering"


def test_flights_of_other_durations_stand_on_other_floors():
    slow = replace(flight("adaptive/cruise 2 m/s", 830.0), duration_s=8.0)
    row = compared(flight("optimal", 410.0), slow).loc["adaptive/cruise 2 m/s"]
    assert (row[Column.HOVER_ENERGY], row[Column.EXCESS_ENERGY]) == (800.0, 30.0)
    assert row[Column.SAVING] == pytest.approx(100 * 420 / 830)
    assert np.isnan(row[Column.SAVING_OF_EXCESS])


def test_an_optimum_for_another_wind_is_compared_with_nothing():
    told = scenario(wind={"use": "paper_table_2", "forecast": {"use": "calm"}})
    table = compared(flight("optimal", 410.0), flight("adaptive/quintic", 425.0), told=told)
    assert table[Column.SAVING].isna().all()
    assert np.isnan(table.loc["optimal", Column.LOWER_BOUND])
    assert table.loc["adaptive/quintic", Column.LOWER_BOUND] == 380.0


def test_without_a_certificate_there_is_no_gap():
    table = compared(flight("optimal", 410.0), certificate=NO_BOUND)
    assert table[[Column.LOWER_BOUND, Column.OPTIMALITY_GAP]].isna().all(axis=None)


def test_what_is_read_off_the_table():
    row = compared(flight("optimal", 410.0)).loc["optimal"]
    assert row[Column.PEAK_POWER] == 140.0
    assert row[Column.PEAK_TILT] == pytest.approx(acos(cos(0.3) * cos(0.4)))
    assert row[Column.PEAK_ROTOR_ACCELERATION] == 70.0
    assert row[Column.TIME_INSIDE] == 1.5  # one second, and half of the one that leads there
    assert row[Column.BATTERY_USED] == 2.5


def test_columns_that_a_users_model_lacks_are_empty():
    table = frame().drop(columns=["state_of_charge_percent", "x_m", "alpha_2_rad_per_s2"])
    row = compared(flight("optimal", 410.0, table=table)).loc["optimal"]
    absent = [Column.BATTERY_USED, Column.TIME_INSIDE, Column.PEAK_ROTOR_ACCELERATION]
    assert row[absent].isna().all()
    assert row[Column.PEAK_POWER] == 140.0


def test_many_scenarios_stand_under_each_other():
    first = compare_flights(scenario(), [flight("optimal", 410.0)], BOUND, 400.0)
    second = compare_flights(scenario(name="other"), [flight("optimal", nan)], NO_BOUND, 400.0)
    both = combine([first, second])
    assert list(both[Column.SCENARIO]) == ["hop", "other"]
    assert list(both.index) == [0, 1]
    assert list(combine([])) == list(both)
