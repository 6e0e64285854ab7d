"""Rows of the directions: what is missing or lost is said, and savings are of energies flown."""

from math import isnan, nan

from tests.benchmarks.wind_fields import DIRECTIONS_DEG, Flown, rows_of, street


def flown(way, energy, broken=""):
    return Flown(40, way, energy, energy, 30.0, not isnan(energy), 0.1, broken, "lost", 1.0)


def test_a_row_tells_limits_and_what_is_missing_and_saves_over_sound_flights_only():
    flights = [flown("field", 900.0), flown("straight", 1000.0)]
    (row,) = rows_of(flights)
    assert row == [40, "900", "900", "-", "1000", "kept", "-", "kept", "-", "10.0"]
    (row,) = rows_of([*flights, flown("mean", 950.0, "tilt limit by 1 %")])
    assert (row[6], row[8]) == ("tilt limit by 1 %", "-")
    (row,) = rows_of([*flights, flown("mean", nan)])
    assert (row[6], row[8]) == ("lost", "-")


def test_every_direction_has_its_wind():
    assert sorted(DIRECTIONS_DEG) == list(range(0, 360, 20))
    assert street(40).wind.grid != street(220).wind.grid
