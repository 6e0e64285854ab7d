"""Estimation of a battery's cells, capacity, resistance and voltage from its label ("4S5000").

Sources and ranges: see docs/theory/vehicle_from_data.md, eqs. (7) and (8).
"""

import re
from dataclasses import dataclass

from pyomo_quad.scenario import ScenarioError
from pyomo_quad.scenario.messages import shown
from pyomo_quad.vehicles.estimate import Estimate, computed, estimated, given

_LABEL = re.compile(
    r"([0-9]{1,2})\s*[sS]\s*(?:([0-9]{1,2})\s*[pP]\s*)?([0-9]{2,6})(?:\s*[mM][aA][hH])?"
)
#: Nominal voltage of one lithium-polymer cell [V].
NOMINAL_V = 3.7
# Energy over mass of batteries for multirotors [J/kg]: 150 Wh/kg. Assumed; the Matrice 100's has
# 190.
_ENERGY_PER_KG = 150 * 3600
# Resistance times capacity of one cell [ohm A h]: a current of 1C reduces its voltage by 15 mV.
_RESISTANCE_BY_CAPACITY = 0.015
# E0, K and A of a lithium-polymer cell in eq. (5) of the paper, which gives 4.17 V for a full cell,
# 3.78 V at half and 3.54 V at a tenth of the charge.
_CONSTANT_V, _POLARISATION_V, _EXPONENTIAL_V = 3.73, 0.022, 0.46
# B of eq. (5) times the capacity, of that cell.
_EXPONENTIAL_SHARE = 3.2
_SECONDS_PER_HOUR = 3600.0


@dataclass(frozen=True, kw_only=True)
class Pack:
    """Battery pack, described by the numbers on its label: cells and capacity.

    Attributes
    ----------
    series, parallel : int
        Cells in series and in parallel.
    capacity : float
        Capacity of the whole pack [A h].
    is_given : bool
        Whether the owner stated the label; otherwise the pack is estimated from the vehicle's mass.
    """

    series: int
    parallel: int
    capacity: float
    is_given: bool

    @property
    def nominal_voltage(self) -> float:
        """Nominal voltage of the pack [V]: 3.7 V for each cell in series."""
        return self.series * NOMINAL_V

    @property
    def mass(self) -> float:
        """Mass of the pack [kg], estimated from its energy.

        Derivation: see docs/theory/vehicle_from_data.md, eq. (7).
        """
        return self.nominal_voltage * self.capacity * _SECONDS_PER_HOUR / _ENERGY_PER_KG

    @property
    def label(self) -> str:
        """Label of the pack, such as "4S 5000 mAh"."""
        cells = f"{self.series}S" + (f"{self.parallel}P" if self.parallel > 1 else "")
        return f"{cells} {1000 * self.capacity:g} mAh"

    def fields(self) -> dict[str, Estimate]:
        """Return the estimated value of each field of a battery file, by the field's name.

        Each value is an `Estimate`, which also has a range of uncertainty and the origin.
        """
        capacity = self.capacity / self.parallel
        resistance = _RESISTANCE_BY_CAPACITY / capacity

        def of_label(value: float) -> Estimate:
            if self.is_given:
                return given(value, f"battery {self.label}")
            return estimated(value, "pack of 30 % of the mass at 150 Wh/kg", 0.5, 1.6)

        curve = "lithium-polymer cell, 4.2 V full, 3.8 V at half, 3.5 V at a tenth of its charge"
        return {
            "cells_series": of_label(self.series),
            "cells_parallel": of_label(self.parallel),
            "capacity": of_label(capacity),
            "cell_resistance": estimated(
                resistance, "15 mohm Ah of a cell with its leads, half when new and warm", 0.5, 2.0
            ),
            "E0": estimated(_CONSTANT_V, curve, 0.98, 1.02),
            "K": estimated(_POLARISATION_V, curve, 0.5, 2.0),
            "A": estimated(_EXPONENTIAL_V, curve, 0.8, 1.2),
            "B": computed(_EXPONENTIAL_SHARE / capacity, "3.2 / capacity, same curve"),
        }


def pack_of(text: str) -> Pack:
    """Read a battery label: "4S5000" means 4 cells in series and a capacity of 5000 mAh.

    The number of cells in parallel may follow: "6S2P9000" has 6 in series, 2 in parallel, and 9000
    mAh. ScenarioError is raised if the text is not a label.
    """
    match = _LABEL.fullmatch(text.strip())
    if match is None or int(match[1]) < 1 or int(match[2] or 1) < 1 or float(match[3]) <= 0:
        raise ScenarioError(
            f"--battery {shown(text)[1:-1]}; must be the cells in series and the mAh, such as "
            "4S5000, or 6S2P9000 with two in parallel."
        )
    return Pack(
        series=int(match[1]),
        parallel=int(match[2] or 1),
        capacity=float(match[3]) / 1000,
        is_given=True,
    )


# Usual number of cells in series, for vehicles up to the given mass [kg], and above the last one;
# share of the mass that the pack has. Assumed, as of small multirotors on sale.
_SERIES = ((0.1, 1), (0.35, 2), (0.9, 3), (2.5, 4))
_MOST_SERIES = 6
_MASS_SHARE = 0.3


def usual_pack(mass: float) -> Pack:
    """Estimate the battery pack of a vehicle from the vehicle's mass with its pack [kg].

    The pack is assumed to have 30 % of the mass. The number of cells in series is the usual one for
    this mass. Derivation: see docs/theory/vehicle_from_data.md, eq. (7).
    """
    series = next((cells for most, cells in _SERIES if mass <= most), _MOST_SERIES)
    energy = _MASS_SHARE * mass * _ENERGY_PER_KG
    capacity = energy / (series * NOMINAL_V * _SECONDS_PER_HOUR)
    return Pack(series=series, parallel=1, capacity=float(f"{capacity:.2g}"), is_given=False)
