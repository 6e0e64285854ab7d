"""What the figures draw: a column of a flight's frame, how it is printed, and in which unit.

Angles are kept in radians by every other floor; degrees appear in print only.
"""

from dataclasses import dataclass
from math import degrees

import numpy as np
import pandas as pd

from pyomo_quad.flight import columns

__all__ = [
    "ATTITUDE",
    "BATTERY",
    "BODY_RATE",
    "ENERGY",
    "MOTOR",
    "POSITION",
    "POWER",
    "ROTOR_ACCELERATION",
    "ROTOR_SPEED",
    "STATE_GRID",
    "TIME",
    "TORQUE",
    "VELOCITY",
    "WIND",
    "Signal",
]

_COLUMN_OF = {(shown.component, shown.index): shown.name for shown in columns.COLUMNS}
_IN_DEGREES = degrees(1.0)


@dataclass(frozen=True, kw_only=True)
class Signal:
    """One printed quantity.

    ``smallest_span`` keeps an axis from blowing up rounding noise: it never shows less than that.
    """

    column: str
    symbol: str
    name: str
    unit: str
    component: str = ""
    index: int | None = None
    scale: float = 1.0
    smallest_span: float = 0.0

    def of(self, frame: pd.DataFrame) -> np.ndarray:
        """Return the values of a flight in the printed unit.

        Parameters
        ----------
        frame : DataFrame
            The flight, one row per instant.

        Returns
        -------
        ndarray
            One value per row.
        """
        return frame[self.column].to_numpy(dtype=float) * self.scale

    @property
    def title(self) -> str:
        """Symbol, name and unit, as over a panel."""
        return f"${self.symbol}$, {self.name} ({self.unit})"

    @property
    def label(self) -> str:
        """Name and unit, as beside an axis."""
        return f"{self.name[0].upper()}{self.name[1:]} ({self.unit})"


def _signal(
    component: str,
    symbol: str,
    name: str,
    unit: str,
    *,
    span: float,
    rotor: int | None = None,
    scale: float = 1.0,
) -> Signal:
    return Signal(
        column=_COLUMN_OF[component, rotor],
        symbol=symbol,
        name=name,
        unit=unit,
        component=component,
        index=rotor,
        scale=scale,
        smallest_span=span,
    )


def _per_rotor(
    component: str, symbol: str, name: str, unit: str, *, span: float, scale: float = 1.0
) -> tuple[Signal, ...]:
    return tuple(
        _signal(
            component,
            f"{symbol}_{rotor}",
            name.format(rotor),
            unit,
            span=span,
            rotor=rotor,
            scale=scale,
        )
        for rotor in columns.ROTORS
    )


def _angle(state: str, symbol: str, name: str, unit: str = "°") -> Signal:
    return _signal(f"rigid_body.{state}", symbol, name, unit, span=0.5, scale=_IN_DEGREES)


TIME = Signal(column=columns.TIME, symbol="t", name="time", unit="s")
ENERGY = Signal(column=columns.ENERGY, symbol="E", name="energy", unit="J", smallest_span=1.0)
POWER = _signal("power.total", "P", "power", "W", span=1.0)

POSITION = tuple(_signal(f"rigid_body.{a}", a, "position", "m", span=0.1) for a in "xyz")
VELOCITY = tuple(_signal(f"rigid_body.v{a}", f"v_{a}", "velocity", "m/s", span=0.1) for a in "xyz")
ATTITUDE = (
    _angle("phi", r"\phi", "roll"),
    _angle("theta", r"\theta", "pitch"),
    _angle("psi", r"\psi", "yaw"),
)
BODY_RATE = (
    _angle("p", "p", "roll rate", "°/s"),
    _angle("q", "q", "pitch rate", "°/s"),
    _angle("r", "r", "yaw rate", "°/s"),
)
ROTOR_SPEED = _per_rotor("rotors.omega", r"\omega", "rotor speed", "rad/s", span=5.0)
ROTOR_ACCELERATION = _per_rotor(
    "rotors.alpha", r"\alpha", "acceleration of rotor {}", "rad/s²", span=1.0
)
TORQUE = _per_rotor("rotors.motor_torque", r"\tau", "motor torque", "mN m", span=0.05, scale=1e3)

# Rows: place, velocity, attitude, body rates.  The last column holds the rotors.
STATE_GRID = tuple(
    (*row, speed)
    for row, speed in zip((POSITION, VELOCITY, ATTITUDE, BODY_RATE), ROTOR_SPEED, strict=True)
)

# One tuple per panel, one signal per rotor in it.
MOTOR = (
    ROTOR_SPEED,
    TORQUE,
    _per_rotor("rotors.motor_current", "i", "motor current", "A", span=0.05),
    _per_rotor("rotors.motor_voltage", "v", "motor voltage", "V", span=0.05),
)

BATTERY = (
    _signal("battery.voltage", r"V_\mathrm{bat}", "voltage", "V", span=0.1),
    _signal("battery.current", r"i_\mathrm{bat}", "current", "A", span=0.1),
    _signal("battery.state_of_charge", r"\mathrm{SoC}", "state of charge", "%", span=0.1),
)

WIND = tuple(
    _signal(f"wind.velocity_{a}", f"v_{a}^\\mathrm{{wind}}", f"wind along {a}", "m/s", span=0.1)
    for a in "xy"
)
