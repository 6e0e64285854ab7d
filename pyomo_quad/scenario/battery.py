"""The battery pack: equal cells in series and parallel, eq. (4)-(5)."""

from pyomo_quad.scenario.fields import ONE_LINE, Number, Part, Sound, Text, WholeNumber, quantity

__all__ = ["Battery"]


_VOLTAGE = Sound(0, 100, "the cells of all chemistries have 1 to 5 V")


class Battery(Part):
    """Cell constants of the Tremblay-Dessaint model and the number of cells."""

    use: Text = quantity("", "name of the battery in the library")
    title: Text = quantity(
        "", "name for people", pattern=ONE_LINE, allowed="one line", max_length=200
    )
    cells_series: WholeNumber = quantity("1", "cells in series", ge=1, le=1000)
    cells_parallel: WholeNumber = quantity("1", "cells in parallel", ge=1, le=1000)
    E0: Number = quantity(
        "V",
        "constant voltage of one cell (e0)",
        gt=0,
        sound=Sound(0.1, 100, "the cells of all chemistries have 1 to 5 V"),
    )
    K: Number = quantity("V", "polarisation voltage of one cell (k)", ge=0, sound=_VOLTAGE)
    A: Number = quantity("V", "exponential voltage of one cell (c1)", ge=0, sound=_VOLTAGE)
    B: Number = quantity(
        "1/A/hr",
        "inverse exponential capacity of one cell (c2)",
        ge=0,
        sound=Sound(
            0, 1e4, "the first rise is over within a thousandth of the charge at the earliest"
        ),
    )
    capacity: Number = quantity(
        "A*hr",
        "capacity of one cell (Qbat)",
        gt=0,
        sound=Sound(1e-4, 1e4, "cells hold from a milliampere hour to a thousand ampere hours"),
    )
    cell_resistance: Number = quantity(
        "ohm",
        "resistance of one cell (Rbat)",
        gt=0,
        sound=Sound(1e-6, 100, "cells have from tenths of a milliohm to ohms"),
    )
    initial_state_of_charge: Number = quantity(
        "percent", "state of charge at the start", 100.0, gt=0, le=100
    )
