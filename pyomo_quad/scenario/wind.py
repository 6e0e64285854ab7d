"""The table `wind`: a formula in time, or a measured series, and how it enters the balance."""

from collections.abc import Mapping
from enum import StrEnum
from typing import Self

from pydantic import model_validator

from pyomo_quad.scenario.fields import ONE_LINE, Number, Part, Sound, Text, Triple, quantity

#: m/s. Beyond the strongest gust measured, on Barrow Island in 1996 (WMO), by a third.
LARGEST_WIND = 150.0
STRONGEST_GUST = "the strongest gust measured on earth had 113 m/s"
#: s. Thirty years; a number of that size still tells a microsecond.
LATEST_TIME = 1e9
_WIND = Sound(-LARGEST_WIND, LARGEST_WIND, STRONGEST_GUST)
#: m. Where the wind over open country is measured; winds are given for this height.
USUAL_HEIGHT = 10.0
_FAST = Sound(-1e4, 1e4, "no gust changes within a millisecond")


class WindCoupling(StrEnum):
    """How the wind enters the momentum balance."""

    ACCELERATION = "acceleration"
    DRAG = "drag"


class FrequencyUnit(StrEnum):
    """How the harmonic frequencies of Table 2 are read."""

    RADIAN_PER_SECOND = "rad/s"
    HERTZ = "hz"


class WindAxis(Part):
    """One axis of eq. (11)-(12): mean, three harmonics, gust."""

    mean: Number = quantity("m/s", "mean value (v0)", sound=_WIND)
    amplitudes: Triple = quantity("m/s", "amplitudes of the harmonics (A_k)", sound=_WIND)
    frequencies: Triple = quantity(
        "rad/s", "frequencies of the harmonics, see frequency_unit", sound=_FAST
    )
    gust_amplitude: Number = quantity("m/s", "gust amplitude (v_gmax)", sound=_WIND)
    gust_period: Number = quantity(
        "s",
        "gust period (T_g)",
        gt=0,
        sound=Sound(1e-3, 1e6, "a gust lasts for seconds or minutes"),
    )


class WindLaw(StrEnum):
    """How the wind grows with height."""

    POWER = "power"
    LOGARITHMIC = "logarithmic"


class WindProfile(Part):
    """How the horizontal wind grows with the height z above the ground."""

    law: WindLaw = quantity(
        "", "power: (z / reference_height)^exponent, or logarithmic: ln(z / roughness)"
    )
    reference_height: Number = quantity(
        "m",
        "height at which the wind is as given",
        USUAL_HEIGHT,
        gt=0,
        sound=Sound(0.5, 1e3, "winds are given for a height of metres, masts and towers"),
    )
    exponent: Number | None = quantity(
        "1",
        "exponent of the power law: about 0.11 over water, 0.14 over open country, 0.3 over a town",
        None,
        gt=0,
        sound=Sound(1e-3, 1, "the wind over cities grows with height to the power of 0.4"),
    )
    roughness: Number | None = quantity(
        "m",
        "height at which the logarithmic law has no wind: 2e-4 over water, 0.03 over grass, "
        "1 over a town",
        None,
        gt=0,
        sound=Sound(1e-6, 10, "ice has 1e-5 m, a city of towers some 4 m"),
    )

    @model_validator(mode="after")
    def _has_its_number(self) -> Self:
        is_power = self.law is WindLaw.POWER
        needed, other = ("exponent", "roughness") if is_power else ("roughness", "exponent")
        if getattr(self, needed) is None:
            raise ValueError(f"law = {self.law.value} needs {needed}; give {needed}")
        if getattr(self, other) is not None:
            raise ValueError(f"{other} has no part in law = {self.law.value}; leave {other} out")
        if self.roughness is not None and self.roughness >= self.reference_height / 2:
            raise ValueError(
                f"roughness = {self.roughness:g} m; must be below half of "
                f"reference_height = {self.reference_height:g} m; lower it or raise the height"
            )
        return self


class WindSeries(Part):
    """A measured wind, read and validated from `wind.file`; by height alone it has no times."""

    times: tuple[Number, ...] = quantity("s", "times from the start of the mission")
    wind_x: tuple[Number, ...] = quantity("m/s", "wind toward +x")
    wind_y: tuple[Number, ...] = quantity("m/s", "wind toward +y")
    heights: tuple[Number, ...] = quantity(
        "m", "heights that the wind runs over at each time, or at all of them", (), is_late=True
    )


class Wind(Part):
    """The wind in world axes."""

    use: Text = quantity("", "name of the wind in the library, or a file of its own, NAME.toml")
    title: Text = quantity(
        "", "name for people", pattern=ONE_LINE, allowed="one line", max_length=200
    )
    coupling: WindCoupling = quantity(
        "", "acceleration (eq. 9 as printed) or drag", WindCoupling.ACCELERATION
    )
    acceleration_coefficient: Number = quantity(
        "1/s",
        "turns wind velocity into acceleration, eq. (9)",
        1.0,
        ge=0,
        sound=Sound(0, 1e3, "nothing that flies is carried along within a millisecond"),
    )
    frequency_unit: FrequencyUnit = quantity(
        "", "unit of the frequencies: rad/s (as eq. 11) or hz", FrequencyUnit.RADIAN_PER_SECOND
    )
    speed: Number = quantity("m/s", "steady wind added to the means", 0.0, ge=0, sound=_WIND)
    direction: Number = quantity(
        "rad",
        "where the steady wind blows to, 0 is +x",
        0.0,
        sound=Sound(-1e4, 1e4, "a turn is 6.283 rad"),
    )
    time_offset: Number = quantity(
        "s",
        "wind time at the start of the mission",
        0.0,
        sound=Sound(-LATEST_TIME, LATEST_TIME, "wind is not known for more than thirty years"),
    )
    file: Text | None = quantity(
        "",
        "CSV file time_s,wind_x_m_per_s,wind_y_m_per_s in place of eq. (11)-(12); with height_m "
        "in place of time_s, or after it with all heights at each time, the wind by height, held "
        "beyond the lowest and the highest",
        None,
    )
    series: WindSeries | None = quantity("", "the wind read from file", None)
    x: WindAxis = quantity("", "wind toward +x")
    y: WindAxis = quantity("", "wind toward +y")
    vertical: Number = quantity(
        "m/s", "steady wind upwards, the same at every height", 0.0, sound=_WIND, is_late=True
    )
    profile: WindProfile | None = quantity(
        "",
        "how the horizontal wind grows with height, the same at all when absent",
        None,
        is_late=True,
    )
    forecast: Self | None = quantity(
        "", "the wind that the optimiser is told, the true one when absent", None
    )

    @property
    def varies_with_height(self) -> bool:
        """Whether the horizontal wind depends on where the vehicle flies."""
        return self.profile is not None or bool(self.series and self.series.heights)

    @model_validator(mode="after")
    def _has_one_profile(self) -> Self:
        if self.profile is not None and self.series is not None and self.series.heights:
            raise ValueError(
                "profile has no part in a wind whose file has heights; leave profile out"
            )
        return self

    @model_validator(mode="before")
    @classmethod
    def _forecast_has_no_forecast(cls, tables: object) -> object:
        forecast = tables.get("forecast") if isinstance(tables, Mapping) else None
        if isinstance(forecast, Mapping) and forecast.get("forecast") is not None:
            raise ValueError("forecast.forecast is not allowed; remove it")
        return tables
