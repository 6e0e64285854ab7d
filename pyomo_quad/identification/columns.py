"""Columns of flight logs: names, units, meanings, and alternative names."""

from collections.abc import Mapping
from typing import NamedTuple


class LogColumn(NamedTuple):
    """Column of a log: its unit, its meaning, and alternative names that a log may use."""

    unit: str
    meaning: str
    other_names: tuple[str, ...] = ()


FLIGHT, TIME, PHASE, POWER = "flight", "time_s", "phase", "power_W"
PAYLOAD, DENSITY = "payload_kg", "air_density_kg_m3"
VELOCITY = ("vel_north_m_s", "vel_east_m_s", "vel_up_m_s")
AIR_VELOCITY = ("air_vel_north_m_s", "air_vel_east_m_s")
VOLTAGE, CURRENT = "voltage_V", "current_A"
_AIR_READ = "velocity through the air as read, times vehicle.anemometer_factor"
COLUMNS: Mapping[str, LogColumn] = {
    FLIGHT: LogColumn("", "number or name of the flight", ("flight_id",)),
    TIME: LogColumn("s", "time, rising within a flight", ("time", "t")),
    PHASE: LogColumn("", "1 take-off, 2 cruise, 3 landing; other rows are ignored"),
    PAYLOAD: LogColumn("kg", "mass carried", ("payload",)),
    DENSITY: LogColumn("kg/m^3", "density of the air", ("air_density",)),
    POWER: LogColumn("W", "power drawn from the pack", ("power", f"{VOLTAGE} with {CURRENT}")),
    VELOCITY[0]: LogColumn("m/s", "velocity over ground", ("vn_m_s",)),
    VELOCITY[1]: LogColumn("m/s", "velocity over ground", ("ve_m_s",)),
    VELOCITY[2]: LogColumn("m/s", "climb", ("vu_m_s",)),
    **dict.fromkeys(AIR_VELOCITY, LogColumn("m/s", _AIR_READ)),
}
#: Values of the column `PHASE` in rows of flight (take-off, cruise, landing); others are ignored.
FLYING = (1, 2, 3)
CRUISE = 2


def wanted_columns(columns: Mapping[str, LogColumn] = COLUMNS) -> str:
    """List the columns of a table with their units in one line, for messages and help.

    `columns` has unit and meaning of each column, by the column's name. By default, these are the
    columns of a flight log.
    """
    told = (f"{name} ({column.unit})" if column.unit else name for name, column in columns.items())
    return f"the columns are {', '.join(told)}"
