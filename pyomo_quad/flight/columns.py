"""The columns of a flight's table, and the declared components they show.

This is the one home of the column names: whoever reads or writes a flight's table takes
them from here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pyomo_quad.collocation import Dynamics

__all__ = ["COLUMNS", "ENERGY", "ROTORS", "TIME", "WIND", "Column", "flight_frame"]

FloatArray = NDArray[np.float64]

TIME = "time_s"
ENERGY = "energy_J"
ROTORS = (1, 2, 3, 4)
WIND = ("wind_x_m_per_s", "wind_y_m_per_s")


@dataclass(frozen=True)
class Column:
    """A column's name and the model component (with its index beside time) it shows."""

    name: str
    component: str
    index: int | None = None


def _rotor_columns(pattern: str, component: str) -> tuple[Column, ...]:
    return tuple(Column(pattern.format(j), component, j) for j in ROTORS)


_BEFORE_ENERGY = (
    Column("x_m", "rigid_body.x"),
    Column("y_m", "rigid_body.y"),
    Column("z_m", "rigid_body.z"),
    Column("vx_m_per_s", "rigid_body.vx"),
    Column("vy_m_per_s", "rigid_body.vy"),
    Column("vz_m_per_s", "rigid_body.vz"),
    Column("phi_rad", "rigid_body.phi"),
    Column("theta_rad", "rigid_body.theta"),
    Column("psi_rad", "rigid_body.psi"),
    Column("p_rad_per_s", "rigid_body.p"),
    Column("q_rad_per_s", "rigid_body.q"),
    Column("r_rad_per_s", "rigid_body.r"),
    *_rotor_columns("omega_{}_rad_per_s", "rotors.omega"),
    *_rotor_columns("alpha_{}_rad_per_s2", "rotors.alpha"),
    Column("thrust_N", "rotors.total_thrust"),
    Column("power_W", "power.total"),
)
_AFTER_ENERGY = (
    Column(WIND[0], "wind.velocity_x"),
    Column(WIND[1], "wind.velocity_y"),
    Column("battery_current_A", "battery.current"),
    Column("battery_voltage_V", "battery.voltage"),
    Column("state_of_charge_percent", "battery.state_of_charge"),
    *_rotor_columns("motor_{}_current_A", "rotors.motor_current"),
    *_rotor_columns("motor_{}_voltage_V", "rotors.motor_voltage"),
    *_rotor_columns("motor_{}_torque_N_m", "rotors.motor_torque"),
)

#: Every column after the time, in order; the energy is the integral of the flight's power.
COLUMNS = (*_BEFORE_ENERGY, Column(ENERGY, ""), *_AFTER_ENERGY)


def flight_frame(
    dynamics: Dynamics, t: FloatArray, states: FloatArray, controls: FloatArray, energy: FloatArray
) -> pd.DataFrame:
    """Return the table of a flight.

    Parameters
    ----------
    dynamics : Dynamics
        Of the model that was flown; columns whose component it lacks are left out.
    t : ndarray, shape (n,)
        Times [s].
    states : ndarray, shape (n, n_states)
    controls : ndarray, shape (n, n_controls)
    energy : ndarray, shape (n,)
        Energy spent since the start [J].

    Returns
    -------
    DataFrame
        `TIME` first, then `COLUMNS`.
    """
    shown = [c for c in COLUMNS if c.name == ENERGY or dynamics.has(c.component)]
    keys = tuple((c.component, c.index) for c in shown if c.name != ENERGY)
    values = dynamics.table(keys, t, states, controls)
    held = iter(values.T)
    columns = {c.name: energy if c.name == ENERGY else next(held) for c in shown}
    return pd.DataFrame({TIME: t} | columns)
