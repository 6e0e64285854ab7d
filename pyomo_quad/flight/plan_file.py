"""The file of a plan: NumPy arrays beside one JSON text, with nothing pickled in it.

What is read may come from a stranger: every field is checked before a plan is made of it.
"""

from __future__ import annotations

from collections.abc import Mapping  # noqa: TC003  read by pydantic
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any, BinaryIO, Final, Literal, NoReturn
from zipfile import ZipFile

import numpy as np
from pydantic import AllowInfNan, ConfigDict, ValidationError

from pyomo_quad.collocation import (
    Mesh,
    MeshRecord,
    TranscriptionError,
    WarmStart,
    real_array,
)
from pyomo_quad.flight.trajectories import Trajectories
from pyomo_quad.flight.verification import Verification  # noqa: TC001  read by pydantic
from pyomo_quad.scenario import Scenario, ScenarioError
from pyomo_quad.scenario.complaint import complaint, printable
from pyomo_quad.scenario.errors import PyomoQuadError
from pyomo_quad.scenario.fields import Part

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

__all__ = ["PlanRecord", "PlanStatus", "read_plan_file", "write_plan_file"]

_FORMAT: Final = 2
_ABOUT = "about"
_LARGEST_FILE = 256 * 1024 * 1024
_ARRAYS = ("states", "controls", "energy", "costates", "hamiltonian")
_MESH = ("breakpoints", "degrees")
_WARM_START = "warm_start."


class PlanStatus(StrEnum):
    """What became of a plan; only `VERIFIED` is proven by a flight."""

    VERIFIED = "verified"
    SOLVED = "solved"
    NOT_CONVERGED = "not_converged"
    INFEASIBLE = "infeasible"
    INTERRUPTED = "interrupted"


# A solve that failed may leave an error that is infinite.
_Error = Annotated[float, AllowInfNan()]


class PlanRecord(Part):
    """What a plan's file says beside its arrays."""

    status: PlanStatus
    message: str
    energy: float
    hover_energy_J: float
    error_estimate: _Error
    verification: Verification | None
    history: tuple[MeshRecord, ...]
    attempts: tuple[str, ...]
    timings: Mapping[str, float]


class _About(Part):
    """The JSON of a plan's file."""

    model_config = ConfigDict(ser_json_inf_nan="constants")

    format: Literal[2]
    scenario: dict[str, Any]
    plan: PlanRecord
    horizon: tuple[float, float]
    state_names: tuple[str, ...]
    control_names: tuple[str, ...]
    costate_names: tuple[str, ...]


def write_plan_file(
    path: Path,
    scenario: Scenario,
    record: PlanRecord,
    trajectories: Trajectories,
    warm_start: WarmStart | None,
) -> None:
    """Write a plan's description and arrays; a warm start only if all of it are numbers."""
    about = _About(
        format=_FORMAT,
        scenario=scenario.model_dump(mode="json"),
        plan=record,
        horizon=trajectories.horizon,
        state_names=trajectories.state_names,
        control_names=trajectories.control_names,
        costate_names=trajectories.costate_names,
    )
    arrays = {
        "breakpoints": np.asarray(trajectories.mesh.breakpoints),
        "degrees": np.asarray(trajectories.mesh.degrees),
        **{name: getattr(trajectories, name) for name in _ARRAYS},
    }
    if warm_start is not None and warm_start.is_finite:
        arrays |= {f"{_WARM_START}{name}": held for name, held in warm_start.arrays().items()}
    text = about.model_dump_json()
    with path.open("wb") as file:
        np.savez_compressed(
            file, allow_pickle=False, **arrays, about=np.frombuffer(text.encode(), dtype=np.uint8)
        )


def read_plan_file(path: Path) -> tuple[Scenario, PlanRecord, Trajectories, WarmStart | None]:
    """Return a plan's description and arrays.

    Raises
    ------
    ScenarioError
        If the file is missing, too large, or not a plan of this version.
    """
    try:
        with path.open("rb") as file:
            arrays = _read_arrays(path, file)
        text = arrays.pop(_ABOUT)
    except ScenarioError:
        raise
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read ({error.strerror or error}).") from None
    except Exception as error:
        # A damaged archive fails in as many ways as zip and npy readers have.
        raise ScenarioError(_not_a_plan(path)) from error
    try:
        about = _read_about(path, text)
        scenario = _read_scenario(path, about)
        return scenario, about.plan, _trajectories(about, arrays), _warm_start(arrays)
    except TranscriptionError as error:
        _refuse(path, str(error))


def _read_arrays(path: Path, file: BinaryIO) -> dict[str, NDArray[Any]]:
    with ZipFile(file) as archive:
        # What the archive claims to unpack to: a small file can hold a flood.
        size = sum(part.file_size for part in archive.infolist())
    if size > _LARGEST_FILE:
        raise ScenarioError(f"{path}: holds more than {_LARGEST_FILE} bytes; not a plan.")
    file.seek(0)
    with np.load(file, allow_pickle=False) as held:
        return {name: held[name] for name in held.files}


def _read_about(path: Path, text: NDArray[Any]) -> _About:
    if text.dtype != np.uint8 or text.ndim != 1:
        raise ScenarioError(_not_a_plan(path))
    try:
        about = _About.model_validate_json(text.tobytes(), strict=True)
    except ValidationError as error:
        found, line = complaint(error, _About)
        if found in {(), ("format",)}:
            raise ScenarioError(_not_a_plan(path)) from None
        _refuse(path, line)
    plan, (start, end) = about.plan, about.horizon
    numbers = [plan.error_estimate, *(record.objective for record in plan.history)]
    numbers += [record.error for record in plan.history]
    if np.any(np.isnan(numbers)):
        _refuse(path, "error_estimate and history hold a NaN.")
    if not start < end:
        _refuse(path, f"horizon = [{start:g}, {end:g}] s; must end after it starts.")
    is_proven = plan.verification is not None and plan.verification.is_verified
    if plan.status is PlanStatus.VERIFIED and not is_proven:
        _refuse(path, "status = verified, but its verification says otherwise.")
    for field, names in (
        ("state_names", about.state_names),
        ("control_names", about.control_names),
    ):
        if len(set(names)) != len(names) or not names:
            _refuse(path, f"{field}: must be names, each given once.")
    if set(about.costate_names) - set(about.state_names):
        _refuse(path, "costate_names: must be names of states.")
    return about


def _read_scenario(path: Path, about: _About) -> Scenario:
    try:
        return Scenario.model_validate(about.scenario)
    except ValidationError as error:
        _refuse(path, f"scenario: {complaint(error, Scenario)[1]}")
    except PyomoQuadError as error:
        _refuse(path, f"scenario: {error}")


def _trajectories(about: _About, arrays: dict[str, NDArray[Any]]) -> Trajectories:
    unknown = [
        name
        for name in arrays
        if name not in {*_ARRAYS, *_MESH} and not name.startswith(_WARM_START)
    ]
    if unknown:
        raise TranscriptionError(f"{printable(unknown[0])}: is no array of a plan.")
    mesh = Mesh.from_arrays(arrays)
    points = mesh.points
    shapes = {
        "states": (points + 1, len(about.state_names)),
        "controls": (points, len(about.control_names)),
        "energy": (points + 1,),
        "costates": (points, len(about.costate_names)),
        "hamiltonian": (points,),
    }
    return Trajectories(
        mesh=mesh,
        horizon=about.horizon,
        state_names=about.state_names,
        control_names=about.control_names,
        costate_names=about.costate_names,
        **{name: real_array(arrays, name, shape) for name, shape in shapes.items()},
    )


def _warm_start(arrays: dict[str, NDArray[Any]]) -> WarmStart | None:
    held = {
        name.removeprefix(_WARM_START): array
        for name, array in arrays.items()
        if name.startswith(_WARM_START)
    }
    try:
        return WarmStart.from_arrays(held) if held else None
    except TranscriptionError as error:
        raise TranscriptionError(f"{_WARM_START}{error}") from None


def _refuse(path: Path, line: str) -> NoReturn:
    raise ScenarioError(f"{path}: {line} Solve the scenario again to have its plan.") from None


def _not_a_plan(path: Path) -> str:
    return f"{path}: is not a plan written by Plan.save of this version."
