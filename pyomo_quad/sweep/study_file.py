"""Study file of a parameter sweep: its schema, its loading and the sweep design made from it.

A study file (TOML) names a base scenario, the axes of the sweep, and the output columns to keep and
report. An axis is a scenario field that the sweep varies, with the values that the field takes. The
study file may give these values as a range or a distribution. The design made from it holds each
single value of all axes and the complete base scenario.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from enum import StrEnum
from math import prod
from pathlib import Path as FilePath
from typing import Any, Self, TypeVar

import numpy as np
from pydantic import BaseModel, ValidationError, model_validator

from pyomo_quad.scenario.fields import (
    FieldPath,
    Part,
    Text,
    WholeNumber,
    parse_path,
    quantity,
    value_at,
)
from pyomo_quad.scenario.loader import assignments_of
from pyomo_quad.scenario.messages import (
    FeasibilityError,
    ScenarioError,
    complaints,
    listed,
    shown,
)
from pyomo_quad.scenario.resolution import ScenarioSource, read_toml
from pyomo_quad.scenario.schema import Scenario
from pyomo_quad.scenario.tables import Reference
from pyomo_quad.sweep.case import StudyTask, output_columns, unknown_column
from pyomo_quad.sweep.design import MOST_CASES, Axis, Dimension, SweepDesign

_MOST_SAMPLES = 100_000


class StudyError(ScenarioError):
    """Error: a study file of a sweep has a value that is not allowed."""


class SamplingMethod(StrEnum):
    """Method of drawing values of a sweep's random fields: independently, or a Latin hypercube."""

    RANDOM = "random"
    LATIN_HYPERCUBE = "latin_hypercube"


class Sampling(Part):
    """Number, random seed and method of the samples of a sweep's random fields."""

    count: WholeNumber = quantity("1", "number of samples", ge=1, le=_MOST_SAMPLES)
    seed: WholeNumber = quantity("1", "seed of the generator", ge=0)
    method: SamplingMethod = quantity(
        "", "random or latin_hypercube", SamplingMethod.LATIN_HYPERCUBE
    )

    def draw(self, axis_count: int) -> np.ndarray:
        """Draw random points in the unit cube, strictly between 0 and 1, shape (count, axis_count).

        Each coordinate is a probability: the field takes the quantile of its distribution there.
        Each call gives the same points.
        """
        generator = np.random.default_rng(self.seed)
        if self.method is SamplingMethod.RANDOM:
            # A larger number of samples keeps the previous points. A Latin hypercube changes all.
            draws = 1.0 - generator.random((self.count, axis_count))
        else:
            from scipy.stats import qmc  # noqa: PLC0415  takes half a second

            draws = qmc.LatinHypercube(axis_count, seed=generator).random(self.count)
        # At 0 and 1 a normal distribution has no finite value.
        return np.clip(draws, np.nextafter(0.0, 1.0), np.nextafter(1.0, 0.0))


_NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"
_MOST_AXES = 20
_Table = TypeVar("_Table", bound=BaseModel)
_DEFAULT_QUANTITY = "energy_J"


class Study(Part):
    """Content of a study file, which describes a parameter sweep."""

    name: Text = quantity("", "short name, also of the output folder", pattern=_NAME_PATTERN)
    title: Text = quantity("", "title of the report", "", max_length=200)
    about: Text = quantity("", "first paragraph of the report", "", max_length=1000)
    scenario: Text = quantity("", "scenario file of the base case, beside the study", min_length=1)
    task: StudyTask = quantity(
        "",
        "optimise: a plan for each case; fly_plan: the controller flies the base case's plan",
        StudyTask.OPTIMISE,
    )
    baselines: tuple[Reference, ...] = quantity(
        "", "references that the controller flies in each case", (), max_length=len(Reference)
    )
    outputs: tuple[Text, ...] = quantity(
        "", "columns kept in the tables, all when absent", (), max_length=100
    )
    report_on: tuple[Text, ...] = quantity(
        "", "columns that the report draws", (_DEFAULT_QUANTITY,), min_length=1, max_length=10
    )
    fixed: dict[str, Any] = quantity("", "fields changed in the base scenario", {})
    sampling: Sampling | None = quantity("", "how random axes are drawn", None)
    axis: tuple[Axis, ...] = quantity("", "what varies", min_length=1, max_length=_MOST_AXES)

    @model_validator(mode="after")
    def _baselines_take_the_missions_time(self) -> Self:
        if Reference.CRUISE in self.baselines:
            raise ValueError(
                "baselines has cruise, which keeps its own time; must be flights of the mission's "
                "time; leave it out"
            )
        return self


@dataclass(frozen=True, kw_only=True)
class LoadedStudy:
    """Validated content of a study file, with the base scenario that the file names.

    Attributes
    ----------
    source : str
        Name of the study file, for messages.
    study : Study
        Content of the file.
    base : Scenario
        The base scenario. Values in the study file's table ``fixed`` replace the values in the
        scenario file.
    """

    source: str
    study: Study
    base: Scenario


def load_study(path: str | FilePath) -> LoadedStudy:
    """Read and validate a study file of a sweep and the base scenario that it names.

    Parameters
    ----------
    path : str or Path
        Study file (TOML). It gives the path of the base scenario relative to the folder of the
        study file.

    Returns
    -------
    LoadedStudy
        Study and base scenario, for `design_sweep`.

    Raises
    ------
    StudyError
        If a field of the study file has a value that is not allowed.
    ScenarioError
        If a file cannot be read, or a field of the base scenario is not allowed.

    Examples
    --------
    >>> loaded = load_study("hop_study.toml")
    >>> loaded.study.name, loaded.base.name
    ('hop_study', 'hop')
    """
    source = str(path)
    document = read_toml(FilePath(path))
    # The axes are validated one by one before the whole study, so that a misspelt key of an axis is
    # compared with the keys of an axis.
    listed = document.get("axis")
    for index, table in enumerate(listed if isinstance(listed, list) else []):
        _validate(Axis, table, source, ("axis", index))
    study = _validate(Study, document, source)
    _check_random_axes(study, source)
    _check_columns(study, source)
    return LoadedStudy(source=source, study=study, base=_base_scenario(study, FilePath(path)))


def _validate(model: type[_Table], tables: object, source: str, place: FieldPath = ()) -> _Table:
    try:
        return model.model_validate(tables)
    except ValidationError as error:
        found = complaints(error, model, place)
        raise StudyError(listed([f"{source}: {line}" for _, line in found])) from None


def _check_random_axes(study: Study, source: str) -> None:
    random_axes = [axis.path for axis in study.axis if axis.is_random]
    if random_axes and study.sampling is None:
        raise StudyError(
            f"{source}: axis {shown(random_axes[0])} is random; add a table [sampling] with "
            f"count and seed."
        )
    if study.sampling is not None and not random_axes:
        raise StudyError(f"{source}: [sampling] is given, but no axis is random; remove it.")


def _check_columns(study: Study, source: str) -> None:
    if study.baselines and study.task is not StudyTask.OPTIMISE:
        raise StudyError(
            f'{source}: baselines are flown beside a plan, and task = "{study.task}" makes none '
            f'for a case; remove baselines, or give task = "{StudyTask.OPTIMISE}".'
        )
    for name in ("baselines", "outputs", "report_on"):
        given = getattr(study, name)
        for index, entry in enumerate(given):
            if entry in given[:index]:
                raise StudyError(f"{source}: {name}[{index}] repeats {shown(entry)}; give it once.")
    for name in ("outputs", "report_on"):
        wrong = unknown_column(getattr(study, name), study.task, study.baselines)
        if wrong is not None:
            known = output_columns(study.task, study.baselines)
            near = get_close_matches(wrong, known, n=1)
            hint = f"did you mean {near[0]}?" if near else f"the outputs are {', '.join(known)}."
            raise StudyError(f"{source}: {name}: no output is called {shown(wrong)}; {hint}")


def _base_scenario(study: Study, file: FilePath) -> Scenario:
    scenario_file = file.parent / study.scenario
    source = str(file)
    return Scenario.from_origin(
        ScenarioSource(
            source=str(scenario_file),
            folder=scenario_file.parent,
            document=read_toml(scenario_file),
            assignments=assignments_of(study.fixed, f"{source}: fixed"),
            label=source,
        )
    )


# A study with more cases needs the option --yes, because it is more often a mistake than intended.
CASE_LIMIT = 1_000


def design_sweep(loaded: LoadedStudy, *, is_large_allowed: bool = False) -> SweepDesign:
    """Compute the values of all axes of a study, check them, and return the sweep's design.

    Parameters
    ----------
    loaded : LoadedStudy
        Study file and base scenario, from `load_study`.
    is_large_allowed : bool, default False
        Whether the sweep may have more cases than the constant `CASE_LIMIT`. The limit guards
        against sweeps that are large by mistake.

    Returns
    -------
    SweepDesign
        Specification of the sweep, from which all its cases follow.

    Raises
    ------
    StudyError
        If two axes set the same field, a value occurs twice, there are too many cases, or axes that
        change together have different numbers of values. StudyError is also raised if the scenario
        names the user's own Pyomo model (field `model`), which a sweep does not run.
    ScenarioError
        If an axis names an unknown field, or has a value that the field does not allow. Values with
        which the vehicle cannot hover are no error here: the case fails later.

    Examples
    --------
    >>> design = design_sweep(load_study("hop_study.toml"))
    >>> design.paths
    ('mission.duration',)
    """
    study, source = loaded.study, loaded.source
    _check_paths(study, source)
    _refuse_own_model(loaded)
    _check_size(_case_count(study, source), source, is_large_allowed=is_large_allowed)
    dimensions = tuple(_dimensions(study, loaded.base))
    for dimension in dimensions:
        _check_steps(dimension, loaded.base, source)
    kept = ("name", "title", "about", "task", "baselines", "outputs", "report_on")
    return SweepDesign(
        **{name: getattr(study, name) for name in kept},
        base=loaded.base.model_dump(mode="json"),
        dimensions=dimensions,
    )


def _check_paths(study: Study, source: str) -> None:
    seen: list[tuple[str | int, ...]] = []
    for axis in study.axis:
        path = parse_path(axis.path)
        if path is None:
            raise StudyError(
                f"{source}: axis {shown(axis.path)} is not the path of a scenario field."
            )
        for other in seen:
            shared = min(len(path), len(other))
            if path[:shared] == other[:shared]:
                raise StudyError(
                    f"{source}: axis {shown(axis.path)} sets what another axis sets already; "
                    f"keep one of them."
                )
        seen.append(path)


def _refuse_own_model(loaded: LoadedStudy) -> None:
    if loaded.base.model is not None or any(axis.path == "model" for axis in loaded.study.axis):
        raise StudyError(
            f"{loaded.source}: the scenario names a model builder of its own, which a sweep does "
            f"not run; remove the field model."
        )


def _groups(study: Study) -> dict[str, list[Axis]]:
    groups: dict[str, list[Axis]] = {}
    for axis in study.axis:
        name = "random" if axis.is_random else f"group {axis.group}" if axis.group else axis.path
        groups.setdefault(name, []).append(axis)
    return groups


def _case_count(study: Study, source: str) -> int:
    counts = []
    for axes in _groups(study).values():
        if axes[0].is_random:
            counts.append(study.sampling.count if study.sampling is not None else 0)
            continue
        lengths = {axis.count for axis in axes}
        if len(lengths) > 1:
            raise StudyError(
                f"{source}: axes of group {shown(axes[0].group)} have "
                f"{' and '.join(str(axis.count) for axis in axes)} values; "
                f"give each the same number."
            )
        counts.append(lengths.pop())
    return prod(counts)


def _check_size(count: int, source: str, *, is_large_allowed: bool) -> None:
    if count > MOST_CASES:
        raise StudyError(
            f"{source}: the axes make {count} cases, at most {MOST_CASES} are allowed; "
            f"take fewer values."
        )
    if count > CASE_LIMIT and not is_large_allowed:
        raise StudyError(
            f"{source}: the axes make {count} cases, more than {CASE_LIMIT}; "
            f"take fewer values, or give --yes if so many are intended."
        )


def _dimensions(study: Study, base: Scenario) -> Iterator[Dimension]:
    tables = base.model_dump()
    for axes in _groups(study).values():
        if axes[0].is_random and study.sampling is not None:
            draws = study.sampling.draw(len(axes))
            columns = [axis.drawn_values(draws[:, index]) for index, axis in enumerate(axes)]
        else:
            columns = [axis.spaced_values() for axis in axes]
        matched = [
            [_as_field_type(value, tables, axis.path) for value in column]
            for axis, column in zip(axes, columns, strict=True)
        ]
        yield Dimension(
            paths=tuple(axis.path for axis in axes),
            steps=tuple(zip(*matched, strict=True)),
            is_random=axes[0].is_random,
        )


def _as_field_type(value: object, tables: Mapping[str, Any], path: str) -> Any:  # noqa: ANN401
    """Convert a number to its field's type, so that 10.0 is accepted for an integer field.

    The type is that of the field's value in `tables`, the base scenario as nested mappings. A value
    without an exact conversion is returned unchanged.
    """
    present = value_at(tables, *(parse_path(path) or ()))
    if isinstance(present, bool) or isinstance(value, bool):
        return value
    if isinstance(present, float) and isinstance(value, int):
        return float(value)
    if isinstance(present, int) and isinstance(value, float) and value.is_integer():
        return int(value)
    return value


def _check_steps(dimension: Dimension, base: Scenario, source: str) -> None:
    seen = set()
    for step in dimension.steps:
        spelled = repr(step)
        if spelled in seen:
            raise StudyError(
                f"{source}: axis {dimension.paths[0]} repeats {shown(step[0])}; give it once."
            )
        seen.add(spelled)
        try:
            base.with_values(dict(zip(dimension.paths, step, strict=True)))
        except FeasibilityError:
            # A vehicle that cannot hover is a result, not an error: the case's row reports it.
            continue
