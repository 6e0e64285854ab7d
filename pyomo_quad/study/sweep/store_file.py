"""The file of a result store: opening it, telling it from other files, keeping others out."""

import fcntl
import os
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path

from pyomo_quad.scenario.complaint import printable, shown
from pyomo_quad.study.sweep.errors import StoreError
from pyomo_quad.version import __version__

__all__ = [
    "STORE_NAME",
    "check_format",
    "connected",
    "create_if_new",
    "damaged",
    "discard",
    "locked_folder",
    "opened_to_read",
]

STORE_NAME = "sweep.sqlite"
_STORE_FORMAT = 1
# "PQSW": tells this database from any other SQLite file.
_APPLICATION_ID = 0x50515357
_LOCK_NAME = ".sweep.lock"
_LOCK_SECONDS = 5.0
# A cell of a million cases' design is smaller; a stranger's store can claim gigabytes.
_LARGEST_CELL = 2**28
_BUSY = ("SQLITE_BUSY", "SQLITE_LOCKED")
# How SQLite says that it cannot write a database, or what it keeps beside one to read it.
_UNWRITABLE = ("SQLITE_CANTOPEN", "SQLITE_READONLY")
_UNUSABLE = (*_UNWRITABLE, "SQLITE_FULL", "SQLITE_IOERR", "SQLITE_PERM")

_TABLES = {
    "sweep": "(name TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID",
    "case_row": (
        "(case_key TEXT PRIMARY KEY, overrides TEXT NOT NULL, status TEXT NOT NULL, "
        "reason TEXT NOT NULL, outputs TEXT NOT NULL, seconds REAL NOT NULL, worker TEXT NOT NULL, "
        "finished_at TEXT NOT NULL)"
    ),
    "warm_start": "(case_key TEXT PRIMARY KEY, arrays BLOB)",
}


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Make an output folder and keep other sweeps out of it.

    The kernel releases it when this process ends, however it ends.

    Raises
    ------
    StoreError
        If the folder cannot be written, or another sweep holds it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / _LOCK_NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise _unwritable(folder, error.strerror) from None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError:
        raise StoreError(
            f"{folder}: another sweep is writing here; wait for it or choose another --out."
        ) from None
    finally:
        os.close(lock)


@contextmanager
def connected(file: Path, *, mode: str, called: Path | None = None) -> Iterator[sqlite3.Connection]:
    """Connect to a database for the length of a block; messages call it by another name if given.

    Raises
    ------
    StoreError
        If SQLite refuses anything that is asked of it in the block.
    """
    connection = None
    try:
        connection = sqlite3.connect(_address(file, mode), timeout=_LOCK_SECONDS, uri=True)
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LARGEST_CELL)
        # A store may come from a stranger: what its schema says is not to be trusted.
        connection.execute("PRAGMA trusted_schema = OFF")
        yield connection
    except sqlite3.DatabaseError as error:
        raise _refused(called or file, error) from None
    finally:
        if connection is not None:
            connection.close()


@contextmanager
def opened_to_read(file: Path) -> Iterator[sqlite3.Connection]:
    """Connect to a database without changing it, wherever it lies.

    SQLite reads a database that has a log only where it can write beside it.  On a read-only disk a
    copy is read instead, made together with the log, so that no row is missed.
    """
    if _is_readable_in_place(file):
        with connected(file, mode="ro") as connection:
            yield connection
        return
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / file.name
        try:
            shutil.copyfile(file, copy)
            if _log_of(file).is_file():
                shutil.copyfile(_log_of(file), _log_of(copy))
        except OSError as error:
            raise StoreError(f"{file}: cannot be read ({error.strerror}).") from None
        with connected(copy, mode="rw", called=file) as connection:
            yield connection


def create_if_new(connection: sqlite3.Connection, notes: Mapping[str, str]) -> None:
    """Make the tables of a store in an empty database, and make sure that it can be written."""
    (count,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    if not count:
        connection.execute("PRAGMA journal_mode = WAL")
    # One transaction: a process killed in it leaves an empty database, which is a new store.
    with connection:
        connection.execute("BEGIN IMMEDIATE")
        if count:
            return
        for name, columns in _TABLES.items():
            connection.execute(f"CREATE TABLE {name} {columns}")
        connection.executemany("INSERT INTO sweep VALUES (?, ?)", list(notes.items()))
        connection.execute(f"PRAGMA application_id = {_APPLICATION_ID}")
        connection.execute(f"PRAGMA user_version = {_STORE_FORMAT}")


def check_format(connection: sqlite3.Connection, file: Path) -> None:
    """Refuse a database that is no store, a store of another format, and other tables than ours."""
    if _application_of(connection) != _APPLICATION_ID:
        raise _not_a_store(file)
    (found,) = connection.execute("PRAGMA user_version").fetchone()
    if found != _STORE_FORMAT:
        raise StoreError(
            f"{file}: has store format {found}, pyomo_quad {__version__} uses format "
            f"{_STORE_FORMAT}; use the version that made it, choose another --out, or start anew "
            f"with --fresh."
        )
    # Compared to the letter: a view, a trigger or another type would bring in what is not checked.
    query = "SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL"
    declared = {name: f"CREATE TABLE {name} {columns}" for name, columns in _TABLES.items()}
    for name, text in connection.execute(query):
        if declared.pop(name, None) != text:
            raise damaged(file, f"{shown(name)} is none of its tables")
    if declared:
        raise damaged(file, f"table {next(iter(declared))} is missing")


def damaged(file: Path, what: str) -> StoreError:
    """Return the error for a store that holds what no sweep wrote."""
    return StoreError(
        f"{file}: is damaged ({printable(what)}); restore it from a copy, or choose another --out."
    )


def discard(file: Path) -> None:
    """Delete a store, if there is one, with what SQLite keeps beside it; nothing else."""
    if file.exists():
        with connected(file, mode="rw") as connection:
            is_own = _application_of(connection) == _APPLICATION_ID
            if not is_own and connection.execute("SELECT 1 FROM sqlite_master").fetchone():
                raise _not_a_store(file)
    for beside in (file, _log_of(file), file.with_name(f"{file.name}-shm")):
        beside.unlink(missing_ok=True)


def _application_of(connection: sqlite3.Connection) -> int:
    (found,) = connection.execute("PRAGMA application_id").fetchone()
    return int(found)


def _is_readable_in_place(file: Path) -> bool:
    try:
        with closing(sqlite3.connect(_address(file, "ro"), uri=True)) as trial:
            trial.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except sqlite3.DatabaseError as error:
        return not _name_of(error).startswith(_UNWRITABLE)
    return True


def _refused(file: Path, error: sqlite3.DatabaseError) -> StoreError:
    name = _name_of(error)
    if name == "SQLITE_NOTADB":
        return _not_a_store(file)
    if name.startswith(_BUSY):
        return StoreError(f"{file}: is locked by another program; wait until that has ended.")
    if name.startswith(_UNUSABLE):
        return _unwritable(file.parent, str(error))
    return damaged(file, str(error))


def _unwritable(folder: Path, reason: str | None) -> StoreError:
    if (folder / STORE_NAME).is_file():
        return StoreError(
            f"{folder}: is read-only ({reason}); its results are whole: read them with "
            f"`pyomo-quad sweep-report {folder} --out DIR`, or sweep into another --out."
        )
    return StoreError(f"{folder}: cannot be written ({reason}); choose another --out.")


def _not_a_store(file: Path) -> StoreError:
    return StoreError(f"{file}: is not a result store; move it away, or choose another --out.")


def _name_of(error: sqlite3.DatabaseError) -> str:
    # Errors of Python's own, such as of text that is not UTF-8, have no name.
    return getattr(error, "sqlite_errorname", None) or ""


def _address(file: Path, mode: str) -> str:
    return f"{file.resolve().as_uri()}?mode={mode}"


def _log_of(file: Path) -> Path:
    return file.with_name(f"{file.name}-wal")
