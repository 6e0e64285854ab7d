"""Tables `wind` and `air` of a scenario: wind velocity, its coupling, and air density.

The wind is a formula of time, a measured series, or a field over places. The coupling is the way in
which it acts on the vehicle: through the drag, or as an acceleration, as in Yacef et al.

The air density follows from height and temperature. The vehicle's aerodynamic coefficients are
proportional to the air density. Arguments `provenance` hold the origin of each value, such as
"default", by the dotted path of the field.
"""

from collections.abc import Iterator, Mapping
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Self

from pydantic import ValidationError, model_validator

from pyomo_quad.scenario.fields import (
    FieldPath,
    Number,
    Part,
    Sound,
    Text,
    Triple,
    WholeNumber,
    is_number,
    late_quantity,
    not_negative,
    positive,
    quantity,
    set_value,
    spell,
    table_at,
    title_field,
)
from pyomo_quad.scenario.messages import shown
from pyomo_quad.scenario.packed_arrays import unpacked

if TYPE_CHECKING:
    from numpy import bool_
    from numpy.typing import ArrayLike, NDArray

    from pyomo_quad.arrays import FloatArray


#: Largest wind speed of a scenario [m/s]: a third above the strongest gust measured, on Barrow
#: Island in 1996 (WMO).
LARGEST_WIND = 150.0
STRONGEST_GUST = "the strongest gust measured on earth had 113 m/s"
#: Latest wind time [s], thirty years; in double precision, times up to it resolve a microsecond.
LATEST_TIME = 1e9
_WIND = Sound(-LARGEST_WIND, LARGEST_WIND, STRONGEST_GUST)
#: Standard height of wind measurements over open country [m], for which winds are given.
USUAL_HEIGHT = 10.0
_FAST = Sound(-1e4, 1e4, "gusts take longer than 1 ms")


class WindCoupling(StrEnum):
    """Effect of the wind: drag due to airspeed, or the acceleration of Yacef et al., eq. (9)."""

    ACCELERATION = "acceleration"
    DRAG = "drag"


class FrequencyUnit(StrEnum):
    """Unit of the frequencies of the wind's harmonics: rad/s as in Yacef et al., or hertz."""

    RADIAN_PER_SECOND = "rad/s"
    HERTZ = "hz"


class WindAxis(Part):
    """Wind along one axis by Yacef et al., eq. (11)-(12): mean, three harmonics and a gust."""

    mean: Number = quantity("m/s", "mean value (v0)", sound=_WIND)
    amplitudes: Triple = quantity("m/s", "amplitudes of the harmonics (A_k)", sound=_WIND)
    frequencies: Triple = quantity(
        "rad/s", "frequencies of the harmonics, see frequency_unit", sound=_FAST
    )
    gust_amplitude: Number = quantity("m/s", "gust amplitude (v_gmax)", sound=_WIND)
    gust_period: Number = quantity(
        "s", "gust period (T_g)", sound=positive(1e-3, 1e6, "gusts last from seconds to minutes")
    )


class WindLaw(StrEnum):
    """Law by which the horizontal wind grows with height: power law or logarithmic law."""

    POWER = "power"
    LOGARITHMIC = "logarithmic"


class WindProfile(Part):
    """Growth of the horizontal wind with height above ground, by a power or logarithmic law."""

    law: WindLaw = quantity(
        "", "power: (z / reference_height)^exponent, or logarithmic: ln(z / roughness)"
    )
    reference_height: Number = quantity(
        "m",
        "height for which the wind is given",
        USUAL_HEIGHT,
        sound=positive(0.5, 1e3, "winds are measured at 0.5 m to 1000 m"),
    )
    exponent: Number | None = quantity(
        "1",
        "exponent of the power law: about 0.11 over water, 0.14 over open country, 0.3 over a town",
        None,
        sound=positive(1e-3, 1, "exponents range up to 0.4 over cities"),
    )
    roughness: Number | None = quantity(
        "m",
        "height at which the logarithmic law has no wind: 2e-4 over water, 0.03 over grass, "
        "1 over a town",
        None,
        sound=positive(1e-6, 10, "from 1e-5 m over ice to 4 m over a city of towers"),
    )

    @model_validator(mode="after")
    def _has_its_number(self) -> Self:
        is_power = self.law is WindLaw.POWER
        needed, other = ("exponent", "roughness") if is_power else ("roughness", "exponent")
        if getattr(self, needed) is None:
            raise ValueError(f"law = {self.law.value} needs {needed}; give {needed}")
        if getattr(self, other) is not None:
            raise ValueError(f"{other} is not used by law = {self.law.value}; leave {other} out")
        if self.roughness is not None and self.roughness >= self.reference_height / 2:
            raise ValueError(
                f"roughness = {self.roughness:g} m; must be below half of "
                f"reference_height = {self.reference_height:g} m; lower it or raise the height"
            )
        return self


class WindSeries(Part):
    """Measured wind over time, height or both, read from the file named `wind.file`."""

    times: tuple[Number, ...] = quantity(
        "s", "times of the wind values; the mission starts at wind.time_offset"
    )
    wind_x: tuple[Number, ...] = quantity("m/s", "wind toward +x")
    wind_y: tuple[Number, ...] = quantity("m/s", "wind toward +y")
    heights: tuple[Number, ...] = late_quantity(
        "m", "heights of the wind values at each time, the same at all times", ()
    )


class Intensity(StrEnum):
    """Intensity of turbulence, defined by the wind 6 m above ground (MIL-F-8785C, 3.7.3.4).

    This wind is 15 knots for `LIGHT`, 30 knots for `MODERATE` and 45 knots for `SEVERE` turbulence.
    """

    LIGHT = "light"
    MODERATE = "moderate"
    SEVERE = "severe"


KNOT = 1852.0 / 3600.0  # m/s
#: Wind at 6 m (20 ft) above the ground [m/s] that defines each intensity; MIL-F-8785C, figure 7.
WIND_AT_6_M = {
    Intensity.LIGHT: 15.0 * KNOT,
    Intensity.MODERATE: 30.0 * KNOT,
    Intensity.SEVERE: 45.0 * KNOT,
}


class Turbulence(Part):
    """Dryden turbulence at low altitude, by MIL-F-8785C."""

    intensity: Intensity | None = quantity(
        "", "light, moderate or severe: a wind at 6 m of 7.7, 15.4 or 23.2 m/s", None
    )
    wind_at_6_m: Number | None = quantity(
        "m/s",
        "wind at 6 m (20 ft) above the ground, in place of intensity",
        None,
        sound=not_negative(LARGEST_WIND, STRONGEST_GUST),
    )
    seed: WholeNumber = quantity("1", "seed of the turbulence's noise", 0, ge=0)

    @model_validator(mode="after")
    def _has_one_strength(self) -> Self:
        if (self.intensity is None) == (self.wind_at_6_m is None):
            found = "neither is" if self.intensity is None else "both are"
            raise ValueError(
                f"{found} given of intensity and wind_at_6_m; give one: intensity = light, "
                "moderate or severe, or wind_at_6_m in m/s"
            )
        return self

    @property
    def strength(self) -> float:
        """Wind speed 6 m above ground [m/s], which determines the intensity of the turbulence."""
        return WIND_AT_6_M[self.intensity] if self.intensity else self.wind_at_6_m or 0.0


class Beyond(StrEnum):
    """Treatment of places outside a wind field, and of grid cells whose wind is missing.

    `REFUSE` keeps the plan within the edges of the field, and rejects a plan through cells whose
    wind is missing; `HOLD` uses the nearest known wind.
    """

    REFUSE = "refuse"
    HOLD = "hold"


class WindGrid(Part):
    """Wind on a rectilinear grid of places, heights and times, from the file `wind.field`."""

    x: tuple[Number, ...] = quantity("m", "places along world x, rising")
    y: tuple[Number, ...] = quantity("m", "places along world y, rising")
    z: tuple[Number, ...] = quantity(
        "m", "heights, rising; empty for a field of a single height", ()
    )
    times: tuple[Number, ...] = quantity("s", "times, rising; empty for a steady field", ())
    speeds: Text = quantity(
        "",
        "wind toward +x, +y and, where it is known, +z at each place, not a number where there is "
        "none: doubles in the order of component, x, y, z, time, least byte first, compressed by "
        "zlib and written in base64",
    )

    @property
    def axes(self) -> tuple[tuple[float, ...], ...]:
        """Grid points of x and y [m] and, if the field has them, of height [m] and time [s]."""
        return tuple(axis for axis in (self.x, self.y, self.z, self.times) if axis)

    @property
    def components(self) -> "FloatArray":
        """Wind velocity at the grid points [m/s]; NaN where the wind is missing.

        The factor `wind.field_scale` is not applied. The first array axis is the direction (+x, +y
        and, if known, +z). The others are those of `axes`, in this order.
        """
        return unpacked(self.speeds).reshape((-1, *map(len, self.axes)))

    @property
    def edges(self) -> dict[str, tuple[int, float, float]]:
        """Position of the grid's edges by name ("west", "east" and so on).

        A position is (axis, end, coordinate [m]). Axis 0 is x, 1 is y, 2 is z. The end is -1 at the
        lower and 1 at the upper end. Without heights, there is no "bottom" and "top".
        """
        names = (("west", "east"), ("south", "north"), ("bottom", "top"))
        return {
            name: (axis, side, points[end])
            for axis, points, ends in zip(range(3), (self.x, self.y, self.z), names, strict=True)
            if points
            for name, side, end in zip(ends, (-1.0, 1.0), (0, -1), strict=True)
        }

    def is_known(self, places: "ArrayLike", times: "ArrayLike") -> "NDArray[bool_]":
        """Return whether the wind at given places and times is known, shape (n,).

        The result is True if place and time are inside the grid, and the nearest grid point has
        known wind. `places` have shape (n, 3) [m], and `times` [s] shape (n,) or (). `times` are
        times of the wind data: the flight starts at the time `wind.time_offset`.
        """
        import numpy as np  # noqa: PLC0415  see `components`

        at, when = np.atleast_2d(places), np.broadcast_to(times, len(np.atleast_2d(places)))
        told = zip((self.x, self.y, self.z, self.times), (*at.T, when), strict=True)
        inside: NDArray[bool_] = np.ones(len(at), dtype=bool)
        nearest = []
        for points, held in ((np.array(axis), held) for axis, held in told if axis):
            slack = _GRID_SLACK * (points[-1] - points[0])
            inside &= (held >= points[0] - slack) & (held <= points[-1] + slack)
            nearest.append(np.searchsorted((points[:-1] + points[1:]) / 2, held))
        has_wind = np.asarray(np.isfinite(self.components).all(axis=0))
        return inside & has_wind[tuple(nearest)]


# Distance outside a grid, relative to its extent, below which a place is on its border.
_GRID_SLACK = 1e-6


class Wind(Part):
    """Wind velocity in world axes, its effect on the vehicle, and its uncertainty."""

    use: Text = quantity("", "name of the wind in the library, or a file of its own, NAME.toml")
    title: Text = title_field("name for people")
    coupling: WindCoupling = quantity(
        "",
        "drag: drag on the airspeed, the default for a vehicle with drag; acceleration: eq. (9) of "
        "Yacef et al. as printed, the default for a vehicle without drag",
    )
    acceleration_coefficient: Number = quantity(
        "1/s",
        "acceleration over wind velocity in eq. (9) of Yacef et al.",
        1.0,
        sound=not_negative(1e3, "a larger value carries the vehicle along within 1 ms"),
    )
    frequency_unit: FrequencyUnit = quantity(
        "",
        "unit of the frequencies: rad/s (as in Yacef et al., eq. (11)) or hz",
        FrequencyUnit.RADIAN_PER_SECOND,
    )
    speed: Number = quantity("m/s", "steady wind added to the means", 0.0, ge=0, sound=_WIND)
    direction: Number = quantity(
        "rad",
        "where the steady wind blows to, 0 is +x",
        0.0,
        sound=Sound(-1e4, 1e4, "directions are in radians, a turn is 6.283"),
    )
    time_offset: Number = quantity(
        "s",
        "wind time at the start of the mission",
        0.0,
        sound=Sound(-LATEST_TIME, LATEST_TIME, "thirty years"),
    )
    file: Text | None = quantity(
        "",
        "CSV file time_s,wind_x_m_per_s,wind_y_m_per_s in place of wind.x and wind.y; with "
        "height_m in place of time_s, or after it with all heights at each time, the wind by "
        "height, constant below the lowest and above the highest",
        None,
    )
    series: WindSeries | None = quantity("", "the wind read from file", None)
    field: Text | None = late_quantity(
        "",
        "file of a wind that varies from place to place, in place of wind.x and wind.y: NetCDF "
        "with CF names and units, or CSV or Parquet with the columns x_m,y_m, perhaps z_m and "
        "time_s, then wind_x_m_per_s,wind_y_m_per_s and perhaps wind_z_m_per_s",
        None,
    )
    field_scale: Number = late_quantity(
        "1",
        "factor on the wind of the field",
        1.0,
        sound=Sound(-1e3, 1e3, "a larger factor is probably a typing error"),
    )
    beyond: Beyond = late_quantity(
        "",
        "behaviour outside the field and in cells without wind: refuse the plan, or hold the "
        "nearest wind",
        Beyond.REFUSE,
    )
    grid: WindGrid | None = late_quantity("", "the wind read from field", None)
    x: WindAxis = quantity("", "wind toward +x")
    y: WindAxis = quantity("", "wind toward +y")
    vertical: Number = late_quantity(
        "m/s", "steady wind upwards, the same at every height", 0.0, sound=_WIND
    )
    profile: WindProfile | None = late_quantity(
        "", "law of the horizontal wind over height, constant when absent", None
    )
    speed_deviation: Number = late_quantity(
        "m/s",
        "standard deviation of the error of the forecast wind speed",
        0.0,
        sound=not_negative(LARGEST_WIND, STRONGEST_GUST),
    )
    direction_deviation: Number = late_quantity(
        "rad",
        "standard deviation of the error of the forecast wind direction",
        0.0,
        sound=not_negative(
            1.6, "a quarter turn is 1.57 rad; with a larger error the direction is unknown"
        ),
    )
    turbulence: Turbulence | None = late_quantity(
        "", "turbulence in flight, none when absent", None
    )
    forecast: Self | None = quantity(
        "", "wind assumed by the optimiser, the actual wind when absent", None
    )

    @property
    def is_formula(self) -> bool:
        """Whether the wind is computed by Yacef et al., eq. (11)-(12), and not read from a file."""
        return self.series is None and self.grid is None

    @property
    def varies_with_place(self) -> bool:
        """Whether the wind depends on the position or height of the vehicle."""
        has_heights = bool(self.series and self.series.heights)
        return self.profile is not None or has_heights or self.grid is not None

    @model_validator(mode="after")
    def _has_one_profile(self) -> Self:
        if self.profile is not None and self.series is not None and self.series.heights:
            raise ValueError(
                "profile cannot be used with a wind.file that has heights; leave profile out"
            )
        if self.profile is not None and self.grid is not None and self.grid.z:
            raise ValueError(
                "profile cannot be used with a wind.field that has heights; leave profile out"
            )
        if self.file is not None and self.field is not None:
            raise ValueError("file and field both give the wind; leave one out")
        idle = "field_scale" if self.field_scale != 1.0 else "beyond"
        is_idle = self.field_scale != 1.0 or self.beyond is not Beyond.REFUSE
        if is_idle and self.field is None and self.grid is None:
            raise ValueError(f"{idle} is used only with wind.field; leave {idle} out")
        return self

    def complaints(self, place: tuple[float, float, float]) -> Iterator[str]:
        """Yield an error message if the wind at a place is missing at all times of the wind field.

        The wind is missing outside the grid and where the file has no value. If there is no wind
        field, or if `wind.beyond` is "hold", there is no message.

        Parameters
        ----------
        place : tuple of float
            Position x, y, z [m].
        """
        # With "hold", the nearest known wind replaces a missing wind.
        if self.grid is None or self.beyond is Beyond.HOLD:
            return
        times = self.grid.times or (0.0,)
        if not self.grid.is_known([place] * len(times), times).any():
            ends = zip("xyz", (self.grid.x, self.grid.y, self.grid.z), strict=True)
            within = ", ".join(f"{name} {at[0]:g} to {at[-1]:g}" for name, at in ends if at)
            yield (
                f"has no wind in wind.field = {shown(str(self.field))}, of {within} m with missing "
                'cells left out; move it, give more of the field, or set wind.beyond = "hold"'
            )

    @model_validator(mode="before")
    @classmethod
    def _forecast_has_no_forecast(cls, tables: object) -> object:
        forecast = tables.get("forecast") if isinstance(tables, Mapping) else None
        if isinstance(forecast, Mapping) and forecast.get("forecast") is not None:
            raise ValueError("forecast.forecast is not allowed; remove it")
        if isinstance(forecast, Mapping) and forecast.get("turbulence") is not None:
            raise ValueError(
                "forecast.turbulence is not allowed: plans know the statistics of the turbulence "
                "that flights meet; give it to wind.turbulence"
            )
        return tables


#: Air density of the standard atmosphere at sea level [kg/m³], to which vehicles' numbers refer.
SEA_LEVEL_DENSITY = 1.225
# Constants of the troposphere, ISO 2533:1975.
_SEA_LEVEL_PRESSURE = 101_325.0  # Pa
_SEA_LEVEL_TEMPERATURE = 288.15  # K
_LAPSE = 0.0065  # K/m
_GAS_CONSTANT = 287.05287  # J/(kg K)
_GRAVITY = 9.80665  # m/s^2
_EARTH_RADIUS = 6_356_766.0  # m
_DENSITY: FieldPath = ("power", "air_density")
# Coefficients of forces and torques that are proportional to the air density.
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
    """Air at a height above the sea, by the standard atmosphere (ISA, ISO 2533:1975)."""

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
        sound=Sound(180, 340, "temperatures on the ground are -93 to 67 degrees Celsius"),
    )

    @property
    def density(self) -> float:
        """Density of the air [kg/m³], which follows from height and temperature."""
        geopotential = self.height / (1 + self.height / _EARTH_RADIUS)
        standard = _SEA_LEVEL_TEMPERATURE - _LAPSE * geopotential
        exponent = _GRAVITY / (_GAS_CONSTANT * _LAPSE)
        pressure = _SEA_LEVEL_PRESSURE * (standard / _SEA_LEVEL_TEMPERATURE) ** exponent
        temperature = standard if self.temperature is None else self.temperature
        return float(pressure / (_GAS_CONSTANT * temperature))


def with_air_density(
    tables: dict[str, Any], before: Mapping[str, Any] | None, provenance: dict[str, str]
) -> dict[str, Any]:
    """Scale the vehicle's aerodynamic coefficients to the air density of the scenario.

    `before` is a stored scenario, whose coefficients are valid at its own air density. Without
    `before`, they are valid at sea level. In `provenance`, the origins of scaled coefficients are
    extended by the density.
    """
    density, held_at = _density(tables), _density(before or {})
    if density == held_at:
        return tables
    numbers = table_at(tables, "vehicle")
    for name in _OF_AIR:
        number = numbers.get(name)
        scaled = _scaled(number, density / held_at)
        if scaled is not None:
            tables = set_value(tables, ("vehicle", name), scaled)
            said = provenance.get(spell(("vehicle", name)), "default")
            provenance[spell(("vehicle", name))] = f"{said}, in air of {density:.4g} kg/m^3"
    # A density that the user gives for a new scenario is kept.
    if provenance.get(spell(_DENSITY), "default") == "default" or before is not None:
        tables = set_value(tables, _DENSITY, density)
        provenance[spell(_DENSITY)] = "air"
    return tables


# Coefficients of forces that depend on the airspeed.
_DRAG = (
    "drag_linear",
    "drag_quadratic",
    "rotor_drag_plane",
    "rotor_drag_axis",
    "parasitic_drag",
)


def with_coupling(
    tables: dict[str, Any], own: Mapping[str, Any], provenance: dict[str, str]
) -> dict[str, Any]:
    """Set the default of the wind's coupling, the way in which the wind acts on the vehicle.

    If the vehicle has drag coefficients, the wind acts through the drag. Otherwise the wind is an
    acceleration, as in eq. (9) of Yacef et al. A forecast without a coupling in the user's own
    values, `own`, gets that of the wind. Origins are added to `provenance`.
    """
    wind = tables.get("wind")
    if not isinstance(wind, Mapping):
        return tables
    if "coupling" not in wind:
        numbers = table_at(tables, "vehicle")
        cause = next((name for name in _DRAG if _is_any(numbers.get(name))), None)
        coupling = WindCoupling.ACCELERATION if cause is None else WindCoupling.DRAG
        tables = set_value(tables, ("wind", "coupling"), coupling)
        why = "no drag" if cause is None else f"vehicle.{cause}"
        provenance["wind.coupling"] = f"default: the vehicle has {why}"
    # A forecast without a coupling gets that of the actual wind.
    forecast = own.get("wind", {}).get("forecast") if "forecast" in wind else None
    if isinstance(forecast, Mapping) and "coupling" not in forecast:
        path: FieldPath = ("wind", "forecast", "coupling")
        tables = set_value(tables, path, tables["wind"]["coupling"])
        provenance[spell(path)] = "wind.coupling"
    return tables


def _is_any(number: object) -> bool:
    """Return whether a coefficient (a number, or a list of numbers) has a value other than zero."""
    return any(number) if isinstance(number, list | tuple) else bool(number)


def _density(tables: Mapping[str, Any]) -> float:
    if "air" not in tables:
        return SEA_LEVEL_DENSITY
    try:
        return Air.model_validate(tables["air"]).density
    except ValidationError:
        return SEA_LEVEL_DENSITY  # validation of the scenario gives a better message


def _scaled(number: object, factor: float) -> Any:  # noqa: ANN401
    if isinstance(number, list | tuple):
        parts = [_scaled(part, factor) for part in number]
        return None if None in parts else parts
    return number * factor if is_number(number) else None
