"""A pack identified from voltages that the plain writing of a circuit made."""

import tomllib

import numpy as np
import pandas as pd
import pytest

from pyomo_quad.cli import main
from pyomo_quad.identification.figures import draw_voltages
from pyomo_quad.identification.fitting import identify
from pyomo_quad.identification.logs import read_logs, read_voltages
from pyomo_quad.identification.motion import vehicle_scenario
from pyomo_quad.identification.pack import (
    FITTED,
    Circuit,
    Record,
    identify_pack,
    with_circuit,
)
from pyomo_quad.scenario import load_scenario
from tests.unit.identification import recorded

FLIGHTS, SECONDS, REST = 5, 90, 6
CELL = {"E0": 3.25, "B": 0.23, "full": 4.3244, "K": 0.0222, "capacity": 5.7}
CIRCUIT = {"fast": 0.009, "slow": 0.004, "tau": 12.0, "activation": 2e4, "heat": 115.0}
AGES = (0.8, 1.0, 1.0, 1.25, 1.6)
CHARGES = 0.3 + 0.35 * np.arange(1, FLIGHTS + 1)


def open_circuit(charge):
    share = 1 - charge / CELL["capacity"]
    rise = CELL["full"] + CELL["K"] - CELL["E0"]
    return CELL["E0"] - CELL["K"] / share + rise * np.exp(-CELL["B"] * charge)


def voltages(power, charge, age, substeps=8):
    """Voltage and current of a cell under the power of each second, by small explicit steps."""
    slow, temperature, found = 0.0, 298.15, []
    for demand in power:
        for k in range(substeps):
            share = age * np.exp(
                CIRCUIT["activation"] / 8.314462618 * (1 / temperature - 1 / 298.15)
            )
            source, fast = open_circuit(charge) - slow, share * CIRCUIT["fast"]
            current = (source - np.sqrt(source**2 - 4 * fast * demand)) / (2 * fast)
            voltage = source - fast * current
            if k == 0:
                found.append((voltage, current))
            step = 1.0 / substeps
            heat = (open_circuit(charge) - voltage) * current
            slow += step * (share * CIRCUIT["slow"] * current - slow) / CIRCUIT["tau"]
            temperature += step * heat / CIRCUIT["heat"]
            charge += step * current / 3600
    return np.array(found).T


def log():
    """Flights of a made-up vehicle, with rest on the ground before and after each."""
    parts = []
    for number, age in enumerate(AGES, start=1):
        flown = recorded.flight(number, 4.0 + number, 0.1 * number, seconds=SECONDS)
        ground = flown.iloc[:REST].assign(phase=0, power_W=0.0)
        after = flown.iloc[: 4 * REST].assign(phase=0, power_W=0.0)
        whole = pd.concat([ground, flown, after], ignore_index=True)
        whole["time_s"] = np.arange(len(whole), dtype=float)
        voltage, current = voltages(whole["power_W"] / 6, CHARGES[number - 1], age)
        parts.append(whole.assign(voltage_V=6 * voltage, current_A=current))
    return pd.concat(parts, ignore_index=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pack")
    log().to_parquet(folder / "flights.parquet")
    (folder / "craft.toml").write_text(recorded.VEHICLE, encoding="utf-8")
    return folder


def base(folder, **more):
    """The made-up vehicle on a base pack whose curve ends where the planted one does."""
    rise = CELL["full"] + CELL["K"] - 3.3
    pack = {"E0": 3.3, "A": rise, "K": CELL["K"], "B": 0.2, "cell_resistance": 0.012}
    pack |= {
        "relaxation": None,
        "thermal": {"heat_capacity": CIRCUIT["heat"], "cooling": 0.0},
    } | more
    craft = vehicle_scenario(str(folder / "craft.toml"))
    return craft.with_values({f"battery.{name}": value for name, value in pack.items()})


def voltages_of(folder):
    file = folder / "flights.parquet"
    return read_voltages(file, read_logs(file))


def test_charge_and_age_are_read_before_and_under_the_first_load(folder):
    circuit = Circuit(with_circuit(base(folder)))
    record = Record(voltages_of(folder), 6)
    planted = {
        "E0": CELL["E0"],
        "B": CELL["B"],
        "cell_resistance": CIRCUIT["fast"],
        "relaxation.resistance": CIRCUIT["slow"],
        "relaxation.time_constant": CIRCUIT["tau"],
        "thermal.activation_energy": CIRCUIT["activation"],
    }
    values = np.log([planted[name] for name in FITTED])
    factor = circuit.factors(record, values)
    np.testing.assert_allclose(factor, AGES, rtol=2e-3)
    np.testing.assert_allclose(circuit.charge(record, values, factor), CHARGES, atol=0.01)
    off = (circuit.whole(record, values, factor) - record.voltage)[record.is_logged]
    assert np.abs(off).max() < 2e-3


@pytest.mark.slow
def test_the_planted_circuit_comes_back_on_flights_unseen(folder):
    found = identify_pack(base(folder), voltages_of(folder))
    assert found.error_mV < 1.0
    assert found.error_mV < 0.1 * min(found.error_unread_mV, found.base_error_mV)
    values = {one.name: one.value for one in found.parameters}
    assert values["cell_resistance"] == pytest.approx(CIRCUIT["fast"], rel=0.05)
    assert values["relaxation.resistance"] == pytest.approx(CIRCUIT["slow"], rel=0.1)
    assert values["relaxation.time_constant"] == pytest.approx(CIRCUIT["tau"], rel=0.15)
    assert values["thermal.activation_energy"] == pytest.approx(CIRCUIT["activation"], rel=0.2)
    np.testing.assert_allclose(found.flights["resistance_factor"], AGES, rtol=0.03)
    starts = 100 * (1 - CHARGES / CELL["capacity"])
    np.testing.assert_allclose(found.flights["start_charge_percent"], starts, atol=0.5)
    identified = identify(base(folder), read_logs(folder / "flights.parquet"))
    left, right = draw_voltages(identified, found).axes
    assert len(left.get_lines()) > 2
    np.testing.assert_allclose(np.sort(right.get_lines()[0].get_xdata()), AGES, rtol=0.03)


@pytest.mark.slow
def test_identify_writes_the_pack_that_its_vehicle_flies_with(folder, capsys):
    out = folder / "identified"
    asked = ["--base", str(folder / "craft.toml"), "--out", str(out), "--figures", "none"]
    assert main(["identify", str(folder / "flights.parquet"), *asked]) == 0
    assert "pack, cross-validated by flight:" in capsys.readouterr().out
    pack = tomllib.loads((out / "pack.toml").read_text(encoding="utf-8"))["fields"]
    assert "identified from the voltages of 5 flights" in pack["cell_resistance"]["source"]
    report = (out / "report.md").read_text(encoding="utf-8")
    assert "## The pack" in report
    assert len(pd.read_csv(out / "voltages.csv")) == FLIGHTS
    mission = out / "flown.toml"
    mission.write_text(
        'name = "flown"\nvehicle = { use = "vehicle.toml" }\nwind = { coupling = "drag" }\n'
        'power = { model = "momentum" }\n'
        "mission = { goal = { position = [5, 0, 0] }, duration = 5 }\n",
        encoding="utf-8",
    )
    battery = load_scenario(mission).battery
    assert battery.cell_resistance == pytest.approx(pack["cell_resistance"]["value"])
    assert battery.relaxation.time_constant == pack["relaxation"]["time_constant"]["value"]
