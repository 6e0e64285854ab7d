"""Fit of a battery's equivalent circuit to the voltages of flights.

Method: see docs/theory/identification.md, eqs. (7) to (9).

The battery equations of the planner's model are simulated under the measured powers of the flights.
The packs differ in age and temperature. The voltage before the motors load a pack gives its charge
at the start. The voltage in the first seconds under load gives its resistance, relative to that of
the median pack.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import SteppedLoops
from pyomo_quad.collocation import compile as compile_model
from pyomo_quad.flight.baselines import declared_start
from pyomo_quad.identification.columns import CURRENT, FLIGHT, TIME, VOLTAGE
from pyomo_quad.identification.validation import folds
from pyomo_quad.model.battery import CHARGE_STATE, build_pack
from pyomo_quad.scenario import Scenario

#: Fitted fields of the battery, each with the name of its parameter in the model.
FITTED = {
    "E0": "battery.E0",
    "B": "battery.B",
    "cell_resistance": "battery.cell_resistance",
    "relaxation.resistance": "battery.relaxation_resistance",
    "relaxation.time_constant": "battery.relaxation_time_constant",
    "thermal.activation_energy": "battery.activation_energy",
}
#: Field that follows from the fitted E0, because the voltage of the full cell, E0 + A, is kept.
DEPENDENT, _DEPENDENT_PARAMETER = "A", "battery.A"
#: Column of `PackIdentification.flights`: state of charge at the end of the flight.
LEAST_CHARGE = "end_charge_percent"
_LOAD, _FACTOR = "power.load", "battery.resistance_factor"
_KEYS = tuple((f"battery.{name}", None) for name in ("voltage", "open_circuit_voltage"))
# Fraction of the flight's greatest power above which the pack counts as under load.
_LOADED = 0.25
# Time under load from which the resistance of a flight's pack is read, and rows before that, s.
_READ_S, _BEGIN_S = 10.0, 3.0
# Residual, V per cell, above which a row counts linearly instead of quadratically.
_LARGE_RESIDUAL_V = 0.05
# Least and greatest factor on the resistance of a flight's pack, and iterations that determine it.
_LEAST_FACTOR, _MOST_FACTOR, _READINGS = 0.2, 5.0, 4
# Least number of flights, and of a flight's rows after those that determine the resistance.
_FEWEST_FLIGHTS, _FEWEST_ROWS = 5, 20
# Number of points of the curve of open-circuit voltage over charge, from which a charge is found.
_CURVE = 400
# Initial guesses for a pack whose file gives no circuit: share of its resistance that acts slowly,
# time constant [s], and activation energy [J/mol].
_SLOW_SHARE, _TIME_CONSTANT_S, _ACTIVATION = 0.4, 15.0, 2e4
# Specific heat, J/kg/K, and energy, W h/kg, of lithium-polymer packs, for their heat capacity.
_SPECIFIC_HEAT, _SPECIFIC_ENERGY, _NOMINAL_V = 1000.0, 190.0, 3.8
_PER_CELL_MV = 1e3
# Resistance [ohm] and activation energy [J/mol] in place of 0, because logarithms are fitted.
_NEARLY_NONE = 1e-6
# Relative change of the sum of squares, and of the fields, at which a fit ends.
_FIT_TOLERANCE = 1e-3
# Shortest and longest time constant, in steps of the log and in s.
_FASTEST_STEPS, _SLOWEST_S = 1.0, 1000.0


@dataclass(frozen=True, kw_only=True)
class PackParameter:
    """Field of a battery, such as the resistance, with fitted value and standard deviation.

    Value and deviation are in the field's unit. The deviation is a jackknife estimate from the fits
    of the cross-validation. Each of these fits leaves out one group of flights.
    """

    name: str
    value: float
    deviation: float


@dataclass(frozen=True, kw_only=True)
class PackIdentification:
    """Battery identified from flights, with the errors of its computed voltages.

    An "unseen" flight was left out of the fit with which its voltage is computed.

    Attributes
    ----------
    scenario : Scenario
        Scenario with the fitted battery.
    parameters : tuple of PackParameter
        Fitted fields.
    flights : DataFrame
        For each unseen flight: charges `start_charge_percent` and `end_charge_percent`, resistance
        relative to the median pack (`resistance_factor`), and root mean square errors [mV per
        cell]. The error is `error_mV` with this resistance, and `unread_error_mV` with the
        resistance of the median pack.
    rows : DataFrame
        Cell voltages `measured_V` and `computed_V` of unseen flights over time [s].
    read_s : float
        End of the first seconds under load, in the time of `rows` [s].
    error_mV : float
        Root mean square error over all unseen flights [mV per cell], with the resistance of each
        flight's pack.
    error_unread_mV : float
        The same error, with the resistance of the median pack for every flight.
    base_error_mV : float
        Error of all flights with the battery before the fit.
    """

    scenario: Scenario
    parameters: tuple[PackParameter, ...]
    flights: pd.DataFrame
    rows: pd.DataFrame
    read_s: float
    error_mV: float
    error_unread_mV: float
    base_error_mV: float


class _Flown(NamedTuple):
    """Measured power [W] and cell voltage [V] of one flight, in time steps of equal length.

    `aloft` is the number of time steps until the end of the load.
    """

    name: object
    power: FloatArray
    voltage: FloatArray
    # Mean cell voltage [V] and mean power [W] before the load, or in the first row of a log that
    # begins under load.
    rest: tuple[float, float]
    aloft: int


class Record:
    """Measured powers and cell voltages of all flights, in time steps of equal length.

    The arrays `power` [W] and `voltage` [V per cell] have one row per time step and one column per
    flight, zero after its end. A flight begins at most 3 s before the motors load the pack. Flights
    that are too short or without load are left out.

    Parameters
    ----------
    frame : DataFrame
        Result of `read_voltages`.
    cells : int
        Cells in series.
    """

    def __init__(self, frame: pd.DataFrame, cells: int) -> None:
        steps = frame.groupby(FLIGHT, sort=False)[TIME].diff()
        self.step, self.cells = float(steps.median()), cells
        self.reading = round((_BEGIN_S + _READ_S) / self.step)
        read = (self._flight(one) for _, one in frame.groupby(FLIGHT, sort=False))
        flown = [one for one in read if one is not None]
        longest = max((len(one.power) for one in flown), default=0)
        self.names = [one.name for one in flown]
        self.power, self.voltage = np.zeros((2, longest, len(flown)))
        self.is_logged, self.is_aloft = np.zeros((2, longest, len(flown)), dtype=bool)
        self.rest = np.array([one.rest for one in flown])
        for k, one in enumerate(flown):
            rows = slice(0, len(one.power))
            self.power[rows, k], self.voltage[rows, k] = one.power, one.voltage
            self.is_logged[rows, k], self.is_aloft[: one.aloft, k] = True, True

    def _flight(self, rows: pd.DataFrame) -> _Flown | None:
        """Resample the log of one flight to time steps of equal length.

        The result is None if the flight has no load or is too short.
        """
        time = rows[TIME].to_numpy()
        even = np.arange(time[0], time[-1] + 0.5 * self.step, self.step)
        voltage = np.interp(even, time, rows[VOLTAGE].to_numpy()) / self.cells
        power = self.cells * voltage * np.interp(even, time, rows[CURRENT].to_numpy())
        loaded = np.flatnonzero(power > _LOADED * np.max(power, initial=0.0))
        if not len(loaded):
            return None
        first, last = int(loaded[0]), int(loaded[-1]) + 1
        # Each flight begins at most 3 s before the motors load the pack.
        begin = max(0, first - round(_BEGIN_S / self.step))
        if last - begin < self.reading + _FEWEST_ROWS:
            return None
        resting = slice(0, first) if first else slice(0, 1)
        return _Flown(
            name=rows[FLIGHT].iloc[0],
            power=power[begin:],
            voltage=voltage[begin:],
            rest=(float(voltage[resting].mean()), float(power[resting].mean())),
            aloft=last - begin,
        )

    @property
    def drawn(self) -> FloatArray:
        """Charge drawn by each flight [A h], shape (n_flights,)."""
        current = self.power / np.where(self.is_logged, self.cells * self.voltage, np.inf)
        return np.asarray(current.sum(axis=0) * self.step / 3600.0)

    def part(self, chosen: NDArray[np.int64]) -> "Record":
        """Return a new record with the chosen flights of this record.

        `chosen` holds the indices of the flights, from 0. The index of a flight is the index of its
        column in the record's arrays.
        """
        part = object.__new__(Record)
        part.step, part.reading, part.cells = self.step, self.reading, self.cells
        part.names = [self.names[k] for k in chosen]
        part.power, part.voltage = self.power[:, chosen], self.voltage[:, chosen]
        part.is_logged, part.is_aloft = self.is_logged[:, chosen], self.is_aloft[:, chosen]
        part.rest = self.rest[chosen]
        return part

    def after_reading(self, rows: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Select those of the time steps `rows` that follow the first seconds under load.

        Argument and result are boolean arrays, shape (n_times, n_flights).
        """
        # The voltages in the first seconds determine the resistance of the pack.
        return rows & (np.arange(len(self.power)) >= self.reading)[:, None]


class Circuit:
    """Simulation of the battery's equivalent circuit under the measured powers of flights.

    Each flight has its own charge at the start. The methods take `values`, the logarithms of the n
    fitted fields, which thus remain positive. `factor`, shape (n_flights,), multiplies the
    resistance of each flight's pack.

    Parameters
    ----------
    scenario : Scenario
        Scenario from the function `with_circuit`, whose battery has all fields of the circuit.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._dynamics = compile_model(build_pack(scenario)).dynamics()
        self._names = self._dynamics.state_names
        known = declared_start(scenario, self._dynamics)
        self._begun = np.array([known[name] for name in self._names])
        self._varied = (_LOAD, *FITTED.values(), _DEPENDENT_PARAMETER, _FACTOR)
        self._loops = SteppedLoops(
            self._dynamics, lambda *_: ((), ()), n_command=0, n_own=0, varied=self._varied
        )
        pack = scenario.battery
        self._cells = pack.cells_series
        self._full = pack.E0 + pack.A
        self._charges = np.linspace(0.0, 0.95, _CURVE) * pack.capacity * pack.cells_parallel
        self.start = np.log(_as_given(scenario))

    def numbers(self, values: FloatArray, factor: FloatArray) -> dict[str, FloatArray]:
        """Return the parameter values of the battery model by name, each of shape (n_flights,)."""
        told = dict(zip(FITTED.values(), np.exp(values).tolist(), strict=True))
        told[_DEPENDENT_PARAMETER] = self._full - told[FITTED["E0"]]
        return {name: np.full(len(factor), number) for name, number in told.items()} | {
            _FACTOR: factor
        }

    def voltages(
        self, record: Record, values: FloatArray, factor: FloatArray, count: int
    ) -> tuple[FloatArray, FloatArray]:
        """Simulate the cell voltages of all flights in the first `count` time steps.

        The results, shape (count, n_flights), are the voltage under load and the open-circuit
        voltage [V].
        """
        told = self.numbers(values, factor)
        start = np.tile(self._begun, (len(factor), 1))
        start[:, self._names.index(CHARGE_STATE)] = self.charge(record, values, factor)
        times = record.step * np.arange(count, dtype=float)
        flown = self._loops.fly(
            times,
            np.hstack([start, np.zeros((len(factor), 1))]),
            lambda _t: (),
            [record.power[: count - 1], *(told[name] for name in self._varied[1:])],
            sampled=np.ones(count, dtype=bool),
        )
        states = flown.joint[:, :, :-1].reshape(count * len(factor), -1)
        every = {name: np.tile(number, count) for name, number in told.items()}
        every[_LOAD] = record.power[:count].ravel()
        controls = np.zeros((len(states), 0))
        instants = self._dynamics.solved(np.repeat(times, len(factor)), states, controls, every)
        found = instants.table(_KEYS) / self._cells
        voltage, open_circuit = found.T.reshape(2, count, len(factor))
        return voltage, open_circuit

    def whole(self, record: Record, values: FloatArray, factor: FloatArray) -> FloatArray:
        """Simulate the cell voltage under load of all flights, shape (n_times, n_flights) [V]."""
        return self.voltages(record, values, factor, len(record.power))[0]

    def charge(self, record: Record, values: FloatArray, factor: FloatArray) -> FloatArray:
        """Return the charge that is missing from the pack at the start of each flight [A h].

        The missing charge follows from the open-circuit voltage at the start. It is limited to 0 to
        95 % of the capacity. See docs/theory/identification.md, eq. (7).
        """
        # Voltage and power before the motors load the pack, or of the first row of the record.
        voltage, power = record.rest.T
        told = {name: number[:1] for name, number in self.numbers(values, factor).items()}
        states = np.tile(self._begun, (_CURVE, 1))
        states[:, self._names.index(CHARGE_STATE)] = self._charges
        every = {name: np.full(_CURVE, number[0]) for name, number in told.items()}
        every[_LOAD] = np.zeros(_CURVE)
        instants = self._dynamics.solved(np.zeros(_CURVE), states, np.zeros((_CURVE, 0)), every)
        curve = instants.table(_KEYS[1:])[:, 0] / self._cells
        slow, fast = (told[FITTED[n]] for n in ("relaxation.resistance", "cell_resistance"))
        # A flight that begins under load is taken to have been under this load for long, so that
        # the slow part of the resistance counts in full.
        current = power / (self._cells * voltage)
        at_rest = voltage + factor * (fast + slow) * current
        return np.interp(-at_rest, -curve, self._charges)

    def factors(self, record: Record, values: FloatArray) -> FloatArray:
        """Determine the factor on each pack's resistance from the first seconds under load.

        With the factor, which is limited to 0.2 to 5, the mean computed voltage in these seconds
        equals the mean measured voltage.
        """
        factor = np.ones(len(record.names))
        for _ in range(_READINGS):
            computed, open_circuit = self.voltages(record, values, factor, record.reading)
            measured = record.voltage[: record.reading]
            late = slice(round(_BEGIN_S / record.step), None)
            drop = (open_circuit - computed)[late].mean(axis=0)
            lacking = (computed - measured)[late].mean(axis=0)
            factor = np.clip(factor * (1.0 + lacking / drop), _LEAST_FACTOR, _MOST_FACTOR)
        return factor

    def residuals(self, record: Record, values: FloatArray) -> FloatArray:
        """Return computed minus measured cell voltage [V] of all flights, as one vector.

        The first seconds under load are left out, because they determine the factors on the
        resistance.
        """
        factor = self.factors(record, values)
        computed = self.whole(record, values, factor)
        return (computed - record.voltage)[record.after_reading(record.is_logged)]

    def fit(self, record: Record, start: FloatArray) -> FloatArray:
        """Return the logarithms of the fields fitted to the measured voltages, shape (n,).

        The iteration starts from `start`, which has the form of `values`. The fitted resistances
        are those of the median pack: the results of the method `factors` have the median 1.
        """
        low, high = np.full(len(start), -np.inf), np.full(len(start), np.inf)
        place = list(FITTED).index("relaxation.time_constant")
        low[place], high[place] = np.log([_FASTEST_STEPS * record.step, _SLOWEST_S])
        found = least_squares(
            lambda values: self.residuals(record, values),
            start,
            bounds=(low, high),
            loss="soft_l1",
            f_scale=_LARGE_RESIDUAL_V,
            diff_step=1e-4,
            xtol=_FIT_TOLERANCE,
            ftol=_FIT_TOLERANCE,
        )
        values = np.array(found.x)
        middling = float(np.log(np.median(self.factors(record, values))))
        for name in ("cell_resistance", "relaxation.resistance"):
            values[list(FITTED).index(name)] += middling
        return values


def identify_pack(scenario: Scenario, frame: pd.DataFrame) -> PackIdentification | None:
    """Fit a battery's equivalent circuit to the voltages of flights, and assess the fit.

    `frame` comes from `read_voltages`. The voltage of the full cell, the polarisation voltage K and
    the capacity are not fitted. The result is None if fewer than five flights are long enough. A
    flight is long enough if it has at least 13 s plus 20 time steps, from at most 3 s before the
    load to the end of the load.
    """
    if frame.empty:
        return None
    told = with_circuit(scenario)
    record = Record(frame, told.battery.cells_series)
    count = len(record.names)
    if count < _FEWEST_FLIGHTS:
        return None
    circuit = Circuit(told)
    values = circuit.fit(record, circuit.start)
    computed, unread = np.zeros((2, *record.power.shape))
    factor, charge, middling = np.zeros((3, count))
    left_out = []
    for fold in folds(pd.DataFrame({FLIGHT: np.arange(count)})):
        tried = np.sort(fold.astype(np.int64))
        own = circuit.fit(record.part(np.setdiff1d(np.arange(count), tried)), values)
        left_out.append(np.exp(own))
        # The factors of each fit refer to the median pack of its own flights; this ratio converts
        # them to the median pack of all flights.
        middling[tried] = _resistance(own) / _resistance(values)
        unseen = record.part(tried)
        factor[tried] = circuit.factors(unseen, own)
        charge[tried] = circuit.charge(unseen, own, factor[tried])
        computed[:, tried] = circuit.whole(unseen, own, factor[tried])
        unread[:, tried] = circuit.whole(unseen, own, np.ones(len(tried)))
    base = circuit.whole(record, np.log(_as_given(scenario)), np.ones(count))
    spread = np.array(left_out)
    deviations = np.sqrt((len(spread) - 1) * spread.var(axis=0))
    size = told.battery.capacity * told.battery.cells_parallel
    fitted = dict(zip(FITTED, np.exp(values).tolist(), strict=True))
    return PackIdentification(
        scenario=_with_fitted(told, fitted),
        parameters=tuple(
            PackParameter(name=name, value=value, deviation=float(deviation))
            for (name, value), deviation in zip(fitted.items(), deviations, strict=True)
        ),
        flights=pd.DataFrame(
            {
                FLIGHT: record.names,
                "start_charge_percent": 100.0 * (1.0 - charge / size),
                LEAST_CHARGE: 100.0 * (1.0 - (charge + record.drawn) / size),
                "resistance_factor": factor * middling,
                "error_mV": _error_per_cell(record, computed, axis=0),
                "unread_error_mV": _error_per_cell(record, unread, axis=0),
            }
        ),
        rows=_rows(record, computed),
        read_s=record.step * record.reading,
        error_mV=float(_error_per_cell(record, computed)),
        error_unread_mV=float(_error_per_cell(record, unread)),
        base_error_mV=float(_error_per_cell(record, base)),
    )


def _resistance(values: FloatArray) -> float:
    """Return the total resistance of a cell after a long time under load [ohm].

    It is the sum of cell and relaxation resistance. `values` are the logarithms of the fitted
    battery fields, in the order of `FITTED`.
    """
    names = list(FITTED)
    parts = ("cell_resistance", "relaxation.resistance")
    return float(sum(np.exp(values[names.index(name)]) for name in parts))


def with_circuit(scenario: Scenario) -> Scenario:
    """Complete the scenario's battery to an equivalent circuit, with guesses for missing fields.

    If the battery has no table `relaxation`, 40 % of the cell resistance becomes the relaxation
    resistance. The state of health is always replaced by that of a new pack.
    """
    pack = scenario.battery
    tables: dict[str, Any] = {}
    if pack.relaxation is None:
        tables["battery.relaxation"] = {
            "resistance": _SLOW_SHARE * pack.cell_resistance,
            "time_constant": _TIME_CONSTANT_S,
        }
        tables["battery.cell_resistance"] = (1.0 - _SLOW_SHARE) * pack.cell_resistance
    thermal = {} if pack.thermal is None else pack.thermal.model_dump()
    if not thermal:
        mass = pack.capacity * _NOMINAL_V / _SPECIFIC_ENERGY
        thermal["heat_capacity"] = _SPECIFIC_HEAT * mass
    if not thermal.get("activation_energy"):
        thermal["activation_energy"] = _ACTIVATION
    tables["battery.thermal"] = {k: v for k, v in thermal.items() if v is not None}
    tables["battery.health"] = {"resistance_factor": 1.0}
    return scenario.with_values(tables)


def _as_given(scenario: Scenario) -> list[float]:
    """Return the initial values of the fitted battery fields, in the order of `FITTED`.

    Without a relaxation table, its resistance is 1e-6 ohm and its time constant 1 s. An activation
    energy that is missing or zero becomes 1e-6 J/mol.
    """
    # All values are positive, because the fit takes logarithms.
    pack = scenario.battery
    slow = (_NEARLY_NONE, 1.0)
    if pack.relaxation is not None:
        slow = (pack.relaxation.resistance, pack.relaxation.time_constant)
    activation = 0.0 if pack.thermal is None else pack.thermal.activation_energy
    return [pack.E0, pack.B, pack.cell_resistance, *slow, max(activation, _NEARLY_NONE)]


def _with_fitted(scenario: Scenario, fitted: dict[str, float]) -> Scenario:
    pack = scenario.battery
    values = {f"battery.{name}": value for name, value in fitted.items()}
    values[f"battery.{DEPENDENT}"] = pack.E0 + pack.A - fitted["E0"]
    return scenario.with_values(values)


def _error_per_cell(record: Record, computed: FloatArray, axis: int | None = None) -> Any:  # noqa: ANN401
    """Return the root mean square error of computed voltages in flight [mV per cell].

    With `axis` 0, the result has one error per flight, otherwise it is one error over all flights.
    """
    # Without the first seconds under load, which determine the resistance of the pack.
    counted = record.after_reading(record.is_aloft)
    squares = np.where(counted, (computed - record.voltage) ** 2, 0.0)
    return _PER_CELL_MV * np.sqrt(squares.sum(axis) / counted.sum(axis))


def _rows(record: Record, computed: FloatArray) -> pd.DataFrame:
    """Return measured and computed cell voltage [V] over time in one table, flight by flight.

    `computed` has shape (n_times, n_flights). Times after the end of a flight's log are left out.
    """
    flights = np.broadcast_to(np.array(record.names, dtype=object), record.power.shape)
    times = np.broadcast_to(record.step * np.arange(len(computed))[:, None], record.power.shape)
    kept = record.is_logged.T
    return pd.DataFrame(
        {
            FLIGHT: flights.T[kept],
            TIME: times.T[kept],
            "measured_V": record.voltage.T[kept],
            "computed_V": computed.T[kept],
        }
    )
