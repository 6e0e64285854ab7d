"""Commands that write a single file replace what they wrote themselves, and nothing else."""

import os
import socket
import stat
import threading
from pathlib import Path
from shutil import copytree

import pytest

from pyomo_quad import Plan
from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.report.folder import output_file
from pyomo_quad.scenario import OutputError
from tests import flights
from tests.command import SCENARIOS

REPORT = str(SCENARIOS.parent / "reports" / "paper_calm")
# A short hop on a mesh that needs no refinement.
HOP = (
    "mission.goal.position=[1.0, 0.0, 0.5]",
    "mission.duration=4.0",
    "solver.elements=20",
)
EXPORTS = {
    "q.plan": ("export", REPORT, "--to", "qgroundcontrol", "--as-planned", "--origin", "1,2,3"),
    "p.csv": ("export", REPORT, "--to", "px4", "--as-planned", "--rate", "10"),
    "c.csv": ("export", REPORT, "--to", "crazyflie", "--as-planned"),
    "r.py": ("export", REPORT, "--to", "rotorpy", "--as-planned"),
}
PICTURES = {f"e{kind}": ("plot", REPORT, "energy") for kind in (".png", ".svg", ".pdf")}
COMMANDS = EXPORTS | PICTURES
# Names that another program gives the pieces of a trajectory, as its files are found.
OTHERS = "duration,x^0,x^1\n1.0,0.0,0.0\n"


@pytest.mark.lengthy
@pytest.mark.parametrize("name", COMMANDS)
def test_an_earlier_file_of_ours_is_replaced_and_a_strangers_is_not(tmp_path, capsys, name):
    command, out = COMMANDS[name], tmp_path / name
    out.touch()
    assert main([*command, "--out", str(out), "--quiet"]) == ExitCode.VERIFIED
    written = out.read_bytes()
    assert main([*command, "--out", str(out), "--quiet"]) == ExitCode.VERIFIED
    assert out.read_bytes() == written
    out.write_text(OTHERS)
    assert main([*command, "--out", str(out)]) == ExitCode.FAULT
    assert capsys.readouterr().err == (
        f"{out}: exists and was not written by this command; move it away or choose another "
        "--out.\n"
    )
    assert out.read_text() == OTHERS
    assert [file.name for file in tmp_path.iterdir()] == [name]


def test_a_vehicle_file_of_the_users_is_not_replaced(tmp_path, capsys):
    pytest.importorskip("rotorpy", reason="needs '.[rotorpy]'")
    out = tmp_path / "hummingbird.toml"
    command = ["rotorpy-vehicle", "hummingbird", "--out", str(out), "--quiet"]
    for _ in range(2):
        assert main(command) == ExitCode.VERIFIED
    out.write_text("# mine\n")
    assert main(command) == ExitCode.FAULT
    assert "was not written by this command" in capsys.readouterr().err
    assert out.read_text() == "# mine\n"


@pytest.mark.lengthy
def test_schema_replaces_its_own_pages_and_no_readme_of_the_users(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        assert main(["schema"]) == ExitCode.VERIFIED
    for file in tmp_path.iterdir():
        file.unlink()
    (tmp_path / "README.md").write_text("# My thesis\n")
    capsys.readouterr()
    assert main(["schema"]) == ExitCode.FAULT
    said = capsys.readouterr()
    assert said.err.startswith("README.md: exists and was not written by this command; ")
    assert (said.out, len(said.err.splitlines())) == ("", 1)
    assert [file.name for file in tmp_path.iterdir()] == ["README.md"]
    assert (tmp_path / "README.md").read_text() == "# My thesis\n"


@pytest.mark.lengthy
@pytest.mark.parametrize("name", ["p.csv", "e.png"])
def test_a_fifo_gets_the_bytes_and_stays_one(tmp_path, name):
    whole, fifo = tmp_path / f"whole.{name}", tmp_path / name
    os.mkfifo(fifo)
    got = []
    reader = threading.Thread(target=lambda: got.append(fifo.read_bytes()), daemon=True)
    reader.start()
    assert main([*COMMANDS[name], "--out", str(fifo), "--quiet"]) == ExitCode.VERIFIED
    reader.join(timeout=10.0)
    assert main([*COMMANDS[name], "--out", str(whole), "--quiet"]) == ExitCode.VERIFIED
    assert got == [whole.read_bytes()]
    assert stat.S_ISFIFO(fifo.stat().st_mode)


def test_a_device_stays_one(tmp_path):
    device = tmp_path / "null"
    try:
        os.mknod(device, stat.S_IFCHR | 0o666, Path("/dev/null").stat().st_rdev)
        device.write_bytes(b"")
    except PermissionError:
        pytest.skip("only root makes devices, and not everywhere")
    with output_file(device) as aside:
        aside.write_text("a figure")
    assert stat.S_ISCHR(device.stat().st_mode)
    assert list(tmp_path.iterdir()) == [device]


def test_a_socket_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # a socket's path is short
    with socket.socket(socket.AF_UNIX) as held:
        held.bind("plan")
        with (
            pytest.raises(
                OutputError, match=r"plan: is neither a regular file nor a stream; choose"
            ),
            output_file("plan"),
        ):
            pass
    assert stat.S_ISSOCK(Path("plan").stat().st_mode)


def test_what_comes_into_being_meanwhile_is_not_replaced(tmp_path):
    out = tmp_path / "path.svg"
    with pytest.raises(OutputError, match=r"was not written by this command"), output_file(out):
        out.write_text("mine")
    assert out.read_text() == "mine"


def test_a_link_leads_to_a_file_of_the_users(tmp_path):
    (tmp_path / "mine.csv").write_text(OTHERS)
    link = tmp_path / "link.csv"
    link.symlink_to("mine.csv")
    assert main([*EXPORTS["c.csv"], "--out", str(link)]) == ExitCode.FAULT
    assert (tmp_path / "mine.csv").read_text() == OTHERS
    assert link.is_symlink()


def test_an_export_does_not_replace_its_own_source(tmp_path, capsys):
    file = tmp_path / "plan.npz"
    plan = flights.plan("paper_calm", *HOP)
    plan.save(file)
    before = file.read_bytes()
    assert main(["export", str(file), "--to", "px4", "--out", str(file)]) == ExitCode.BAD_INPUT
    assert "holds the plan that is exported; choose another --out." in capsys.readouterr().err
    assert file.read_bytes() == before
    assert Plan.load(file).energy == plan.energy


def test_a_bag_does_not_replace_the_report_that_it_is_made_of(tmp_path, capsys):
    report = tmp_path / "report"
    copytree(REPORT, report)
    # The folder is ours to the last file: as a report it might be replaced.
    names = [str(f.relative_to(report)) for f in report.rglob("*") if f.is_file()]
    (report / ".pyomo_quad_files").write_text("".join(f"{name}\n" for name in names))
    command = ["export", str(report), "--to", "ros2", "--out", str(report)]
    assert main(command) == ExitCode.BAD_INPUT
    assert "holds the plan that is exported; choose another --out." in capsys.readouterr().err
    assert (report / "plan.csv").is_file()
