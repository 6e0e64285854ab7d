"""The result store: an SQLite database in the output folder that loses nothing.

One process writes, the parent of the workers.  Each finished case is one committed transaction in
write-ahead mode, so a killed sweep has every case that finished, and others may read meanwhile.

Nothing in the store is executable: numbers and texts are JSON, warm starts are plain arrays.
"""

import json
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pyomo_quad.study.sweep.design import SweepDesign
from pyomo_quad.study.sweep.errors import StoreError
from pyomo_quad.study.sweep.store_file import (
    STORE_NAME,
    check_format,
    connected,
    create_if_new,
    discard,
    locked_folder,
    not_a_store,
)
from pyomo_quad.study.sweep.task import CaseOutcome, CaseStatus
from pyomo_quad.version import __version__

__all__ = ["ResultStore", "StoredCase"]


@dataclass(frozen=True, kw_only=True)
class StoredCase:
    """A row of the store."""

    key: str
    status: CaseStatus
    reason: str
    outputs: Mapping[str, float]
    seconds: float


class ResultStore:
    """The rows of one sweep."""

    def __init__(self, file: Path, connection: sqlite3.Connection) -> None:
        self.file = file
        self._connection = connection

    @classmethod
    @contextmanager
    def reading(cls, folder: str | Path) -> Iterator["ResultStore"]:
        """Open a store to read it, also while a sweep writes.

        Parameters
        ----------
        folder : str or Path
            Output folder of a sweep.

        Yields
        ------
        ResultStore
            The store; it is closed at the end of the block.

        Raises
        ------
        StoreError
            If there is no store, or it has another format.
        """
        file = Path(folder) / STORE_NAME
        if not file.is_file():
            raise StoreError(f"{folder}: holds no {STORE_NAME}; give the folder of a sweep.")
        with connected(file) as connection:
            check_format(connection, file)
            yield cls(file, connection)

    @classmethod
    @contextmanager
    def writing(
        cls, folder: str | Path, design: SweepDesign, *, is_fresh: bool = False
    ) -> Iterator["ResultStore"]:
        """Open a store to add rows, making it when there is none.

        Parameters
        ----------
        folder : str or Path
            Output folder; it is made.
        design : SweepDesign
            What a new store is for.
        is_fresh : bool, optional
            Whether to discard a store that is there.

        Yields
        ------
        ResultStore
            The store; it is closed at the end of the block.

        Raises
        ------
        StoreError
            If the folder cannot be written, another sweep writes here, or another version or
            program made the store.
        """
        file = Path(folder) / STORE_NAME
        with locked_folder(Path(folder)):
            if is_fresh:
                discard(file)
            with connected(file) as connection:
                notes = {"design": design.to_json(), "version": __version__}
                create_if_new(connection, file, notes)
                check_format(connection, file)
                store = cls(file, connection)
                store.refuse_other_version()
                yield store

    @property
    def design(self) -> SweepDesign:
        """The design that the rows belong to."""
        try:
            return SweepDesign.from_json(self._note("design"))
        except ValueError:
            raise not_a_store(self.file) from None

    @property
    def version(self) -> str:
        """Version of the package that made the rows."""
        return self._note("version")

    def refuse_other_version(self) -> None:
        """Refuse to add rows beside those of another version of the package."""
        if self.version != __version__:
            raise StoreError(
                f"{self.file}: its rows were made by pyomo_quad {self.version}, this is "
                f"{__version__}; use that version, choose another --out, or start anew with "
                f"--fresh."
            )

    def replace_design(self, design: SweepDesign) -> None:
        """Note that the rows belong to another design that holds all their cases.

        Parameters
        ----------
        design : SweepDesign
            The new design.
        """
        with self._connection:
            self._connection.execute(
                "UPDATE sweep SET value = ? WHERE name = 'design'", (design.to_json(),)
            )

    def keys(self) -> set[str]:
        """Return the keys of all cases that have a row."""
        return {key for (key,) in self._connection.execute("SELECT case_key FROM case_row")}

    def rows(self) -> dict[str, StoredCase]:
        """Return all rows by their key."""
        query = "SELECT case_key, status, reason, outputs, seconds FROM case_row"
        return {
            key: StoredCase(
                key=key,
                status=CaseStatus(status),
                reason=reason,
                outputs=json.loads(outputs),
                seconds=seconds,
            )
            for key, status, reason, outputs, seconds in self._connection.execute(query)
        }

    def add(
        self, outcome: CaseOutcome, overrides: Mapping[str, Any], *, is_parent: bool, spent: str
    ) -> None:
        """Commit the row of a finished case.

        Parameters
        ----------
        outcome : CaseOutcome
            The row.
        overrides : mapping
            Scenario field -> value.
        is_parent : bool
            Whether cases still to come start from this one.
        spent : str
            Key of a case whose warm start no case needs any more, empty for none.

        Raises
        ------
        StoreError
            If the disk is full or the file has gone.
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
                self._connection.execute("INSERT INTO case_row VALUES (?,?,?,?,?,?,?,?)", row)
                if is_parent:
                    self._connection.execute(
                        "INSERT INTO warm_start VALUES (?,?)", (outcome.key, outcome.warm_start)
                    )
                self._connection.execute("DELETE FROM warm_start WHERE case_key = ?", (spent,))
        except sqlite3.DatabaseError as error:
            raise StoreError(
                f"{self.file}: cannot be written ({error}); finished cases are kept; free the "
                f"place and run the same command again."
            ) from error

    def warm_start(self, key: str) -> bytes | None:
        """Return what a finished case left for its children.

        Parameters
        ----------
        key : str
            Key of the parent.

        Returns
        -------
        bytes or None
            None when it left nothing.
        """
        query = "SELECT arrays FROM warm_start WHERE case_key = ?"
        found = self._connection.execute(query, (key,)).fetchone()
        return found[0] if found is not None else None

    def _note(self, name: str) -> str:
        query = "SELECT value FROM sweep WHERE name = ?"
        try:
            found = self._connection.execute(query, (name,)).fetchone()
        except sqlite3.DatabaseError:
            raise not_a_store(self.file) from None
        if found is None:
            raise not_a_store(self.file)
        return str(found[0])
