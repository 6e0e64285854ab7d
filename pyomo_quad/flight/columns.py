"""Columns of the table of a flight: name, variable of the model, unit, description and symbol.

Tables hold values in the units of the model. The factor ``scale`` of a column converts them to the
unit in print: angles, for example, are stored in rad and printed in degrees.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import degrees
from typing import TYPE_CHECKING

from pyomo_quad.scenario.vehicle import MOST_ROTORS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import pandas as pd
    import xarray as xr

    from pyomo_quad.arrays import FloatArray
    from pyomo_quad.collocation import Dynamics


# Names of columns: time, energy, and wind along world x and y.
TIME = "time_s"
ENERGY = "energy_J"
WIND = ("wind_x_m_per_s", "wind_y_m_per_s")
#: Numbers of the rotors of a quadrotor.
ROTORS = (1, 2, 3, 4)
# Beginning of the names of the controls, the rotor accelerations.
_ROTOR_CONTROL = "rotors.alpha["
# Degrees in a radian: angles are stored in rad and printed in degrees.
_IN_DEGREES = degrees(1.0)
# Printed unit -> stored unit, where they differ.
_STORED_UNITS = {"°": "rad", "°/s": "rad/s", "mN m": "N m"}


@dataclass(frozen=True)
class Column:
    """Column of a table: a quantity of the model with its name, unit and symbol.

    Attributes
    ----------
    name : str
        Heading of the column.
    component : str
        Full name of the component of the Pyomo model.
    index : int or None
        Index other than time, such as the number of a rotor; None if there is none.
    words, symbol, unit : str
        Printed name, symbol (LaTeX) and unit.
    scale : float
        Factor from stored to printed value.
    smallest_span : float
        Least range of an axis, in the printed unit.
    """

    name: str
    component: str = ""
    words: str = ""
    symbol: str = ""
    unit: str = ""
    # Without it, the axis of a constant quantity would be scaled to its rounding errors.
    smallest_span: float = 0.0
    scale: float = 1.0
    index: int | None = None

    def of(self, frame: pd.DataFrame) -> FloatArray:
        """Return this column of a flight's table `frame`, converted to the printed unit.

        The result has one value per row of the table.
        """
        return frame[self.name].to_numpy(dtype=float) * self.scale

    @property
    def variable(self) -> str:
        """Name of the variable in this column, without the time, such as "rotors.omega[1]"."""
        return self.component if self.index is None else f"{self.component}[{self.index}]"

    @property
    def title(self) -> str:
        """Symbol, name and unit, as the title of a panel in a figure."""
        return f"${self.symbol}$, {self.words} ({self.unit})"

    @property
    def stored_unit(self) -> str:
        """Unit of the values in a table, for example rad for an angle printed in degrees."""
        return _STORED_UNITS.get(self.unit, self.unit)

    @property
    def label(self) -> str:
        """Name and unit, as the label of an axis in a figure."""
        name = f"{self.words[:1].upper()}{self.words[1:]}"
        return f"{name} ({self.unit})" if self.unit else name


def _of(block: str) -> Callable[..., Column]:
    """Return a function that makes table columns for the variables of one block of the model.

    It takes the name of the column, the name of the variable in the block, and other attributes of
    `Column`.
    """
    return lambda name, shown, *printed: Column(name, f"{block}.{shown}", *printed)


_body, _rotor, _battery, _wind = map(_of, ("rigid_body", "rotors", "battery", "wind"))

_OF_THE_BODY = (
    *(_body(f"{axis}_m", axis, "position", axis, "m", 0.1) for axis in "xyz"),
    *(_body(f"v{axis}_m_per_s", f"v{axis}", "velocity", f"v_{axis}", "m/s", 0.1) for axis in "xyz"),
    _body("phi_rad", "phi", "roll", r"\phi", "°", 0.5, _IN_DEGREES),
    _body("theta_rad", "theta", "pitch", r"\theta", "°", 0.5, _IN_DEGREES),
    _body("psi_rad", "psi", "yaw", r"\psi", "°", 0.5, _IN_DEGREES),
    _body("p_rad_per_s", "p", "roll rate", "p", "°/s", 0.5, _IN_DEGREES),
    _body("q_rad_per_s", "q", "pitch rate", "q", "°/s", 0.5, _IN_DEGREES),
    _body("r_rad_per_s", "r", "yaw rate", "r", "°/s", 0.5, _IN_DEGREES),
)
_OF_THE_WHOLE = (
    _rotor("thrust_N", "total_thrust", "thrust", "T", "N", 0.1),
    Column("power_W", "power.total", "power", "P", "W", 1.0),
    Column(ENERGY, "", "energy", "E", "J", 1.0),
    _wind(WIND[0], "velocity_x", "wind along x", r"v_x^\mathrm{wind}", "m/s", 0.1),
    _wind(WIND[1], "velocity_y", "wind along y", r"v_y^\mathrm{wind}", "m/s", 0.1),
    _battery("battery_current_A", "current", "current", r"i_\mathrm{bat}", "A", 0.1),
    _battery("battery_voltage_V", "voltage", "voltage", r"V_\mathrm{bat}", "V", 0.1),
    _battery(
        "state_of_charge_percent", "state_of_charge", "state of charge", r"\mathrm{SoC}", "%", 0.1
    ),
)
# Columns of a battery whose model has a relaxation voltage or a temperature.
_OF_THE_CIRCUIT = (
    _battery("battery_relaxation_V", "relaxation_voltage", "slow voltage drop", "u_1", "V", 0.1),
    _battery(
        "battery_temperature_K", "temperature", "pack temperature", r"T_\mathrm{bat}", "K", 0.5
    ),
)
# Patterns of the columns that each rotor has; the rotor's number replaces the braces.
_SPEEDS = (
    _rotor("omega_{}_rad_per_s", "omega", "rotor speed", r"\omega_{}", "rad/s", 5.0),
    _rotor("alpha_{}_rad_per_s2", "alpha", "acceleration of rotor {}", r"\alpha_{}", "rad/s²", 1.0),
)
_MOTORS = (
    _rotor("motor_{}_current_A", "motor_current", "motor current", "i_{}", "A", 0.05),
    _rotor("motor_{}_voltage_V", "motor_voltage", "motor voltage", "v_{}", "V", 0.05),
    _rotor("motor_{}_torque_N_m", "motor_torque", "motor torque", r"\tau_{}", "mN m", 0.05, 1e3),
)


def _per_rotor(patterns: Sequence[Column], rotors: Sequence[int]) -> tuple[Column, ...]:
    def of_rotor(shown: Column, rotor: int) -> Column:
        texts = shown.name, shown.words, shown.symbol
        name, words, symbol = (text.format(rotor) for text in texts)
        return replace(shown, name=name, words=words, symbol=symbol, index=rotor)

    return tuple(of_rotor(shown, rotor) for shown in patterns for rotor in rotors)


def columns_of(rotors: Sequence[int]) -> tuple[Column, ...]:
    """Return all columns of the table of a flight except the time, in the order of the table.

    `rotors` has the numbers of the vehicle's rotors, from 1.
    """
    return (
        *_OF_THE_BODY,
        *_per_rotor(_SPEEDS, rotors),
        *_OF_THE_WHOLE,
        *_OF_THE_CIRCUIT,
        *_per_rotor(_MOTORS, rotors),
    )


#: Columns of a quadrotor whose battery has neither relaxation voltage nor temperature. The energy
#: is the integral of the power.
COLUMNS = tuple(shown for shown in columns_of(ROTORS) if shown not in _OF_THE_CIRCUIT)
#: Columns of every vehicle that can be declared.
ALL_COLUMNS = columns_of(range(1, MOST_ROTORS + 1))
_COLUMN_OF = {shown.variable or shown.name: shown for shown in ALL_COLUMNS}


def column_of(variable: str) -> Column:
    """Return the column of a flight's table for a given variable of the model.

    `variable` is the full name of the variable, such as "rotors.omega[1]"; for the energy, it is
    the heading `ENERGY`. An unknown name raises a KeyError.
    """
    return _COLUMN_OF[variable]


def flight_columns(
    dynamics: Dynamics, t: FloatArray, states: FloatArray, controls: FloatArray, energy: FloatArray
) -> dict[str, FloatArray]:
    """Return the columns of a flight's table, evaluated with the model's equations.

    The result maps names of columns to values, shape (n,): the time first, then the order of
    `columns_of`. A column is omitted if the model lacks its quantity. `energy` is in J.
    """
    count = sum(name.startswith(_ROTOR_CONTROL) for name in dynamics.control_names)
    columns_here = columns_of(range(1, count + 1)) if count else COLUMNS
    shown = [c for c in columns_here if c.name == ENERGY or dynamics.has(c.component)]
    keys = tuple((c.component, c.index) for c in shown if c.name != ENERGY)
    values = dynamics.table(keys, t, states, controls)
    held = iter(values.T)
    columns = {c.name: energy if c.name == ENERGY else next(held) for c in shown}
    return {TIME: t} | columns


def flight_frame(
    dynamics: Dynamics, t: FloatArray, states: FloatArray, controls: FloatArray, energy: FloatArray
) -> pd.DataFrame:
    """Return the table of a flight, evaluated with the model's equations.

    The first column is the time. The others are body and rotor motion, thrust, power, energy, wind,
    battery and motors.

    Parameters
    ----------
    dynamics : Dynamics
        Equations of the simulated vehicle. A column is omitted if the model lacks its quantity.
    t : ndarray, shape (n,)
        Times [s].
    states, controls : ndarray, shapes (n, n_states), (n, n_controls)
        States and controls at these times, in the order of the dynamics.
    energy : ndarray, shape (n,)
        Energy spent since the start [J].

    Returns
    -------
    DataFrame
        One row per time.

    Examples
    --------
    >>> path, times = plan.trajectories, plan.times(rate_hz=1.0)
    >>> values = path.states_at(times), path.controls_at(times), path.energy_at(times)
    >>> list(flight_frame(plan.dynamics, times, *values))[:3]
    ['time_s', 'x_m', 'y_m']
    """
    import pandas as pd  # noqa: PLC0415  0.3 s that a solve has no use for

    return pd.DataFrame(flight_columns(dynamics, t, states, controls, energy))


def dataset_of(frame: pd.DataFrame) -> xr.Dataset:
    """Return the table of a flight as an xarray dataset with units and long names.

    Each column of the table `frame` becomes a variable. The index of the table, usually the time,
    becomes the coordinate.
    """
    data = frame.to_xarray()
    for column in ALL_COLUMNS:
        if column.name in data:
            data[column.name].attrs = {"units": column.stored_unit, "long_name": column.words}
    if TIME in data.coords:
        data[TIME].attrs = {"units": "s", "long_name": "time"}
    return data
