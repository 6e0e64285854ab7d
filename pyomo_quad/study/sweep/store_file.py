"""The file of a result store: opening it, telling it from other files, keeping others out."""

import fcntl
import os
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from pyomo_quad.study.sweep.errors import StoreError
from pyomo_quad.version import __version__

__all__ = [
    "STORE_NAME",
    "check_format",
    "connected",
    "create_if_new",
    "discard",
    "locked_folder",
    "not_a_store",
]

STORE_NAME = "sweep.sqlite"
_STORE_FORMAT = 1
# "PQSW": tells this database from any other SQLite file.
_APPLICATION_ID = 0x50515357
_LOCK_NAME = ".sweep.lock"

_TABLES = (
    "sweep (name TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID",
    (
        "case_row (case_key TEXT PRIMARY KEY, overrides TEXT NOT NULL, status TEXT NOT NULL, "
        "reason TEXT NOT NULL, outputs TEXT NOT NULL, seconds REAL NOT NULL, worker TEXT NOT NULL, "
        "finished_at TEXT NOT NULL)"
    ),
    "warm_start (case_key TEXT PRIMARY KEY, arrays BLOB)",
)


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Make an output folder and keep other sweeps out of it.

    Parameters
    ----------
    folder : Path
        The folder; the kernel releases it when this process ends, however it ends.

    Yields
    ------
    None
        While the folder is held.

    Raises
    ------
    StoreError
        If the folder cannot be written, or another sweep holds it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / _LOCK_NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise StoreError(
            f"{folder}: cannot be written ({error.strerror}); choose another --out."
        ) from None
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
def connected(file: Path) -> Iterator[sqlite3.Connection]:
    """Connect to a database for the length of a block.

    Parameters
    ----------
    file : Path
        The database; it is made when there is none.

    Yields
    ------
    sqlite3.Connection
        Nothing has been read through it yet.

    Raises
    ------
    StoreError
        If it cannot be opened.
    """
    try:
        connection = sqlite3.connect(file, timeout=30.0)
    except sqlite3.Error as error:
        raise StoreError(f"{file}: cannot be opened ({error}); choose another --out.") from None
    try:
        # A store may come from a stranger: what its schema says is not to be trusted.
        connection.execute("PRAGMA trusted_schema = OFF")
        yield connection
    finally:
        connection.close()


def create_if_new(connection: sqlite3.Connection, file: Path, notes: Mapping[str, str]) -> None:
    """Make the tables of a store in an empty database, in one transaction.

    Parameters
    ----------
    connection : sqlite3.Connection
        To any database; one that holds something is left alone.
    file : Path
        Its name for messages.
    notes : mapping
        What the store says of itself.

    Raises
    ------
    StoreError
        If the file is not a database.
    """
    try:
        (count,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
        if count:
            return
        connection.execute("PRAGMA journal_mode = WAL")
        # One transaction: a process killed in it leaves an empty database, which is a new store.
        with connection:
            connection.execute("BEGIN")
            for table in _TABLES:
                connection.execute(f"CREATE TABLE {table}")
            connection.executemany("INSERT INTO sweep VALUES (?, ?)", list(notes.items()))
            connection.execute(f"PRAGMA application_id = {_APPLICATION_ID}")
            connection.execute(f"PRAGMA user_version = {_STORE_FORMAT}")
    except sqlite3.OperationalError as error:
        raise StoreError(f"{file}: cannot be written ({error}); choose another --out.") from None
    except sqlite3.DatabaseError:
        raise not_a_store(file) from None


def check_format(connection: sqlite3.Connection, file: Path) -> None:
    """Refuse a database that is no store, or a store of another format.

    Parameters
    ----------
    connection : sqlite3.Connection
        To any database.
    file : Path
        Its name for messages.

    Raises
    ------
    StoreError
        If its rows cannot be read.
    """
    try:
        (application,) = connection.execute("PRAGMA application_id").fetchone()
        (found,) = connection.execute("PRAGMA user_version").fetchone()
    except sqlite3.DatabaseError:
        raise not_a_store(file) from None
    if application != _APPLICATION_ID:
        raise not_a_store(file)
    if found != _STORE_FORMAT:
        raise StoreError(
            f"{file}: has store format {found}, pyomo_quad {__version__} uses format "
            f"{_STORE_FORMAT}; use the version that made it, choose another --out, or start anew "
            f"with --fresh."
        )


def not_a_store(file: Path) -> StoreError:
    """Return the error for a file that is not a result store."""
    return StoreError(f"{file}: is not a result store; move it away, or start anew with --fresh.")


def discard(file: Path) -> None:
    """Delete a store, if there is one, with what SQLite keeps beside it."""
    for suffix in ("", "-wal", "-shm"):
        file.with_name(file.name + suffix).unlink(missing_ok=True)
