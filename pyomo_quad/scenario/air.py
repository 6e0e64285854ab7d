"""The density of the air from height and temperature, and what of a vehicle goes with it."""

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from pyomo_quad.scenario.fields import Number, Part, Sound, quantity
from pyomo_quad.scenario.tree import FieldPath, set_value, spell

#: kg/m^3. Of the standard atmosphere at sea level, at which the numbers of vehicles hold.
SEA_LEVEL_DENSITY = 1.225
# The troposphere of ISO 2533:1975.
_SEA_LEVEL_PRESSURE = 101_325.0  # Pa
_SEA_LEVEL_TEMPERATURE = 288.15  # K
_LAPSE = 0.0065  # K/m
_GAS_CONSTANT = 287.05287  # J/(kg K)
_GRAVITY = 9.80665  # m/s^2
_EARTH_RADIUS = 6_356_766.0  # m
_DENSITY: FieldPath = ("power", "air_density")
# Forces and torques of the air, each proportional to its density.
_OF_AIR = (
    "thrust_coefficient",
    "drag_torque_coefficient",
    "drag_linear",
    "drag_quadratic",
    "rotor_drag_plane",
    "rotor_drag_axis",
    "translational_lift",
    "parasitic_drag",
)


class Air(Part):
    """The air of the standard atmosphere (ISA, ISO 2533:1975) at a height."""

    height: Number = quantity(
        "m",
        "height of the ground above sea level",
        0.0,
        sound=Sound(-500, 11_000, "the standard troposphere ends at 11 km"),
    )
    temperature: Number | None = quantity(
        "K",
        "temperature of the air, the standard atmosphere's when absent",
        None,
        sound=Sound(180, 340, "air on the ground has -93 to 67 degrees Celsius"),
    )

    @property
    def density(self) -> float:
        """Mass per volume, kg/m^3."""
        geopotential = self.height / (1 + self.height / _EARTH_RADIUS)
        standard = _SEA_LEVEL_TEMPERATURE - _LAPSE * geopotential
        exponent = _GRAVITY / (_GAS_CONSTANT * _LAPSE)
        pressure = _SEA_LEVEL_PRESSURE * (standard / _SEA_LEVEL_TEMPERATURE) ** exponent
        temperature = standard if self.temperature is None else self.temperature
        return float(pressure / (_GAS_CONSTANT * temperature))


def in_the_air(
    tables: dict[str, Any], before: Mapping[str, Any] | None, provenance: dict[str, str]
) -> dict[str, Any]:
    """Return a scenario's tables with the vehicle's numbers as they are in the scenario's air.

    They hold at sea level or, in tables that were completed `before`, in the air of those.
    """
    density, held_at = _density(tables), _density(before or {})
    if density == held_at:
        return tables
    vehicle = tables.get("vehicle")
    numbers = vehicle if isinstance(vehicle, Mapping) else {}
    for name in _OF_AIR:
        number = numbers.get(name)
        scaled = _scaled(number, density / held_at)
        if scaled is not None:
            tables = set_value(tables, ("vehicle", name), scaled)
            said = provenance.get(spell(("vehicle", name)), "default")
            provenance[spell(("vehicle", name))] = f"{said}, in air of {density:.4g} kg/m^3"
    if provenance.get(spell(_DENSITY), "default") == "default" or before is not None:
        tables = set_value(tables, _DENSITY, density)
        provenance[spell(_DENSITY)] = "air"
    return tables


def _density(tables: Mapping[str, Any]) -> float:
    if "air" not in tables:
        return SEA_LEVEL_DENSITY
    try:
        return Air.model_validate(tables["air"]).density
    except ValidationError:
        return SEA_LEVEL_DENSITY  # validation of the whole says it better


def _scaled(number: object, factor: float) -> Any:  # noqa: ANN401
    if isinstance(number, list | tuple):
        parts = [_scaled(part, factor) for part in number]
        return None if None in parts else parts
    is_number = isinstance(number, int | float) and not isinstance(number, bool)
    return number * factor if is_number else None  # type: ignore[operator]
