"""From a study file to a design: axis values drawn, grouped, and checked against the scenario."""

from collections.abc import Iterator, Mapping
from math import prod
from typing import Any

from pyomo_quad.scenario.complaint import shown
from pyomo_quad.scenario.errors import FeasibilityError
from pyomo_quad.scenario.schema import Scenario
from pyomo_quad.scenario.tree import parse_path
from pyomo_quad.study.sweep.axes import Axis
from pyomo_quad.study.sweep.design import MOST_CASES, Dimension, SweepDesign
from pyomo_quad.study.sweep.errors import StudyError
from pyomo_quad.study.sweep.study_file import LoadedStudy, Study

__all__ = ["CASE_LIMIT", "design_sweep"]

# More cases than this are more often a slip of the pen than a wish.
CASE_LIMIT = 1_000


def design_sweep(loaded: LoadedStudy, *, is_large_allowed: bool = False) -> SweepDesign:
    """Spell out and check the axes of a study.

    Parameters
    ----------
    loaded : LoadedStudy
        The study and its base scenario.
    is_large_allowed : bool, optional
        Whether more than `CASE_LIMIT` cases are meant.

    Returns
    -------
    SweepDesign
        Every axis value is allowed by the scenario's schema.

    Raises
    ------
    StudyError
        If axes contradict each other, or there are too many cases.
    ScenarioError
        If a path is unknown or a value is out of the field's range.
    """
    study, source = loaded.study, loaded.source
    _check_paths(study, source)
    _refuse_own_model(loaded)
    _check_size(_case_count(study, source), source, is_large_allowed=is_large_allowed)
    dimensions = tuple(_dimensions(study, loaded.base))
    for dimension in dimensions:
        _check_steps(dimension, loaded.base, source)
    return SweepDesign(
        name=study.name,
        title=study.title,
        about=study.about,
        task=study.task,
        baselines=study.baselines,
        outputs=study.outputs,
        report_on=study.report_on,
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
            f"take fewer values, or say --yes if they are meant."
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
    """Give a number the type of its field, so that 10.0 serves where 10 elements are meant."""
    present: Any = tables
    for step in parse_path(path) or ():
        is_inside = isinstance(present, Mapping | list | tuple)
        try:
            present = present[step] if is_inside else None
        except (LookupError, TypeError):
            return value
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
            # Whether the vehicle can hover is a result of the case: its row will say so.
            continue
