"""Output folders and files that appear complete, or not at all if the program is interrupted.

Output is written under a temporary name beside the final path, and renamed at the end. Only folders
and files that this package wrote are replaced.
"""

import errno
import fcntl
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NoReturn

from pyomo_quad.scenario.messages import OutputError

MANIFEST_NAME = ".pyomo_quad_files"

# Temporary files and folders of this process that are not finished yet.
_unfinished: set[Path] = set()


@contextmanager
def output_folder(path: str | Path) -> Iterator[Path]:
    """Context manager: write an output folder that appears complete or not at all.

    The `with` block receives a temporary folder. At the end of the block, this folder replaces the
    final folder at `path`. Raises OutputError for an OSError, for files that this package did not
    write, and if another run is writing the folder.
    """
    final = final_folder(path)
    aside = _hidden(final, f"new-{os.getpid()}")
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        with _lock(final, path):
            _finish_swap(final, path, aside)
            _remove_leftovers(final)
            _refuse_foreign_files(final, path)
            with _until_finished(_unused(aside)):
                aside.mkdir()
                (aside / MANIFEST_NAME).touch()
                yield aside
                _write_manifest(aside)
                aside.rename(_hidden(final, "ready") if final.exists() else final)
                _finish_swap(final, path, aside)
    except OSError as error:
        _refuse(path, error)


#: Text in each output file, by which a later command recognises a file that it may replace.
MARK = "Written by pyomo_quad"
# The mark is searched for within this distance of either end: a PDF names its creator last.
_MARKED_WITHIN_BYTES = 65_536


@contextmanager
def output_file(path: str | Path, mark: str = MARK) -> Iterator[Path]:
    """Context manager: write an output file that appears complete or not at all.

    The `with` block receives the path of a temporary file. The caller must write this file, with
    the text `mark` in the first or last 64 KiB. At the end of the block, it replaces the file at
    `path`. An existing file is replaced only if it is empty, or has `mark` in the same parts.
    Otherwise, or for an OSError, OutputError is raised.
    """
    final = final_folder(path)
    try:
        # The content is copied to a character device or FIFO, such as /dev/stdout.
        if _is_stream(path):
            folder = Path(tempfile.mkdtemp(prefix="pyomo_quad-"))
            with _until_finished(folder):
                yield folder / final.name
                _copy(folder / final.name, path)
            return
        aside = _hidden(final, f"new-{os.getpid()}")
        _refuse_foreign_file(final, path, mark)
        final.parent.mkdir(parents=True, exist_ok=True)
        with _until_finished(aside):
            yield aside
            _refuse_foreign_file(final, path, mark)
            aside.replace(final)
    except OSError as error:
        _refuse(path, error)


def _is_stream(path: str | Path) -> bool:
    """Return whether a path leads to a character device or a FIFO, such as ``/dev/stdout``."""
    # The target of the link /dev/stdout cannot be opened by its name, only through the link.
    with suppress(FileNotFoundError):
        mode = os.stat(path).st_mode  # noqa: PTH116  a path may be a text
        return stat.S_ISCHR(mode) or stat.S_ISFIFO(mode)
    return False


def _copy(file: Path, stream: str | Path) -> None:
    with os.fdopen(os.open(stream, os.O_WRONLY | os.O_NOCTTY), "wb") as target:
        target.write(file.read_bytes())


def _refuse_foreign_file(final: Path, path: str | Path, mark: str) -> None:
    if not os.path.lexists(final):
        return
    if final.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not final.is_file():
        raise OutputError(f"{path}: is neither a regular file nor a stream; choose another --out.")
    if final.stat().st_size > 0 and not _is_marked(final, mark):
        raise OutputError(
            f"{path}: exists and was not written by this command; move it away or choose "
            "another --out."
        )


def _is_marked(file: Path, mark: str) -> bool:
    with file.open("rb") as stream:
        first = stream.read(_MARKED_WITHIN_BYTES)
        stream.seek(max(0, file.stat().st_size - _MARKED_WITHIN_BYTES))
        last = stream.read(_MARKED_WITHIN_BYTES)
    return any(mark.encode() in part for part in (first, last))


def refuse_output_folder(path: str | Path) -> None:
    """Raise an error if a folder cannot be used for an output; write nothing.

    Raises OutputError if the folder cannot be written, or holds files that this package did not
    write. A command thus fails before a long solve.
    """
    final = final_folder(path)
    try:
        _refuse_foreign_files(final, path)
        place = next(folder for folder in final.parents if os.path.lexists(folder))
        if not place.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        if not os.access(place, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        _refuse(path, error)


def discard_unfinished() -> None:
    """Remove the unfinished output files and folders of this process.

    The function is called before the process is terminated.
    """
    for begun in _unfinished:
        _discard(begun)


def _discard(begun: Path) -> None:
    with suppress(OSError):
        (_remove if begun.is_dir() else Path.unlink)(begun)


@contextmanager
def _until_finished(begun: Path) -> Iterator[None]:
    """Context manager: remove the temporary file or folder `begun` after the ``with`` block.

    To keep the output, the caller renames it inside the block.
    """
    # If the process is terminated inside the block, `discard_unfinished` removes `begun`.
    _unfinished.add(begun)
    try:
        yield
    finally:
        _discard(begun)
        _unfinished.discard(begun)


def final_folder(path: str | Path) -> Path:
    """Return the path of an output with all symbolic links resolved.

    Raises
    ------
    OutputError
        If the path is the root of the file system.
    """
    # Unlike `Path.resolve`, `realpath` does not raise for a loop of links; opening the path does.
    final = Path(os.path.realpath(path))
    if final == final.parent:
        raise OutputError(f"{path}: is the root of all folders; choose another --out.")
    return final


def _unused(path: Path) -> Path:
    """Return `path` unchanged; raise FileExistsError if a file or folder with this path exists."""
    if os.path.lexists(path):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
    return path


def _hidden(final: Path, suffix: str) -> Path:
    return final.with_name(f".{final.name}.{suffix}")


@contextmanager
def _lock(final: Path, path: str | Path) -> Iterator[None]:
    file = _hidden(final, "lock")
    while True:
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
        descriptor = os.open(file, flags, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # A run removes its lock file when it ends; a lock on a removed file has no effect.
            if file.exists() and file.stat().st_ino == os.fstat(descriptor).st_ino:
                break
        except BlockingIOError:
            os.close(descriptor)
            raise OutputError(
                f"{path}: another run is writing here; wait for it or choose another --out."
            ) from None
        os.close(descriptor)
    if os.fstat(descriptor).st_size > 0:
        os.close(descriptor)
        raise OutputError(
            f"{path}: needs the name {file.name!r} in the same folder; move that file away."
        )
    try:
        with _until_finished(file):
            yield
    finally:
        os.close(descriptor)


def _finish_swap(final: Path, path: str | Path, aside: Path) -> None:
    """Rename a complete output folder from its hidden name ``.NAME.ready`` to `final`.

    An old folder at `final` is first moved to `aside`. `path` is `final` as the user gave it, for
    messages. Raises OutputError if the old folder holds files that no run wrote.
    """
    ready = _hidden(final, "ready")
    # There is nothing to finish if no run has made a complete folder .NAME.ready for the folder
    # NAME.
    if not _is_of_a_run(ready):
        return
    _refuse_foreign_files(final, path)
    # A run may be killed before or between the two renamings. The next run then finishes them.
    if final.exists():
        final.rename(aside)
    ready.rename(final)


def _remove_leftovers(final: Path) -> None:
    # This process holds the lock, so that the processes that made such folders have ended.
    name = re.compile(re.escape(_hidden(final, "new-").name) + r"\d+")
    for entry in final.parent.iterdir():
        if not name.fullmatch(entry.name):
            continue
        if _is_of_a_run(entry):
            _remove(entry)
        else:
            with suppress(OSError):
                entry.rmdir()  # empty: the run was killed before it wrote a file


def _is_of_a_run(folder: Path) -> bool:
    """Return whether a run of this package made a folder: the folder then contains a manifest.

    A manifest is the hidden file in which a run lists its output files.
    """
    # A user's own files in a folder that happens to have a temporary name are thus safe.
    return not folder.is_symlink() and (folder / MANIFEST_NAME).is_file()


def _remove(folder: Path) -> None:
    """Delete an output folder; delete its manifest (the list of its files) last."""
    for entry in folder.iterdir():
        # If the deletion is interrupted, the manifest still marks the remaining files as an output.
        if entry.name == MANIFEST_NAME:
            continue
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        else:
            entry.unlink()
    shutil.rmtree(folder)


def _files(folder: Path) -> Iterator[str]:
    """Yield the relative names of all files in a folder, including links to folders.

    Raises OSError if the folder cannot be read.
    """

    def fail(error: OSError) -> NoReturn:
        raise error

    for place, folders, files in os.walk(folder, onerror=fail):
        links = (name for name in folders if os.path.islink(os.path.join(place, name)))  # noqa: PTH114, PTH118  os.walk speaks in texts
        for name in (*files, *links):
            yield str((Path(place) / name).relative_to(folder))


def _write_manifest(folder: Path) -> None:
    names = sorted(name for name in _files(folder) if name != MANIFEST_NAME)
    (folder / MANIFEST_NAME).write_text("".join(f"{name}\n" for name in names), encoding="utf-8")


def _refuse_foreign_files(final: Path, path: str | Path) -> None:
    if not final.exists():
        return
    if not final.is_dir():
        raise OutputError(f"{path}: is a file; choose a folder for --out.")
    manifest = final / MANIFEST_NAME
    listed = manifest.read_bytes() if manifest.is_file() else b""
    known = set(listed.decode("utf-8", errors="replace").splitlines())
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
