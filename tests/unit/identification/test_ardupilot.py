"""ArduPilot logs, written here byte by byte as the autopilot writes them."""

import struct
import sys

import numpy as np
import pytest

from pyomo_quad.identification.logs import read_logs
from pyomo_quad.scenario import ScenarioError

# Letters of ArduPilot's formats as struct has them.
LETTERS = {"Q": "Q", "B": "B", "f": "f"}
MESSAGES = {
    "XKF1": (10, "QBffff", "TimeUS,C,VN,VE,VD,PD"),
    "XKF2": (11, "QBff", "TimeUS,C,VWN,VWE"),
    "BAT": (12, "QBff", "TimeUS,Inst,Volt,Curr"),
    "BARO": (13, "QBff", "TimeUS,I,Press,GndTemp"),
    "EV": (14, "QB", "TimeUS,Id"),
}
FLYING, LANDED = 28, 18


def packed(number, form, *values):
    return b"\xa3\x95" + bytes([number]) + struct.pack(f"<{form}", *values)


def formats(names):
    own = packed(128, "BB4s16s64s", 128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    texts = [own]
    for name in names:
        number, form, columns = MESSAGES[name]
        length = 3 + struct.calcsize("<" + "".join(LETTERS[letter] for letter in form))
        told = name.encode(), form.encode(), columns.encode()
        texts.append(packed(128, "BB4s16s64s", number, length, *told))
    return b"".join(texts)


def log(names=tuple(MESSAGES), seconds=20, hertz=10, current=14.0):
    """A hover for 2 s, then a cruise of 3 m/s to the north in a wind of 1 m/s from there."""
    text = [formats(names)]

    def write(name, *values):
        if name in names:
            text.append(packed(MESSAGES[name][0], MESSAGES[name][1], *values))

    for k in range(seconds * hertz):
        now = 5_000_000 + k * 1_000_000 // hertz
        if k in {2 * hertz, (seconds - 2) * hertz}:
            write("EV", now, FLYING if k == 2 * hertz else LANDED)
        for core in (0, 1):  # the second core reads nonsense
            write("XKF1", now, core, 3.0 + 50 * core, 0.0, 0.5, -10.0)
            write("XKF2", now, core, -1.0, 0.25)
        write("BAT", now, 0, 15.0, current)
        write("BARO", now, 0, 101325.0, 15.0)
    return b"".join(text)


def read(tmp_path, content):
    (tmp_path / "flight.BIN").write_bytes(content)
    return read_logs(tmp_path / "flight.BIN")


def test_what_was_written_is_read(tmp_path):
    pytest.importorskip("pymavlink")
    frame = read(tmp_path, log())
    assert frame["flight"].unique().tolist() == ["flight"]
    assert len(frame) == pytest.approx(16, abs=1)
    for column, value in {
        "power_W": 210.0,
        "vel_north_m_s": 3.0,
        "vel_up_m_s": -0.5,
        "air_vel_north_m_s": 4.0,
        "air_vel_east_m_s": -0.25,
        "air_density_kg_m3": 101325 / (287.05 * 288.15),
    }.items():
        np.testing.assert_allclose(frame[column], value, rtol=1e-5)


def test_without_wind_barometer_and_events_the_air_is_still_and_dense(tmp_path):
    pytest.importorskip("pymavlink")
    frame = read(tmp_path, log(("XKF1", "BAT")))
    assert len(frame) == 20
    np.testing.assert_allclose(frame["air_vel_north_m_s"], 3.0, rtol=1e-6)
    np.testing.assert_allclose(frame["air_density_kg_m3"], 1.225, rtol=1e-3)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (lambda: log(("XKF1", "BARO")), "has no message BAT with Volt, Curr; log it"),
        (lambda: log(("BAT",)), "has no message XKF1 with VN, VE, VD; log it"),
        (lambda: log(current=0.0), "BAT has no current; fit a power module"),
        (lambda: b"\x00" * 300, "is not a complete ArduPilot log; copy it again"),
    ],
)
def test_logs_that_lack_something_are_refused(content, told, tmp_path):
    pytest.importorskip("pymavlink")
    with pytest.raises(ScenarioError) as caught:
        read(tmp_path, content())
    assert told in str(caught.value)
    assert "Of a log the columns are" in str(caught.value)


def test_without_the_reader_its_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pymavlink.DFReader", None)
    with pytest.raises(ScenarioError, match=r"pip install 'pyomo_quad\[logs\]'"):
        read(tmp_path, log(seconds=1))
