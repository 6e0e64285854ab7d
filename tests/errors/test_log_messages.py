"""Every message about a log of flights: one line, and nothing is written."""

import struct
import sys

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.identification import logs
from tests.unit.identification import recorded


def three():
    return pd.concat([recorded.flight(k, 5.0, 0.0, seconds=30) for k in (1, 2, 3)])


def with_value(column, value, row=15):
    frame = three()
    frame.iloc[row, frame.columns.get_loc(column)] = value
    return frame


def in_watts(frame):
    return frame.assign(voltage_V=22.0, current_A=frame["power_W"] / 22.0)


SPOILT = {
    "no_density": (
        lambda: three().drop(columns="air_density_kg_m3"),
        (
            "has no column air_density_kg_m3 (density of the air, in kg/m^3); name it "
            "air_density_kg_m3 or air_density."
        ),
    ),
    "no_power": (
        lambda: three().drop(columns="power_W"),
        (
            "has no column power_W (power drawn from the pack, in W); name it power_W or power or "
            "voltage_V with current_A."
        ),
    ),
    "nan": (
        lambda: with_value("vel_up_m_s", np.nan),
        "vel_up_m_s is not a number at 15 s of flight 1; drop the row or fill it.",
    ),
    "text": (
        lambda: three().astype({"power_W": str}).assign(power_W="much"),
        "column power_W holds text; it must hold numbers.",
    ),
    "back": (
        lambda: with_value("time_s", 3.5),
        "time_s of flight 1 goes from 14 to 3.5 s; times must rise within a flight.",
    ),
    "gap": (
        lambda: three().assign(time_s=lambda f: f.time_s + 60.0 * (f.time_s > 15)),
        (
            "flight 1 has a gap of 61 s after 15 s; steps must be <= 10 s: fill the gap, or split "
            "the flight there."
        ),
    ),
    "no_phase": (
        lambda: with_value("phase", np.nan),
        "phase is not a number at 15 s of flight 1; drop the row or fill it.",
    ),
    "milliseconds": (
        lambda: three().assign(time_s=lambda f: 1e3 * f.time_s),
        (
            "time_s of flight 1 rises by 1000 s a row, which must be milliseconds; divide it by "
            "1000."
        ),
    ),
    "nothing_drawn": (
        lambda: three().assign(power_W=lambda f: f.power_W * (f.flight != 2) - 3.0),
        (
            "power_W of flight 2 has a median of -3 W; must be positive in flight: is the current "
            "logged?"
        ),
    ),
    "kilowatts": (
        lambda: three().assign(power_W=lambda f: 1e-3 * f["power_W"]),
        "which must be kilowatts; multiply it by 1000.",
    ),
    "negative": (
        lambda: with_value("power_W", -480.0),
        (
            "power_W = -480 W at 15 s of flight 1; must be positive in flight: turn the current's "
            "sign."
        ),
    ),
    "milliwatts": (
        lambda: three().assign(power_W=lambda f: 1e3 * f["power_W"]),
        "which must be milliwatts; divide it by 1000.",
    ),
    "millivolts": (
        lambda: in_watts(three()).assign(voltage_V=22e3),
        "voltage_V has a median of 2.2e+04, which must be millivolts; divide it by 1000.",
    ),
    "one_flight": (
        lambda: recorded.flight(1, 5.0, 0.0, seconds=30),
        "one flight only; identification needs at least two",
    ),
    "single_row": (
        lambda: pd.concat([three(), recorded.flight(4, 5.0, 0.0, seconds=30).head(1)]),
        "flight 4 has a single row; drop it.",
    ),
    "no_air": (
        lambda: with_value("air_density_kg_m3", 0.0),
        "air_density_kg_m3 must be > 0 and payload_kg >= 0.",
    ),
    "centimetres": (
        lambda: three().assign(vel_north_m_s=lambda f: 100.0 * f.vel_north_m_s),
        "of this vehicle give the acceleration at 10 s of flight 1; look at the velocities there.",
    ),
    "no_such_air": (
        lambda: with_value("air_density_kg_m3", 12.0),
        (
            "air_density_kg_m3 = 12 kg/m^3 at 15 s of flight 1; must be from 0.01 to 2: air has "
            "about 1.5 at most"
        ),
    ),
    "no_such_speed": (
        lambda: with_value("air_vel_east_m_s", -1e200),
        "air_vel_east_m_s = -1e+200 m/s at 15 s of flight 1; must be from -1000 to 1000",
    ),
    "no_such_power": (
        lambda: with_value("power_W", 1e12),
        "power_W = 1e+12 W at 15 s of flight 1; must be from -1e+08 to 1e+08: the largest",
    ),
    "no_such_payload": (
        lambda: three().assign(payload_kg=1e30),
        "payload_kg = 1e+30 kg at 0 s of flight 1; must be from 0 to 10000: multirotors weigh",
    ),
    "grams": (
        lambda: three().assign(payload_kg=lambda f: 500.0 * (f.flight == 2)),
        (
            "flight 2: payload_kg has a median of 500 kg for a vehicle of 3.715 kg, which must be "
            "grams; divide it by 1000."
        ),
    ),
    "one_in_milliwatts": (
        lambda: three().assign(power_W=lambda f: f.power_W * np.where(f.flight == 3, 1e3, 1.0)),
        ("log.csv: flight 3: power_W has a median of ", "must be milliwatts; divide it by 1000."),
    ),
    "one_in_kilowatts": (
        lambda: three().assign(power_W=lambda f: f.power_W * np.where(f.flight == 3, 1e-3, 1.0)),
        ("log.csv: flight 3: power_W has a median of ", "must be kilowatts; multiply it by 1000."),
    ),
    "one_in_millivolts": (
        lambda: in_watts(three()).assign(voltage_V=lambda f: np.where(f.flight == 2, 22e3, 22.0)),
        "flight 2: voltage_V has a median of 2.2e+04, which must be millivolts; divide it by 1000.",
    ),
    "one_in_milliamperes": (
        lambda: in_watts(three()).assign(current_A=lambda f: np.where(f.flight == 2, 2e4, 20.0)),
        "flight 2: current_A has a median of 2e+04, which must be milliamperes; divide it by 1000.",
    ),
    "long_name": (
        lambda: three().assign(flight=lambda f: f.flight.map(lambda k: f"{k}" * 1000)),
        "flight has a name of 1000 letters; must have at most 200.",
    ),
    "on_ground": (
        lambda: three().assign(phase=0),
        "no row flies; phase must be 1, 2 or 3 for take-off, cruise and landing.",
    ),
}


def refused(capsys, file, *options, vehicle="dji_matrice_100"):
    out = file.parent / "out"
    arguments = ["identify", str(file), "--base", vehicle, "--out", str(out), *options]
    assert main(arguments) == ExitCode.BAD_INPUT
    told = capsys.readouterr()
    assert told.out == ""
    assert not out.exists()
    (line,) = told.err.splitlines()
    return line


@pytest.mark.lengthy
@pytest.mark.parametrize("name", SPOILT)
def test_a_spoilt_log(tmp_path, capsys, name):
    frame, message = SPOILT[name]
    file = tmp_path / "log.csv"
    frame().to_csv(file, index=False)
    line = refused(capsys, file)
    for part in (message,) if isinstance(message, str) else message:
        assert part in line


def test_files_that_are_no_logs(tmp_path, capsys, monkeypatch):
    assert "cannot be read (No such file" in refused(capsys, tmp_path / "none.csv")
    other = tmp_path / "log.xlsx"
    other.write_text("x")
    said = refused(capsys, other)
    assert "is not a log; give a .parquet, .csv, PX4 .ulg or ArduPilot .BIN file." in said
    assert "Of a log the columns are flight, time_s (s), phase" in said
    whole = tmp_path / "whole.parquet"
    three().to_parquet(whole)
    half = tmp_path / "half.parquet"
    half.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    assert "is damaged or cut short; copy it anew." in refused(capsys, half)
    vast = tmp_path / "vast.parquet"
    # Three million rows of one value, in a few kilobytes.
    pd.DataFrame({"power_W": np.zeros(3_000_000, np.int8)}).to_parquet(vast)
    assert "has 3000000 rows; must be <= 2000000: split it." in refused(capsys, vast)
    cut = tmp_path / "cut.csv"
    cut.write_text(three().to_csv(index=False)[:-3])
    assert "ends within a line; copy it anew, or end its last line." in refused(capsys, cut)
    empty = tmp_path / "empty.csv"
    empty.write_text("")
    assert "is damaged or cut short; copy it anew." in refused(capsys, empty)
    monkeypatch.setattr(logs, "_LARGEST_FILE_BYTES", 100)
    assert "whole.parquet: larger than 100 bytes; split it." in refused(capsys, whole)


def footer_of(file):
    """Return what comes before a Parquet file's description, that, and what comes after."""
    content = file.read_bytes()
    (length,) = struct.unpack("<I", content[-8:-4])
    return content[: -8 - length], content[-8 - length : -8], content[-8:]


def varint(number, size=1):
    """Return a number as Parquet writes it, over so many bytes at least."""
    groups = []
    while number or len(groups) < size:
        groups.append(number & 0x7F)
        number >>= 7
    return bytes([*(group | 0x80 for group in groups[:-1]), groups[-1]])


def test_a_parquet_file_whose_description_lies(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(logs, "_MOST_ROWS", 5000)
    file = tmp_path / "forged.parquet"
    rows = pd.concat([three()] * 100)
    rows.iloc[:6000].to_parquet(file, row_group_size=1000)
    before, footer, after = footer_of(file)
    said = varint(2 * 6000)  # zigzag
    assert footer.count(said) == 1
    file.write_bytes(before + footer.replace(said, varint(2 * 1000, len(said))) + after)
    assert "has 6000 rows; must be <= 5000: split it." in refused(capsys, file)
    rows.iloc[:6000].to_csv(tmp_path / "long.csv", index=False)
    assert "has 5001 rows; must be <= 5000: split it." in refused(capsys, tmp_path / "long.csv")


def test_columns_that_nobody_needs_are_not_read(tmp_path):
    file = tmp_path / "wide.parquet"
    texts = np.array([f"needless {k}" for k in range(90)])
    three().assign(needless=texts).to_parquet(file, compression=None)
    content = file.read_bytes()
    assert b"needless 44" in content
    # Its pages are rubbish now: whoever reads them finds the file damaged.
    for k in range(90):
        length = struct.pack("<I", len(texts[k]))
        content = content.replace(length + texts[k].encode(), b"\xff" * (4 + len(texts[k])))
    file.write_bytes(content)
    with pytest.raises(OSError, match=r"."):
        pd.read_parquet(file, columns=["needless"])
    assert len(logs.read_logs(file)) == 90
    wide = three().assign(**{f"needless_{k}": "text" for k in range(50)})
    wide.to_csv(tmp_path / "wide.csv", index=False)
    assert len(logs.read_logs(tmp_path / "wide.csv")) == 90


def test_a_text_of_a_parquet_file_is_bounded(tmp_path, capsys, monkeypatch):
    file = tmp_path / "named.parquet"
    three().assign(flight=lambda f: f.flight.map(lambda k: f"{k}" * 100_000)).to_parquet(file)
    assert file.stat().st_size < 100_000
    line = refused(capsys, file)
    assert "flight has a name of 100000 letters; must have at most 200." in line
    named = three().assign(flight=lambda f: "flight " + f.flight.astype(str))
    named.assign(flight=lambda f: f.flight.astype("category")).to_parquet(file)
    assert logs.read_logs(file)["flight"].unique().tolist() == ["flight 1", "flight 2", "flight 3"]
    pd.concat([three()] * 200).to_parquet(file, compression="zstd")
    monkeypatch.setattr(logs, "_LARGEST_FILE_BYTES", file.stat().st_size)
    assert "unpacks to more than" in refused(capsys, file)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"flight": [[1]] * 90}, "column flight holds list<element: int64>; it must hold numbers"),
        ({"flight": [{"a": 1}] * 90}, "column flight holds struct<a: int64>; it must hold numbers"),
        ({"power_W": [[1.0]] * 90}, "column power_W holds list<element: double>; it must hold num"),
        ({"power_W": ["much"] * 90}, "column power_W holds text; it must hold numbers."),
        ({"time_s": pd.date_range("2026", periods=90)}, "column time_s holds timestamp["),
    ],
)
def test_a_column_of_another_kind(tmp_path, capsys, columns, said):
    file = tmp_path / "log.parquet"
    three().assign(**columns).to_parquet(file)
    assert said in refused(capsys, file)


def test_an_empty_parquet_file_and_one_wide_line(tmp_path, capsys):
    file = tmp_path / "empty.parquet"
    three().head(0).to_parquet(file)
    assert "no row flies; phase must be 1, 2 or 3" in refused(capsys, file)
    wide = tmp_path / "wide.csv"
    wide.write_text("x," * 600_000 + "y\n")
    assert "has a first line above 1000000 bytes; split it." in refused(capsys, wide)


def test_too_little_memory_is_no_damage(tmp_path, capsys, monkeypatch):
    def unpack(_file):
        raise pa.ArrowMemoryError("malloc of size 12000000000 failed")

    monkeypatch.setattr(logs, "_read_parquet", unpack)
    file = tmp_path / "log.parquet"
    three().to_parquet(file)
    arguments = ["predict", str(file), "--vehicle", "dji_matrice_100", "--out", str(tmp_path / "o")]
    with pytest.raises(MemoryError):
        logs.read_logs(file)
    assert main(arguments) == ExitCode.FAULT
    assert "damaged" not in capsys.readouterr().err


def test_the_same_flights_under_two_names_count_once(tmp_path, capsys):
    file, copy = tmp_path / "log.parquet", tmp_path / "copy.csv"
    three().to_parquet(file)
    renamed = three().assign(flight=lambda f: f.flight + 10, time_s=f_later)
    renamed.to_csv(copy, index=False, float_format="%.15g")
    alone, both = (
        ["predict", *map(str, files), "--vehicle", "dji_matrice_100", "--out", str(tmp_path / "o")]
        for files in ((file,), (file, copy))
    )
    assert main(alone) == ExitCode.VERIFIED
    said = capsys.readouterr()
    assert ("3 flights" in said.out, said.err) == (True, "")
    assert main(both) == ExitCode.VERIFIED
    again = capsys.readouterr()
    assert again.out == said.out
    assert again.err.splitlines() == [
        f"logs: flight {k + 10} duplicates flight {k}; it counts once." for k in (1, 2, 3)
    ]


def f_later(frame):
    return frame.time_s + 3600.0


def test_other_labels_than_value_and_source_in_a_vehicle_file(tmp_path, capsys):
    file, vehicle = tmp_path / "log.csv", tmp_path / "own.toml"
    three().to_csv(file, index=False)
    for written, said in {
        'mass = { value = 3.0, source = "x", scale = 2.0 }': (
            "own.toml: unknown key fields.mass.scale; a number stands alone or as a table of its "
            "value and source."
        ),
        "mass = { value = 3.0, deep = { value = 1.0 } }": "unknown key fields.mass.deep; a number",
        "value = 3.0": "own.toml: unknown key fields.value; a number stands alone or as a table",
        "mass = { value = { value = 3.0 } }": "fields.mass.value = a table; must be a number or a",
        "mass = { source = 3 }": "own.toml: fields.mass.source = 3; must be text in quotes.",
    }.items():
        vehicle.write_text(f'use = "dji_matrice_100"\n[fields]\n{written}\n')
        assert said in refused(capsys, file, vehicle=str(vehicle))


def test_a_flight_that_is_given_twice(tmp_path, capsys):
    file = tmp_path / "log.csv"
    three().to_csv(file, index=False)
    line = refused(capsys, file, str(file))
    assert line == (
        "logs: flight log 1 is given twice; give each log once, under a name of its own."
    )


def test_options_that_do_not_fit(tmp_path, capsys):
    file = tmp_path / "log.csv"
    three().to_csv(file, index=False)
    line = refused(capsys, file, vehicle="dji_matrice")
    assert "did you mean dji_matrice_100?" in line
    line = refused(capsys, file, "--fit", "mass")
    assert line.startswith("--fit mass: must be one of profile_power_coefficient,")
    listed = tmp_path / "list.csv"
    listed.write_text("flight\n1\n")
    assert "needs the columns flight and split." in refused(capsys, file, "--flights", str(listed))
    listed.write_text("flight,split\n9,fit\n")
    assert "no flight of the log has split = fit." in refused(
        capsys, file, "--flights", str(listed)
    )
    line = refused(capsys, file, "--flights", str(tmp_path / "none.csv"))
    assert "none.csv: cannot be read; give a CSV of flights." in line


def ulog(messages):
    """Bytes of a PX4 log with topics of doubles: name -> (fields, rows of timestamp and values)."""

    def packed(kind, payload):
        return struct.pack("<HB", len(payload), ord(kind)) + payload

    log = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + packed("B", bytes(40))
    for name, (fields, _) in messages.items():
        columns = "uint64_t timestamp;" + "".join(f"double {field};" for field in fields)
        log += packed("F", f"{name}:{columns}".encode())
    for number, name in enumerate(messages):
        log += packed("A", struct.pack("<BH", 0, number) + name.encode())
    for number, (_, rows) in enumerate(messages.values()):
        for microseconds, *values in rows:
            row = struct.pack(f"<HQ{len(values)}d", number, int(microseconds), *values)
            log += packed("D", row)
    return log


FLOWN = {
    "vehicle_local_position": {"vx": 5.0, "vy": 1.0, "vz": 0.5},
    "battery_status": {"voltage_v": 22.0, "current_a": 20.0},
    "wind": {"windspeed_north": 2.0, "windspeed_east": 0.0},
    "vehicle_land_detected": {"landed": 0.0},
}


def flown_ulog(current=20.0, without=()):
    times = range(0, 30_000_000, 200_000)
    topics = {
        topic: {name: value for name, value in fields.items() if name not in without}
        for topic, fields in FLOWN.items()
    }
    if "current_a" not in without:
        topics["battery_status"]["current_a"] = current
    return ulog(
        {
            topic: (tuple(fields), [(t, *fields.values()) for t in times])
            for topic, fields in topics.items()
            if topic not in without
        }
    )


def test_px4_logs(tmp_path, capsys, monkeypatch):
    good = tmp_path / "good.ulg"
    good.write_bytes(flown_ulog(20.0))
    frame = logs.read_logs(good)
    assert len(frame) == 30
    expected = {"power_W": 440.0, "vel_north_m_s": 5.0, "vel_up_m_s": -0.5}
    expected |= {"air_vel_north_m_s": 3.0, "air_vel_east_m_s": 1.0, "phase": 2}
    for name, value in expected.items():
        np.testing.assert_allclose(frame[name], value)
    # One flight a file; several files are several flights.
    assert "logs: one flight only" in refused(capsys, good)
    again = tmp_path / "again.ulg"
    again.write_bytes(flown_ulog(21.0))
    both = logs.together([(good, frame), (again, logs.read_logs(again))])
    assert both["flight"].unique().tolist() == ["good", "again"]
    without = tmp_path / "without.ulg"
    without.write_bytes(flown_ulog(-1.0))
    assert "battery_status has no current; fit a power module and log it." in refused(
        capsys, without
    )
    for field, line in {
        "voltage_v": "battery_status has no voltage_v or voltage_filtered_v; log it.",
        "vz": "vehicle_local_position has no vz; log it.",
        "windspeed_east": "wind has no windspeed_east; log it.",
        "landed": "vehicle_land_detected has no landed; log it.",
    }.items():
        without.write_bytes(flown_ulog(without=(field,)))
        assert line in refused(capsys, without)
    without.write_bytes(flown_ulog(without=("wind",)))
    assert "has no topic wind; let the estimator of wind run" in refused(capsys, without)
    broken = tmp_path / "broken.ulg"
    broken.write_bytes(good.read_bytes()[:60])
    assert "has no topic vehicle_local_position; log it." in refused(capsys, broken)
    short = tmp_path / "short.ulg"
    short.write_bytes(good.read_bytes()[:12])
    assert "is not a complete PX4 log; copy it again." in refused(capsys, short)
    bare = tmp_path / "bare.ulg"
    bare.write_bytes(ulog({"battery_status": (("voltage_v", "current_a"), [(0, 22.0, 9.0)])}))
    assert "has no topic vehicle_local_position; log it." in refused(capsys, bare)
    monkeypatch.setitem(sys.modules, "pyulog", None)
    line = refused(capsys, good)
    assert "PX4 logs need the package pyulog; pip install 'pyomo_quad[logs]'." in line
