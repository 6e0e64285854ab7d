"""Rows of the directions: what is missing or lost is said, and savings are of energies flown."""

from tests.benchmarks.wind_fields import DIRECTIONS_DEG, Flown, rows_of, street


def flown(way, energies, held=100, broken=""):
    known = {} if way == "straight" or not energies else {"planned_J": 910.0, "paper_J": 900.0}
    lost = {} if energies else {"detail": "lost"}
    return Flown(
        direction_deg=40,
        way=way,
        processor_s=1.0,
        energies_J=energies,
        held=held,
        broken=broken,
        **known,
        **lost,
    )


def test_a_row_tells_what_held_and_what_is_missing_and_saves_over_flights_that_hold():
    flights = [flown("field", (890.0, 900.0, 910.0)), flown("straight", (1000.0, 1000.0, 1000.0))]
    (row,) = rows_of(flights)
    assert row == [40, "910", "1.11", "900", "-", "1000", "100", "-", "100", "-", "10.0"]
    (row,) = rows_of([*flights, flown("mean", (950.0,) * 3, 90, "tilt")])
    assert (row[4], row[7], row[9]) == ("950", "90, tilt", "-")
    (row,) = rows_of([*flights, flown("mean", (), held=0)])
    assert (row[7], row[9]) == ("lost", "-")


def test_every_direction_has_its_wind():
    assert sorted(DIRECTIONS_DEG) == list(range(0, 360, 20))
    assert street(40).wind.grid != street(220).wind.grid
