"""The study file: a base scenario, the axes over it, and what is wanted of each case."""

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path as FilePath
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from pyomo_quad.scenario.baseline import Reference
from pyomo_quad.scenario.complaint import complaint, shown
from pyomo_quad.scenario.errors import ScenarioError
from pyomo_quad.scenario.fields import Part, Text, quantity
from pyomo_quad.scenario.loader import read_toml
from pyomo_quad.scenario.resolution import Origin
from pyomo_quad.scenario.schema import Scenario
from pyomo_quad.scenario.tree import Path, leaves, parse_path, spell
from pyomo_quad.study.sweep.axes import Axis
from pyomo_quad.study.sweep.errors import StudyError
from pyomo_quad.study.sweep.outputs import output_columns, unknown_column
from pyomo_quad.study.sweep.sampling import Sampling
from pyomo_quad.study.sweep.task import StudyTask

__all__ = ["LoadedStudy", "Study", "load_study"]

_NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"
_MOST_AXES = 20
_Table = TypeVar("_Table", bound=BaseModel)
_DEFAULT_QUANTITY = "energy_J"


class Study(Part):
    """A study as its file says it, without the axes' values."""

    name: Text = quantity("", "short name, also of the output folder", pattern=_NAME_PATTERN)
    title: Text = quantity("", "title of the report", "", max_length=200)
    about: Text = quantity("", "what the report says first", "", max_length=1000)
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


@dataclass(frozen=True, kw_only=True)
class LoadedStudy:
    """A validated study file with its base scenario.

    Attributes
    ----------
    source : str
        Name of the study file for messages.
    study : Study
        What the file says.
    base : Scenario
        The base scenario with the fixed fields set.
    """

    source: str
    study: Study
    base: Scenario


def load_study(path: str | FilePath) -> LoadedStudy:
    """Read and validate a study file and its base scenario.

    Parameters
    ----------
    path : str or Path
        A TOML file.

    Returns
    -------
    LoadedStudy
        The study; the values of its axes are not yet checked against the scenario.

    Raises
    ------
    StudyError
        If a field of the study is not allowed.
    ScenarioError
        If a file cannot be read, or the base scenario is not allowed.
    """
    source = str(path)
    document = read_toml(FilePath(path))
    # Tables in a list are checked one by one, so that a misspelt key is compared with the right
    # table's keys.
    listed = document.get("axis")
    for index, table in enumerate(listed if isinstance(listed, list) else []):
        _validate(Axis, table, source, ("axis", index))
    study = _validate(Study, document, source)
    _check_random_axes(study, source)
    _check_columns(study, source)
    return LoadedStudy(source=source, study=study, base=_base_scenario(study, FilePath(path)))


def _validate(model: type[_Table], tables: object, source: str, place: Path = ()) -> _Table:
    try:
        return model.model_validate(tables)
    except ValidationError as error:
        _, line = complaint(error, model, place)
        raise StudyError(f"{source}: {line}") from None


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
        Origin(
            source=str(scenario_file),
            folder=scenario_file.parent,
            document=read_toml(scenario_file),
            assignments=_fixed_values(study.fixed, source),
            label=source,
        )
    )


def _fixed_values(tables: Mapping[str, Any], source: str) -> dict[Path, Any]:
    assignments: dict[Path, Any] = {}
    for steps, value in leaves(tables):
        text = spell(steps)
        path = parse_path(text)
        if path is None:
            raise ScenarioError(f"{source}: fixed: {shown(text)} is not the path of a field.")
        assignments[path] = value
    return assignments
