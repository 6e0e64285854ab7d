"""Groups of columns of a flight's table that figures draw together."""

from pyomo_quad.flight import columns
from pyomo_quad.flight.columns import ROTORS, Column, column_of


def _group(*variables: str) -> tuple[Column, ...]:
    return tuple(map(column_of, variables))


def _per_rotor(component: str) -> tuple[Column, ...]:
    return _group(*(f"{component}[{rotor}]" for rotor in ROTORS))


TIME = Column(columns.TIME, words="time", symbol="t", unit="s")
ENERGY = column_of(columns.ENERGY)
POWER = column_of("power.total")

POSITION = _group("rigid_body.x", "rigid_body.y", "rigid_body.z")
VELOCITY = _group("rigid_body.vx", "rigid_body.vy", "rigid_body.vz")
ATTITUDE = _group("rigid_body.phi", "rigid_body.theta", "rigid_body.psi")
BODY_RATE = _group("rigid_body.p", "rigid_body.q", "rigid_body.r")
ROTOR_SPEED = _per_rotor("rotors.omega")
ROTOR_ACCELERATION = _per_rotor("rotors.alpha")
TORQUE = _per_rotor("rotors.motor_torque")

# Panels of the figure of states. Rows: position, velocity, attitude, body rates. Last column:
# rotor speeds.
STATE_GRID = tuple(
    (*row, speed)
    for row, speed in zip((POSITION, VELOCITY, ATTITUDE, BODY_RATE), ROTOR_SPEED, strict=True)
)

# One tuple for each panel, one column for each rotor in it.
MOTOR = (
    ROTOR_SPEED,
    TORQUE,
    _per_rotor("rotors.motor_current"),
    _per_rotor("rotors.motor_voltage"),
)

BATTERY = _group("battery.voltage", "battery.current", "battery.state_of_charge")
#: Columns of a battery pack that is modelled as an equivalent circuit.
CIRCUIT = _group("battery.relaxation_voltage", "battery.temperature")
WIND = _group("wind.velocity_x", "wind.velocity_y")
