"""Table `battery` of a scenario: cells, their constants, temperature and state of health."""

from typing import Self

from pydantic import model_validator

from pyomo_quad.scenario.fields import (
    Number,
    Part,
    Sound,
    Text,
    WholeNumber,
    late_quantity,
    not_negative,
    positive,
    quantity,
    title_field,
)

_VOLTAGE = not_negative(100, "cells of all chemistries have 1 to 5 V")
_RESISTANCE = positive(1e-6, 100, "cells have from 0.1 mohm to some ohms")
_TEMPERATURE = Sound(150, 500, "temperatures are in kelvin, 20 degrees Celsius are 293.15 K")
_FACTOR = positive(0.05, 20, "capacity and resistance of usable batteries change less")


class Relaxation(Part):
    """Slow part of a cell's voltage drop, modelled by a resistor and a capacitor in parallel."""

    resistance: Number = quantity(
        "ohm", "slow part of the resistance of one cell", sound=_RESISTANCE
    )
    time_constant: Number = quantity(
        "s",
        "time in which the slow part of the voltage drop reaches 63 % of its final value",
        sound=positive(1e-2, 1e5, "diffusion in a cell takes seconds to hours"),
    )
    initial_voltage: Number = quantity(
        "V",
        "slow part of the voltage drop of one cell at the start, 0 after a rest",
        0.0,
        sound=Sound(-5, 5, "cells have 1 to 5 V"),
    )


class Thermal(Part):
    """Thermal model of a cell: a heat capacity, heated by the cell's losses and cooled by air."""

    heat_capacity: Number = quantity(
        "J/K",
        "heat capacity of one cell",
        sound=positive(1e-2, 1e6, "cells weigh grams to kilograms and take about 1 J/g/K"),
    )
    cooling: Number = quantity(
        "W/K",
        "heat that one cell loses to the air, per kelvin of temperature difference",
        0.0,
        ge=0,
        le=1e4,
    )
    ambient_temperature: Number = quantity(
        "K", "temperature of the air round the pack", 298.15, sound=_TEMPERATURE
    )
    initial_temperature: Number | None = quantity(
        "K",
        "temperature at the start; when absent, the temperature of the air",
        None,
        sound=_TEMPERATURE,
    )
    reference_temperature: Number = quantity(
        "K", "temperature at which the resistances are given", 298.15, sound=_TEMPERATURE
    )
    activation_energy: Number = quantity(
        "J/mol",
        "activation energy of the decrease of the resistances with temperature (Arrhenius); 0 for "
        "constant resistances",
        0.0,
        sound=not_negative(1e6, "cells have 10 to 60 kJ/mol"),
    )

    @property
    def start(self) -> float:
        """Cell temperature at the start of the flight [K], by default the ambient temperature."""
        return (
            self.ambient_temperature
            if self.initial_temperature is None
            else self.initial_temperature
        )


class Health(Part):
    """State of health of a used pack: remaining share of the capacity, growth of the resistance."""

    capacity_factor: Number = quantity(
        "1", "capacity divided by the capacity of the new pack", 1.0, sound=_FACTOR
    )
    resistance_factor: Number = quantity(
        "1", "resistances divided by the resistances of the new pack", 1.0, sound=_FACTOR
    )


class Battery(Part):
    """Battery pack: constants of one cell in the Tremblay-Dessaint model, and number of cells."""

    use: Text = quantity("", "name of the battery in the library, or a file of its own, NAME.toml")
    title: Text = title_field("name for people")
    cells_series: WholeNumber = quantity("1", "cells in series", ge=1, le=1000)
    cells_parallel: WholeNumber = quantity("1", "cells in parallel", ge=1, le=1000)
    E0: Number = quantity(
        "V",
        "constant voltage of one cell (e0)",
        sound=positive(0.1, 100, "cells of all chemistries have 1 to 5 V"),
    )
    K: Number = quantity("V", "polarisation voltage of one cell (k)", sound=_VOLTAGE)
    A: Number = quantity("V", "exponential voltage of one cell (c1)", sound=_VOLTAGE)
    B: Number = quantity(
        "1/A/hr",
        "inverse exponential capacity of one cell (c2)",
        sound=not_negative(1e4, "the exponential zone spans at least 0.1 mAh of charge"),
    )
    capacity: Number = quantity(
        "A*hr",
        "capacity of one cell (Qbat)",
        sound=positive(1e-4, 1e4, "cells hold from 1 mAh to 1000 Ah"),
    )
    cell_resistance: Number = quantity(
        "ohm",
        "resistance of one cell (Rbat); where relaxation is given, the part that acts at once",
        sound=_RESISTANCE,
    )
    initial_state_of_charge: Number = quantity(
        "percent", "state of charge at the start", 100.0, gt=0, le=100
    )
    relaxation: Relaxation | None = late_quantity(
        "", "slow part of the voltage drop, none when absent", None
    )
    thermal: Thermal | None = late_quantity(
        "", "temperature of the pack, not counted when absent", None
    )
    health: Health | None = late_quantity(
        "", "state of health, that of a new pack when absent", None
    )

    @model_validator(mode="after")
    def _has_a_voltage(self) -> Self:
        # Eq. (5) for a full cell, whose voltage E0 + A - K is the cell's highest.
        highest = self.E0 + self.A
        if highest <= self.K:
            raise ValueError(
                f"K = {self.K:g} V leaves a full cell {highest - self.K:.3g} V; must be below "
                f"E0 + A = {highest:g} V; correct K, E0 or A"
            )
        return self
