"""The file of a plan: NumPy arrays beside one JSON text, with nothing pickled in it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, BinaryIO
from zipfile import ZipFile

import numpy as np

from pyomo_quad.scenario import ScenarioError

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

__all__ = ["not_a_plan", "read_plan_file", "write_plan_file"]

_FORMAT = 1
_ABOUT = "about"
_LARGEST_FILE = 256 * 1024 * 1024


def write_plan_file(path: Path, about: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
    """Write a plan's description and arrays."""
    text = json.dumps(about | {"format": _FORMAT})
    with path.open("wb") as file:
        np.savez_compressed(
            file, allow_pickle=False, **arrays, about=np.frombuffer(text.encode(), dtype=np.uint8)
        )


def read_plan_file(path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return a plan's description and arrays.

    Raises
    ------
    ScenarioError
        If the file is missing, too large, or not a plan of this version.
    """
    try:
        with path.open("rb") as file:
            arrays = _read_arrays(path, file)
        return _about(path, arrays.pop(_ABOUT)), arrays
    except ScenarioError:
        raise
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read ({error.strerror or error}).") from None
    except Exception as error:
        # A damaged archive fails in as many ways as zip, npy and JSON readers have.
        raise not_a_plan(path) from error


def _about(path: Path, text: NDArray[Any]) -> dict[str, Any]:
    about: dict[str, Any] = json.loads(text.tobytes().decode())
    if about["format"] != _FORMAT:
        raise not_a_plan(path)
    return about


def _read_arrays(path: Path, file: BinaryIO) -> dict[str, NDArray[Any]]:
    with ZipFile(file) as archive:
        # What the archive claims to unpack to: a small file can hold a flood.
        size = sum(part.file_size for part in archive.infolist())
    if size > _LARGEST_FILE:
        raise ScenarioError(f"{path}: holds more than {_LARGEST_FILE} bytes; not a plan.")
    file.seek(0)
    with np.load(file, allow_pickle=False) as held:
        return {name: held[name] for name in held.files}


def not_a_plan(path: Path) -> ScenarioError:
    """Return the complaint about a file that holds something else."""
    return ScenarioError(f"{path}: is not a plan written by Plan.save of this version.")
