"""Result store of a parameter sweep: an SQLite database in the sweep's output folder.

The store holds the sweep's design, one row for each case that has ended, and warm starts: solutions
from which the solves of neighbouring cases start. Each row is committed when its case ends, so that
an interrupted sweep loses no result.
"""

import errno
import fcntl
import json
import os
import shutil
import sqlite3
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
from pydantic import BaseModel, ConfigDict, Field, Json, Strict, ValidationError

from pyomo_quad.scenario.messages import OutputError, printable, shown
from pyomo_quad.sweep.case import LARGEST_OUTPUT, CaseOutcome, CaseStatus
from pyomo_quad.sweep.design import SweepDesign, case_key, cell_of, expand
from pyomo_quad.version import __version__

STORE_NAME = "sweep.sqlite"
_STORE_FORMAT = 1
# "PQSW": distinguishes this database from other SQLite files.
_APPLICATION_ID = 0x50515357
_LOCK_NAME = ".sweep.lock"
_LOCK_SECONDS = 5.0
# Largest cell [bytes]: a design of a million cases is smaller; a damaged store may claim more.
_LARGEST_CELL = 2**28
_BUSY = ("SQLITE_BUSY", "SQLITE_LOCKED")
# SQLite's names of the errors for a database, or its write-ahead log, that cannot be written.
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


class StoreError(OutputError):
    """Error: a result store cannot be read, or cannot accept the rows of the present sweep."""


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Context manager: create an output folder, and lock it so that no other sweep writes there.

    The operating system releases the lock when this process ends, even if it is killed. StoreError
    is raised if the folder cannot be written or is locked.
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
    """Context manager: connect to an SQLite database, and translate SQLite's errors to StoreError.

    `mode` is SQLite's: ``"ro"`` reads, ``"rw"`` also writes, ``"rwc"`` also creates. Error messages
    print `called` in place of `file`.
    """
    connection = None
    try:
        connection = sqlite3.connect(_address(file, mode), timeout=_LOCK_SECONDS, uri=True)
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LARGEST_CELL)
        # A store may be untrusted: SQL in its schema must not run.
        connection.execute("PRAGMA trusted_schema = OFF")
        yield connection
    except sqlite3.DatabaseError as error:
        raise _refused(called or file, error) from None
    finally:
        if connection is not None:
            connection.close()


@contextmanager
def opened_to_read(file: Path) -> Iterator[sqlite3.Connection]:
    """Context manager: connect to an SQLite database for reading, even on a read-only disk.

    StoreError is raised if the database or its log file beside it cannot be read, or SQLite raises
    an error.
    """
    if _is_readable_in_place(file):
        with connected(file, mode="ro") as connection:
            yield connection
        return
    # SQLite reads the log file beside the database only in a writable folder.
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
    """Create the tables of a result store in an empty database.

    `notes` become rows of the table ``sweep``: ``design`` as JSON text, and ``version`` of
    pyomo_quad. If the database already has tables, the function only checks that it is writable.
    sqlite3.DatabaseError is raised if it is not.
    """
    (count,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    if not count:
        connection.execute("PRAGMA journal_mode = WAL")
    # One transaction: if it is interrupted, the database stays empty and counts as a new store.
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
    """Check that a database is a result store of the present format.

    StoreError is raised if another program made the database, or its format number or its tables
    differ. `file` is for messages.
    """
    if _application_of(connection) != _APPLICATION_ID:
        raise _not_a_store(file)
    (found,) = connection.execute("PRAGMA user_version").fetchone()
    if found != _STORE_FORMAT:
        raise StoreError(
            f"{file}: has store format {found}, pyomo_quad {__version__} uses format "
            f"{_STORE_FORMAT}; use the version that made it, choose another --out, or start anew "
            f"with --fresh."
        )
    # Compare the exact SQL text, since views, triggers and column types are not checked otherwise.
    query = "SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL"
    declared = {name: f"CREATE TABLE {name} {columns}" for name, columns in _TABLES.items()}
    for name, text in connection.execute(query):
        if declared.pop(name, None) != text:
            raise damaged(file, f"{shown(name)} is not one of its tables")
    if declared:
        raise damaged(file, f"table {next(iter(declared))} is missing")


def damaged(file: Path, what: str) -> StoreError:
    """Make the error for a damaged result store, for the caller to raise.

    `what` describes the damage for the message.
    """
    return StoreError(
        f"{file}: is damaged ({printable(what)}); restore it from a copy, or choose another --out."
    )


def discard(file: Path) -> None:
    """Delete a result store with its log and index files, if there is one.

    StoreError is raised if the file is a database of another program, or no database.
    """
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


def refuse_kept_results(folder: Path) -> None:
    """Raise StoreError if a folder has results of a sweep but cannot be written.

    A sweep cannot continue in such a folder. The message names the command that reports the
    results: `pyomo-quad sweep-report`.
    """
    if (folder / STORE_NAME).is_file() and not os.access(folder, os.W_OK):
        is_read_only = os.statvfs(folder).f_flag & os.ST_RDONLY
        raise _unwritable(folder, os.strerror(errno.EROFS if is_read_only else errno.EACCES))


def _unwritable(folder: Path, reason: str | None) -> StoreError:
    if (folder / STORE_NAME).is_file():
        return StoreError(
            f"{folder}: is read-only ({reason}); its results are complete: read them with "
            f"`pyomo-quad sweep-report {folder} --out DIR`, or sweep into another --out."
        )
    return StoreError(f"{folder}: cannot be written ({reason}); choose another --out.")


def _not_a_store(file: Path) -> StoreError:
    return StoreError(f"{file}: is not a result store; move it away, or choose another --out.")


def _name_of(error: sqlite3.DatabaseError) -> str:
    # Errors that Python itself raises, such as for text that is not UTF-8, have no SQLite name.
    return getattr(error, "sqlite_errorname", None) or ""


def _address(file: Path, mode: str) -> str:
    return f"{file.resolve().as_uri()}?mode={mode}"


def _log_of(file: Path) -> Path:
    return file.with_name(f"{file.name}-wal")


_FORGET = "DELETE FROM warm_start WHERE case_key = ?"

_Column = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,99}$")]
_Output = Annotated[float, Field(allow_inf_nan=False, ge=-LARGEST_OUTPUT, le=LARGEST_OUTPUT)]


class StoredCase(BaseModel):
    """Row of a result store for one case of a sweep, validated when it is read.

    The key of the case is a hash of its field values (`overrides`). `seconds` is the wall time of
    the solve [s].
    """

    model_config = ConfigDict(strict=True, frozen=True)

    case_key: str
    overrides: Json[dict[str, Any]]
    status: Annotated[CaseStatus, Strict(False)]
    reason: str
    outputs: Json[dict[_Column, _Output]]
    seconds: float = Field(ge=0.0, allow_inf_nan=False)


class ResultStore:
    """Result store of one sweep, opened by `ResultStore.reading` or `ResultStore.writing`.

    Attributes
    ----------
    file : Path
        SQLite database.
    version : str
        Version of pyomo_quad that made the rows.
    """

    def __init__(self, file: Path, connection: sqlite3.Connection) -> None:
        self.file = file
        self._connection = connection
        self.version = self._note("version")
        self._design = self._checked_design()

    @classmethod
    @contextmanager
    def reading(cls, folder: str | Path) -> Iterator["ResultStore"]:
        """Context manager: open a result store for reading.

        A store can be read while a sweep is writing it, and on a read-only disk.

        Parameters
        ----------
        folder : str or Path
            Output folder of the sweep.

        Raises
        ------
        StoreError
            If the folder has no store, or the store is damaged or has another format.
        """
        file = Path(folder) / STORE_NAME
        if not file.is_file():
            raise StoreError(f"{folder}: holds no {STORE_NAME}; give the folder of a sweep.")
        with opened_to_read(file) as connection:
            check_format(connection, file)
            yield cls(file, connection)

    @classmethod
    @contextmanager
    def writing(
        cls, folder: str | Path, design: SweepDesign, *, is_fresh: bool = False
    ) -> Iterator["ResultStore"]:
        """Context manager: open or create the result store of a sweep, and lock its folder.

        Parameters
        ----------
        folder : str or Path
            Output folder of the sweep.
        design : SweepDesign
            Specification of the sweep, written into a new store.
        is_fresh : bool, default False
            Whether to delete an existing store first. If False, an existing store is opened with
            the rows and the design that it contains.

        Raises
        ------
        StoreError
            If the folder cannot be written, or another sweep is writing there. Also if the store is
            damaged, or was made by another program or another version of pyomo_quad.
        """
        file = Path(folder) / STORE_NAME
        with locked_folder(Path(folder)):
            if is_fresh:
                discard(file)
            with connected(file, mode="rwc") as connection:
                create_if_new(connection, {"design": design.to_json(), "version": __version__})
                check_format(connection, file)
                store = cls(file, connection)
                store.refuse_other_version()
                yield store

    @property
    def design(self) -> SweepDesign:
        """Specification of the sweep whose rows the store holds."""
        return self._design

    def refuse_other_version(self) -> None:
        """Raise StoreError if another version of pyomo_quad made the stored rows."""
        if self.version != __version__:
            raise StoreError(
                f"{self.file}: its rows were made by pyomo_quad {shown(self.version)[1:-1]}, this "
                f"is {__version__}; use that version, choose another --out, or start anew with "
                f"--fresh."
            )

    def replace_design(self, design: SweepDesign, *, is_extended: bool) -> None:
        """Replace the stored design by a new design, and keep the stored rows.

        The new design must contain all stored cases. If the axes of the two designs differ, all
        stored warm starts are deleted.

        Parameters
        ----------
        design : SweepDesign
            New specification of the sweep.
        is_extended : bool
            Whether the axes differ from those of the stored design.
        """
        with self._connection:
            self._connection.execute(
                "UPDATE sweep SET value = ? WHERE name = 'design'", (design.to_json(),)
            )
            # With other axes, a case has other neighbours. Which warm starts exist depends on when
            # the previous run ended; results of new cases must not depend on it.
            if is_extended:
                self._connection.execute("DELETE FROM warm_start")
        self._design = design

    def statuses(self) -> dict[str, CaseStatus]:
        """Return the status of each stored case, by the case's key (a hash of its field values).

        Raises
        ------
        StoreError
            If a row is damaged; see `rows`.
        """
        return {key: row.status for key, row in self.rows().items()}

    def rows(self) -> dict[str, StoredCase]:
        """Read and validate all stored rows.

        Returns
        -------
        dict
            Row of each case that has ended, by the case's key. The key is a hash of the values of
            the scenario fields that vary.

        Raises
        ------
        StoreError
            If a row has a wrong type or value, or belongs to no case of the design.
        """
        known = {case.key for case in expand(self._design)}
        query = f"SELECT {', '.join(StoredCase.model_fields)} FROM case_row"  # noqa: S608
        found = {}
        for number, values in enumerate(self._connection.execute(query), start=1):
            where = f"case_row {number}"
            try:
                row = StoredCase.model_validate(
                    dict(zip(StoredCase.model_fields, values, strict=True))
                )
            except ValidationError as error:
                first = error.errors(include_url=False)[0]
                place = ".".join(map(str, first["loc"]))
                raise damaged(self.file, f"{where}, {place}: {first['msg']}") from None
            if row.case_key not in known or row.case_key != _key_of(row):
                raise damaged(self.file, f"{where} is not a case of its design")
            found[row.case_key] = row
        return found

    def add(
        self,
        outcome: CaseOutcome,
        overrides: Mapping[str, Any],
        *,
        is_parent: bool,
        spent: str = "",
        outdated: Iterable[str] = (),
    ) -> None:
        """Commit the row of a case that ended, in place of an earlier row of the case.

        The row, the warm start and all deletions are one database transaction. Keys are hashes of
        field values.

        Parameters
        ----------
        outcome : CaseOutcome
            Status, output values and solve time of the case.
        overrides : mapping
            Value of each field that varies, by its dotted path.
        is_parent : bool
            Whether other cases start from the solution of this case. If so, the solution is stored
            as a warm start.
        spent : str, optional
            Key of a case whose warm start is no longer needed, and is deleted. Empty to delete
            none.
        outdated : iterable of str, optional
            Keys of cases whose rows and warm starts are no longer valid, and are deleted.

        Raises
        ------
        StoreError
            If the row cannot be written, for example because the disk is full.
        """
        row = (
            outcome.key,
            json.dumps(dict(overrides), sort_keys=True),
            outcome.status.value,
            outcome.reason,
            json.dumps(dict(outcome.values)),
            outcome.seconds,
            outcome.worker,
            datetime.now(UTC).isoformat(timespec="seconds"),
        )
        try:
            with self._connection:
                for key in outdated:
                    self._connection.execute("DELETE FROM case_row WHERE case_key = ?", (key,))
                    self._connection.execute(_FORGET, (key,))
                self._connection.execute("REPLACE INTO case_row VALUES (?,?,?,?,?,?,?,?)", row)
                self._connection.execute(_FORGET, (spent,))
                if is_parent:
                    self._connection.execute(
                        "REPLACE INTO warm_start VALUES (?,?)", (outcome.key, outcome.warm_start)
                    )
        except sqlite3.DatabaseError as error:
            raise StoreError(
                f"{self.file}: cannot be written ({error}); finished cases are kept; free the "
                f"place and run the same command again."
            ) from error

    def warm_start(self, key: str) -> bytes | None:
        """Return a case's warm start: the stored solution from which neighbouring cases start.

        Parameters
        ----------
        key : str
            Key of the case: a hash of the values of the scenario fields that vary.

        Returns
        -------
        bytes or None
            The solution of the case, packed into bytes. For a failed case, it is the solution from
            which the case was started. None if the store has no warm start of the case.

        Raises
        ------
        StoreError
            If the stored warm start is damaged.
        """
        query = "SELECT arrays FROM warm_start WHERE case_key = ?"
        found = self._connection.execute(query, (key,)).fetchone()
        arrays = found[0] if found is not None else None
        if arrays is not None and not isinstance(arrays, bytes):
            raise damaged(self.file, "warm_start: arrays are no bytes")
        return arrays

    def _checked_design(self) -> SweepDesign:
        try:
            design = SweepDesign.from_json(self._note("design"))
            design.refuse_impossible()
        except ValueError as error:
            self.refuse_other_version()
            raise damaged(self.file, str(error).splitlines()[0]) from None
        return design

    def _note(self, name: str) -> str:
        query = "SELECT value FROM sweep WHERE name = ?"
        found = self._connection.execute(query, (name,)).fetchone()
        if found is None or not isinstance(found[0], str):
            raise damaged(self.file, f"table sweep has no {name}")
        return found[0]


def _key_of(row: StoredCase) -> str | None:
    try:
        return case_key(row.overrides)
    except ValueError:
        return None


CASE_COLUMN = "case"
STATUS_COLUMN = "status"
REASON_COLUMN = "reason"


def results_frame(store: ResultStore) -> pd.DataFrame:
    """Return the result table of a sweep: one row for each case that has ended, in design order.

    Parameters
    ----------
    store : ResultStore
        Open result store.

    Returns
    -------
    DataFrame
        Columns: number of the case (from 0), the fields that vary, status, reason of a failure, and
        output columns. The attributes `outputs` and `report_on` of the sweep's design name the
        output columns. If `outputs` is empty, all output columns with values are included.

    Examples
    --------
    >>> with ResultStore.reading("swept") as store:
    ...     frame = results_frame(store)
    >>> frame[["mission.duration", "status"]].to_dict("list")
    {'mission.duration': [4.0, 5.0], 'status': ['finished', 'finished']}
    """
    design, rows = store.design, store.rows()
    ended = [(case, rows[case.key]) for case in expand(design) if case.key in rows]
    kept = design.outputs or [name for _, row in ended for name in row.outputs]
    outputs = dict.fromkeys((*kept, *design.report_on))
    frame = pd.DataFrame(
        {
            CASE_COLUMN: case.position,
            **{path: cell_of(value) for path, value in case.overrides.items()},
            STATUS_COLUMN: row.status.value,
            REASON_COLUMN: row.reason,
            **row.outputs,
        }
        for case, row in ended
    )
    columns = [CASE_COLUMN, *design.paths, STATUS_COLUMN, REASON_COLUMN, *outputs]
    return frame.reindex(columns=columns)


_MOST_CHANGES = 5


def adopt_design(store: ResultStore, design: SweepDesign) -> list[str]:
    """Continue a result store with a changed study, if the stored rows remain valid.

    The rows remain valid if all stored cases are in the new design, and base scenario, task and
    baselines are unchanged. The new design is then written into the store.

    Parameters
    ----------
    store : ResultStore
        Store that is open for writing.
    design : SweepDesign
        Specification from the present study file.

    Returns
    -------
    list of str
        Changes of the axes since the stored design, such as ``axis mission.duration: 2 values 4.0
        to 5.0 -> 3 values 4.0 to 6.0``; empty if the axes are unchanged.

    Raises
    ------
    StoreError
        If the rows are not valid for the new design; the message lists the changes.

    Examples
    --------
    >>> from pyomo_quad.sweep import design_sweep, load_study
    >>> design = design_sweep(load_study("hop_study.toml"))
    >>> with ResultStore.writing("adopted", design) as store:
    ...     adopt_design(store, design)
    []
    """
    stored = store.design
    changes = list(design.changes_since(stored))
    axis_changes = list(design.axis_changes_since(stored))
    rows = store.statuses().keys()
    if rows and not rows <= {case.key for case in expand(design)}:
        changes += axis_changes
    if rows and changes:
        shown = "; ".join(changes[:_MOST_CHANGES])
        more = len(changes) - _MOST_CHANGES
        raise StoreError(
            f"{store.file.parent}: holds {len(rows)} cases of a study that has changed since "
            f"({shown}{f'; and {more} more' if more > 0 else ''}); start anew with --fresh, or "
            f"choose another --out."
        )
    if stored != design:
        store.replace_design(design, is_extended=bool(axis_changes))
    return axis_changes
