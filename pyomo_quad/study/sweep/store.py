"""The result store: an SQLite database in the output folder that loses nothing.

One process writes, the parent of the workers.  Each finished case is one committed transaction in
write-ahead mode, so a killed sweep has every case that finished, and others may read meanwhile.

Nothing in the store is executable: numbers and texts are JSON, warm starts are plain arrays.
"""

import json
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, Json, Strict, ValidationError

from pyomo_quad.scenario.complaint import shown
from pyomo_quad.study.sweep.cases import case_key, expand
from pyomo_quad.study.sweep.design import SweepDesign
from pyomo_quad.study.sweep.errors import StoreError
from pyomo_quad.study.sweep.store_file import (
    STORE_NAME,
    check_format,
    connected,
    create_if_new,
    damaged,
    discard,
    locked_folder,
    opened_to_read,
)
from pyomo_quad.study.sweep.task import LARGEST_OUTPUT, CaseOutcome, CaseStatus
from pyomo_quad.version import __version__

__all__ = ["ResultStore", "StoredCase"]


_FORGET = "DELETE FROM warm_start WHERE case_key = ?"

_Column = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,99}$")]
_Output = Annotated[float, Field(allow_inf_nan=False, ge=-LARGEST_OUTPUT, le=LARGEST_OUTPUT)]


class StoredCase(BaseModel):
    """A row of the store, as it must be whoever wrote it."""

    model_config = ConfigDict(strict=True, frozen=True)

    case_key: str
    overrides: Json[dict[str, Any]]
    status: Annotated[CaseStatus, Strict(False)]
    reason: str
    outputs: Json[dict[_Column, _Output]]
    seconds: float = Field(ge=0.0, allow_inf_nan=False)


class ResultStore:
    """The rows of one sweep."""

    def __init__(self, file: Path, connection: sqlite3.Connection) -> None:
        self.file = file
        self._connection = connection
        self.version = self._note("version")
        self._design = self._checked_design()

    @classmethod
    @contextmanager
    def reading(cls, folder: str | Path) -> Iterator["ResultStore"]:
        """Open a store to read it, also while a sweep writes, and where nothing can be written.

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
            If there is no store, or it has another format, or is damaged.
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
            with connected(file, mode="rwc") as connection:
                create_if_new(connection, {"design": design.to_json(), "version": __version__})
                check_format(connection, file)
                store = cls(file, connection)
                store.refuse_other_version()
                yield store

    @property
    def design(self) -> SweepDesign:
        """The design that the rows belong to."""
        return self._design

    def refuse_other_version(self) -> None:
        """Refuse to add rows beside those of another version of the package."""
        if self.version != __version__:
            raise StoreError(
                f"{self.file}: its rows were made by pyomo_quad {shown(self.version)[1:-1]}, this "
                f"is {__version__}; use that version, choose another --out, or start anew with "
                f"--fresh."
            )

    def replace_design(self, design: SweepDesign, *, is_extended: bool) -> None:
        """Note that the rows belong to another design that holds all their cases.

        Parameters
        ----------
        design : SweepDesign
            The new design.
        is_extended : bool
            Whether it has other axes.  Its cases then have other parents: what those left before is
            forgotten, so that no result hangs on how far the older design had come.
        """
        with self._connection:
            self._connection.execute(
                "UPDATE sweep SET value = ? WHERE name = 'design'", (design.to_json(),)
            )
            if is_extended:
                self._connection.execute("DELETE FROM warm_start")
        self._design = design

    def statuses(self) -> dict[str, CaseStatus]:
        """Return how each case that has a row ended, by its key."""
        return {key: row.status for key, row in self.rows().items()}

    def rows(self) -> dict[str, StoredCase]:
        """Return all rows by their key, each checked.

        Raises
        ------
        StoreError
            If a row is not as a sweep writes it, or is no case of the design.
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
                raise damaged(self.file, f"{where} is no case of its design")
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
        """Commit the row of a case that ended, in place of the one it may have.

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
        outdated : iterable of str
            Keys of cases whose rows are to be made again.

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
