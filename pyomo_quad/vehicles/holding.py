"""Comparison of computed with measured powers of vehicles.

The vehicles of the package's library are compared with measurements. For other vehicles only data
sheets exist: their estimated hover powers are compared with the published ones.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
import pandas as pd

from pyomo_quad.arrays import FloatArray
from pyomo_quad.flight import Planner
from pyomo_quad.identification.columns import DENSITY, PAYLOAD, POWER
from pyomo_quad.identification.motion import vehicle_scenario
from pyomo_quad.identification.steady import (
    AIRSPEED,
    ENDURANCE,
    USED_SHARE,
    filled_in,
    level_powers,
)
from pyomo_quad.scenario import PowerModel, Scenario, library_entry, library_names
from pyomo_quad.vehicles.owner import Known, estimate_vehicle
from pyomo_quad.vehicles.pack import pack_of
from pyomo_quad.vehicles.propulsion import propeller_of

#: Columns of the table of data sheets.
SHEET, MEASURED, ESTIMATED, SHEET_ERROR = "vehicle", "measured_W", "estimated_W", "error_percent"
_SECONDS_PER_MINUTE, _JOULES_PER_WATT_HOUR = 60.0, 3600.0
_FOLDER = "measured"
_SHEETS = "sheets.toml"
# Accepted error of a hover power that is estimated from a data sheet [per cent].
ALLOWED_PERCENT = 15.0


@dataclass(frozen=True, kw_only=True)
class Held:
    """Measured and computed powers of a vehicle of the library.

    Attributes
    ----------
    name : str
        Name of the vehicle.
    scenario : Scenario
        Scenario with the vehicle.
    points : DataFrame
        Measurements: power [W], airspeed [m/s], payload [kg], climb speed [m/s], air density
        [kg/m³].
    computed : ndarray, shape (n_points,)
        Computed powers [W]; NaN above the model's greatest airspeed.
    is_endurance : bool
        Whether the measured powers follow from flight times.
    is_fitted : bool
        Whether the power model was fitted to measurements, so that the comparison is no independent
        test.
    source : str
        Source of the measurements.
    """

    name: str
    scenario: Scenario
    points: pd.DataFrame
    computed: FloatArray
    is_endurance: bool
    is_fitted: bool
    source: str

    @property
    def errors(self) -> FloatArray:
        """Error of the computed power for each measurement [percent].

        error = 100 (computed - measured) / measured.
        """
        return 100.0 * (self.computed / self.points[POWER].to_numpy() - 1.0)

    @property
    def mean_error(self) -> float:
        """Mean over the measurements of the absolute value of `errors` [percent]."""
        return float(np.mean(np.abs(self.errors)))

    @property
    def ranges(self) -> str:
        """Ranges of airspeed and payload that the measurements cover, in words."""
        spans = ((AIRSPEED, "airspeed", "m/s"), (PAYLOAD, "carried", "kg"))
        told = [
            f"{words} {self.points[name].min():.3g} to {self.points[name].max():.3g} {unit}"
            for name, words, unit in spans
            if self.points[name].max() > self.points[name].min()
        ]
        hovers = self.points[AIRSPEED].max() == 0.0
        return ", ".join(told) or ("hover alone" if hovers else "one airspeed")


def held_vehicles(planner: Planner | None = None) -> tuple[Held, ...]:
    """Compare all library vehicles with measurements of their power.

    `planner` compiles the vehicles' equations, from which the powers are computed.
    """
    planner = planner or Planner()
    return tuple(held_against(name, planner) for name in library_names("vehicles"))


def held_against(name: str, planner: Planner) -> Held:
    """Compare one library vehicle with measurements of its power.

    `planner` compiles the vehicle's equations, from which the powers are computed.
    """
    entry = library_entry("vehicles", name)
    is_momentum = "vehicle.rotor_radius" in entry.sources
    scenario = vehicle_scenario(name, PowerModel.MOMENTUM if is_momentum else PowerModel.MOTOR)
    with _folder().joinpath(f"{name}.csv").open(encoding="utf-8") as stream:
        read = pd.read_csv(stream)
    points = filled_in(read, scenario).sort_values([PAYLOAD, AIRSPEED], ignore_index=True)
    numbers = ("induced_power_factor", "profile_power_coefficient")
    said = [entry.sources.get(f"vehicle.{number}", "") for number in numbers]
    return Held(
        name=name,
        scenario=scenario,
        points=points,
        computed=_powers(scenario, points, planner),
        is_endurance=ENDURANCE in read,
        is_fitted=any("identified" in one for one in said),
        source=_sources()[name],
    )


def _powers(scenario: Scenario, points: pd.DataFrame, planner: Planner) -> FloatArray:
    found = np.full(len(points), np.nan)
    for _, rows in points.groupby([PAYLOAD, DENSITY], sort=False):
        loaded = scenario.with_values(
            {
                "vehicle.payload": float(rows[PAYLOAD].iloc[0]),
                "power.air_density": float(rows[DENSITY].iloc[0]),
            }
        )
        found[rows.index] = level_powers(loaded, rows[AIRSPEED].tolist(), planner)
    return found


@cache
def _sources() -> Mapping[str, str]:
    """Return the source of each vehicle's measurements, by the vehicle's name."""
    rows = _folder().joinpath("README.md").read_text(encoding="utf-8").splitlines()
    cells = [row.strip("| ").split(" | ") for row in rows if row.startswith("| `")]
    return {file.strip("`").removesuffix(".csv"): origin for file, _, origin, _ in cells}


def _folder() -> Any:  # noqa: ANN401  a Traversable, which has no stable home
    return resources.files("pyomo_quad.vehicles").joinpath(_FOLDER)


def data_sheets() -> pd.DataFrame:
    """Compare estimated with published hover powers of vehicles of which only data sheets exist.

    Each row has title, mass [kg], propeller (diameter and pitch in inches), both powers [W], error
    [percent], kind of publication, and source. The error is 100 (estimated - published) /
    published.
    """
    told = tomllib.loads(_folder().joinpath(_SHEETS).read_text(encoding="utf-8"))
    rows = []
    for name, sheet in told.items():
        pack = pack_of(sheet["battery"])
        known = Known(
            name=name, mass=sheet["mass"], propeller=propeller_of(sheet["propeller"]), pack=pack
        )
        estimated = estimate_vehicle(known).estimated_hover_W
        measured = sheet.get(MEASURED)
        # Some data sheets give only the endurance in hover, which uses 80 % of the nominal energy.
        if measured is None:
            energy = USED_SHARE * pack.nominal_voltage * pack.capacity * _JOULES_PER_WATT_HOUR
            measured = energy / (sheet["endurance_min"] * _SECONDS_PER_MINUTE)
        rows.append(
            {
                SHEET: sheet["title"],
                "mass_kg": sheet["mass"],
                "propeller_in": sheet["propeller"],
                MEASURED: measured,
                ESTIMATED: estimated,
                SHEET_ERROR: 100.0 * (estimated / measured - 1.0),
                "kind": sheet["kind"],
                "source": sheet["source"],
            }
        )
    return pd.DataFrame(rows)
