"""Output folders that appear whole or not at all.

All files of a run are written into a hidden sibling of the final folder, on the same file
system.  Only when the run has ended well does the sibling take the final name:

1. Nothing there yet: one rename.
2. An older report is there, and the system can exchange two names in one step (Linux): the two
   are exchanged and the old one, now under the hidden name, is deleted.  The final name always
   leads to a whole report, whenever the process is killed.
3. Otherwise: the new folder is first renamed to ``.NAME.ready``, which declares it whole; then the
   old one is deleted and the new one takes the name.  A run killed in between leaves the whole
   new report under the hidden name, and the next run to the same folder starts by finishing the
   swap.

A lock file, held by `flock` and so released by the kernel with its process, keeps two runs from
writing to one folder.  A manifest lists the files written, so that a folder holding anything else
is never replaced.
"""

import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

from pyomo_quad.report.exchange import exchange_folders
from pyomo_quad.scenario.errors import OutputError

__all__ = ["MANIFEST_NAME", "output_folder", "recover_folder"]

MANIFEST_NAME = ".pyomo_quad_files"


@contextmanager
def output_folder(path: str | Path) -> Iterator[Path]:
    """Give a folder to write into that takes its place when the block ends well.

    Parameters
    ----------
    path : str or Path
        The final folder; its parents are made.

    Yields
    ------
    Path
        An empty folder beside the final one.  If the block raises, it vanishes and the final
        folder stays as it was.

    Raises
    ------
    OutputError
        If the folder cannot be written, is full, is in use by another run, or holds files that
        no run wrote.
    """
    final = Path(path).resolve()
    aside = _hidden(final, f"new-{os.getpid()}")
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        with _lock(final, path):
            try:
                _finish_swap(final)
                _remove_leftovers(final)
                _refuse_foreign_files(final, path)
                aside.mkdir()
                yield aside
                _write_manifest(aside)
                _swap(aside, final)
            finally:
                shutil.rmtree(aside, ignore_errors=True)
    except OSError as error:
        _refuse(path, error)


def recover_folder(path: str | Path) -> None:
    """Finish a swap that a killed run left half done.

    Parameters
    ----------
    path : str or Path
        The final folder, about to be read.

    Raises
    ------
    OutputError
        If the swap cannot be finished.
    """
    final = Path(path).resolve()
    if not _hidden(final, "ready").exists():
        return
    try:
        with _lock(final, path):
            _finish_swap(final)
    except OSError as error:
        _refuse(path, error)


def _hidden(final: Path, suffix: str) -> Path:
    return final.with_name(f".{final.name}.{suffix}")


@contextmanager
def _lock(final: Path, path: str | Path) -> Iterator[None]:
    file = _hidden(final, "lock")
    while True:
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # The run that held the lock removes the file; a lock on a removed file locks nothing.
            if file.exists() and file.stat().st_ino == os.fstat(descriptor).st_ino:
                break
        except BlockingIOError:
            os.close(descriptor)
            raise OutputError(
                f"{path}: another run is writing here; wait for it or choose another --out."
            ) from None
        os.close(descriptor)
    try:
        yield
    finally:
        file.unlink(missing_ok=True)
        os.close(descriptor)


def _swap(aside: Path, final: Path) -> None:
    if not final.exists():
        aside.rename(final)
    elif not exchange_folders(aside, final):
        aside.rename(_hidden(final, "ready"))
        _finish_swap(final)


def _finish_swap(final: Path) -> None:
    ready = _hidden(final, "ready")
    if ready.exists():
        if final.exists():
            shutil.rmtree(final)
        ready.rename(final)


def _remove_leftovers(final: Path) -> None:
    # The lock is held: whoever made these is no longer running.
    prefix = _hidden(final, "new-").name
    for entry in final.parent.iterdir():
        if entry.name.startswith(prefix):
            shutil.rmtree(entry)


def _files(folder: Path) -> Iterator[str]:
    return (str(file.relative_to(folder)) for file in folder.rglob("*") if not file.is_dir())


def _write_manifest(folder: Path) -> None:
    names = sorted(_files(folder))
    (folder / MANIFEST_NAME).write_text("".join(f"{name}\n" for name in names), encoding="utf-8")


def _refuse_foreign_files(final: Path, path: str | Path) -> None:
    if not final.exists():
        return
    if not final.is_dir():
        raise OutputError(f"{path}: is a file; choose a folder for --out.")
    manifest = final / MANIFEST_NAME
    known = set(manifest.read_text(encoding="utf-8").splitlines()) if manifest.exists() else set()
    foreign = next((name for name in _files(final) if name not in {*known, MANIFEST_NAME}), None)
    if foreign is not None:
        raise OutputError(
            f"{path}: holds {foreign!r}, which no run wrote; move it away or choose another --out."
        )


def _refuse(path: str | Path, error: OSError) -> NoReturn:
    reason = error.strerror or str(error)
    raise OutputError(
        f"{path}: cannot be written ({reason}); free the place or choose another --out."
    ) from error
