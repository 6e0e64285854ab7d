"""A store that is damaged or not ours is refused in one line; a read-only one is read."""

import json
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from pyomo_quad.cli.commands import main
from pyomo_quad.sweep import ResultStore, StoreError, design_sweep, load_study, store
from pyomo_quad.sweep.store import STORE_NAME
from tests.sweep.studies import DURATION_AXIS, write_study
from tests.sweep.sweeping import Here, rows, sweep

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    sweep(write_study(folder, DURATION_AXIS), folder / "out", Here())
    return folder / "out"


@pytest.fixture
def folder(whole, tmp_path):
    return Path(shutil.copytree(whole, tmp_path / "out"))


def said(statement: str, *values: object) -> Callable[[Path], None]:
    """Return the damage that an SQL statement does."""

    def damage(file: Path) -> None:
        with closing(sqlite3.connect(file)) as database, database:
            database.execute(statement, values)

    return damage


def in_design(change: Callable[[dict], object]) -> Callable[[Path], None]:
    def damage(file: Path) -> None:
        with closing(sqlite3.connect(file)) as database, database:
            (text,) = database.execute("SELECT value FROM sweep WHERE name = 'design'").fetchone()
            design = json.loads(text)
            change(design)
            written = (json.dumps(design),)
            database.execute("UPDATE sweep SET value = ? WHERE name = 'design'", written)

    return damage


def cut(share: float) -> Callable[[Path], None]:
    return lambda file: file.write_bytes(file.read_bytes()[: int(file.stat().st_size * share)])


def scramble(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[4096:] = bytes(255 - byte for byte in content[4096:])
    file.write_bytes(content)


def foreign(file: Path) -> None:
    file.unlink()
    said("CREATE TABLE notes (text)")(file)


def outputs(text: object) -> Callable[[Path], None]:
    return said("UPDATE case_row SET outputs = ?", text)


DAMAGES = {
    "cut in half": cut(0.5),
    "cut in its header": cut(0.003),
    "emptied": cut(0.0),
    "scrambled": scramble,
    "foreign database": foreign,
    "no database": lambda file: file.write_text("notes " * 999),
    "other format": said("PRAGMA user_version = 7"),
    "table missing": said("DROP TABLE case_row"),
    "column missing": said("ALTER TABLE case_row DROP COLUMN seconds"),
    "table more": said("CREATE TABLE more (x)"),
    "endless view": said(
        "CREATE VIEW v AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) "
        "SELECT i FROM n"
    ),
    "trigger": said("CREATE TRIGGER t AFTER INSERT ON case_row BEGIN DELETE FROM sweep; END"),
    "design missing": said("DELETE FROM sweep WHERE name = 'design'"),
    "version missing": said("DELETE FROM sweep WHERE name = 'version'"),
    "design no JSON": said("UPDATE sweep SET value = '{' WHERE name = 'design'"),
    "design a blob": said("UPDATE sweep SET value = ? WHERE name = 'design'", b"\xff\x00"),
    "design of bad UTF-8": said(
        "UPDATE sweep SET value = CAST(? AS TEXT) WHERE name = 'design'", b"\xff\xfe"
    ),
    "base empty": in_design(lambda design: design.update(base={})),
    "base of nonsense": in_design(lambda design: design["base"].update(mission="far")),
    "no dimension": in_design(lambda design: design.update(dimensions=[])),
    "no step": in_design(lambda design: design["dimensions"][0].update(steps=[])),
    "steps of several kinds": in_design(
        lambda design: design["dimensions"][0]["steps"].append(["long"])
    ),
    "steps not finite": in_design(
        lambda design: design["dimensions"][0]["steps"].append([float("nan")])
    ),
    "steps too short": in_design(lambda design: design["dimensions"][0]["steps"].append([])),
    "endless cases": in_design(
        lambda design: design["dimensions"].extend(
            {"paths": [f"a{n}"], "steps": [[float(k)] for k in range(100)], "is_random": False}
            for n in range(9)
        )
    ),
    "task unknown": in_design(lambda design: design.update(task="dance")),
    "output unknown": in_design(lambda design: design.update(report_on=["luck"])),
    "outputs no JSON": outputs("{"),
    "outputs a list": outputs("[1, 2]"),
    "outputs NaN": outputs('{"energy_J": NaN}'),
    "outputs infinite": outputs('{"energy_J": 1e999}'),
    "outputs huge": outputs('{"energy_J": 1e300}'),
    "outputs text": outputs('{"energy_J": "much"}'),
    "outputs with a name of markup": outputs('{"<b>\\n": 1.0}'),
    "outputs a blob": outputs(b"\x00\x01"),
    "outputs deep": outputs("[" * 100_000),
    "outputs of bad UTF-8": said("UPDATE case_row SET outputs = CAST(? AS TEXT)", b"\xff\xfe"),
    "status unknown": said("UPDATE case_row SET status = 'fine'"),
    "seconds text": said("UPDATE case_row SET seconds = 'long'"),
    "seconds negative": said("UPDATE case_row SET seconds = -1"),
    "key of no case": said("UPDATE case_row SET case_key = 'x' || case_key"),
    "values of another case": said("UPDATE case_row SET overrides = '{}'"),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES.keys())
def test_damage_is_refused_in_one_line(folder, damage, capsys):
    file = folder / STORE_NAME
    damage(file)
    before = file.read_bytes()
    assert main(["sweep-report", str(folder)]) == 1
    shown = capsys.readouterr().err.strip()
    assert "\n" not in shown
    assert shown.startswith(str(file))
    assert "is damaged" in shown or "is not a result store" in shown or "store format 7" in shown
    assert "bug" not in shown
    assert file.read_bytes() == before
    with pytest.raises(StoreError), ResultStore.reading(folder) as store:
        store.rows()


def test_a_missing_row_is_a_case_to_solve(folder):
    said("DELETE FROM case_row WHERE rowid = 3")(folder / STORE_NAME)
    assert len(rows(folder)) == 9


def test_fresh_deletes_stores_and_nothing_else(folder, tmp_path):
    file = folder / STORE_NAME
    foreign(file)
    design = design_sweep(load_study(write_study(tmp_path, DURATION_AXIS)))
    with (
        pytest.raises(StoreError, match="is not a result store; move it away"),
        ResultStore.writing(folder, design, is_fresh=True),
    ):
        pass
    assert file.is_file()


@pytest.mark.slow
def test_a_locked_store_is_said_to_be_locked(folder, monkeypatch, capsys):
    monkeypatch.setattr(store, "_LOCK_SECONDS", 0.1)
    with closing(sqlite3.connect(folder / STORE_NAME)) as other:
        other.execute("PRAGMA locking_mode = EXCLUSIVE")
        other.execute("BEGIN EXCLUSIVE")
        other.execute("DELETE FROM warm_start")
        assert main(["sweep-report", str(folder)]) == 1
    assert "is locked by another program; wait" in capsys.readouterr().err


def read_only(folder: Path, *arguments: object) -> subprocess.CompletedProcess:
    """Run a command where a folder is mounted read-only, for this command alone."""
    mount = 'mount --bind "$0" "$0" && mount -o remount,ro,bind "$0" || exit 77; exec "$@"'
    command = ["unshare", "-rm", "sh", "-c", mount, folder, sys.executable, "-m", "pyomo_quad"]
    if shutil.which("unshare") is None:
        pytest.skip("no unshare on this system")
    done = subprocess.run(
        [*map(str, command), *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=REPOSITORY,
        check=False,
    )
    if done.returncode == 77 or "unshare" in done.stderr:
        pytest.skip("this system mounts nothing read-only for a test")
    return done


@pytest.mark.slow
def test_a_killed_sweep_on_a_read_only_disk_is_read_whole(folder, tmp_path):
    # The log of a sweep that was killed holds rows that its database does not have yet.
    with closing(sqlite3.connect(folder / STORE_NAME)) as database:
        database.execute("PRAGMA wal_autocheckpoint = 0")
        with database:
            database.execute("UPDATE case_row SET reason = 'from the log'")
        killed = Path(shutil.copytree(folder, tmp_path / "killed"))
    for beside in killed.glob("*-shm"):
        beside.unlink()
    done = read_only(killed, "sweep-report", killed, "--out", tmp_path / "report")
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "report" / "results.csv").read_text().count("from the log") == 10


@pytest.mark.slow
def test_a_sweep_into_a_read_only_folder_is_told_so_and_to_destroy_nothing(folder, tmp_path):
    done = read_only(folder, "sweep", write_study(tmp_path, DURATION_AXIS), "--out", folder)
    assert done.returncode == 1
    assert f"{folder}: is read-only (Read-only file system)" in done.stderr
    assert "sweep-report" in done.stderr
    assert "--fresh" not in done.stderr
