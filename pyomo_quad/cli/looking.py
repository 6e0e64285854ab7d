"""Commands that do not solve a scenario: `init`, `check`, `library`, `schema` and `plot`."""

import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from pydantic import BaseModel
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.cli.startup import import_scipy_alone
from pyomo_quad.cli.terminal import (
    AllowCode,
    AsJson,
    Overrides,
    Quiet,
    ScenarioFile,
    option,
    result_console,
)
from pyomo_quad.report.folder import MARK, output_file
from pyomo_quad.report.tables import (
    FLIGHT_NAME,
    PLAN_NAME,
    SUMMARY_NAME,
    read_front,
    read_report,
    refuse_report,
)
from pyomo_quad.scenario import (
    LIBRARY_KINDS,
    LibraryEntry,
    Scenario,
    ScenarioError,
    describe_fields,
    field_unit,
    library_entry,
    library_names,
    load_scenario,
)
from pyomo_quad.scenario.description import (
    editor_schema,
    files_beside,
    shipped_scenarios,
    started_scenario,
    writable_fields,
)
from pyomo_quad.scenario.messages import PyomoQuadError, printable

if TYPE_CHECKING:
    from pyomo_quad.model.screening import Finding, ModelInspection
    from pyomo_quad.report.style import StyledFlight
    from pyomo_quad.study.effort import Effort

_LONGEST_LIST = 6


def check(
    scenario: ScenarioFile,
    *,
    overrides: Overrides = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
    allow_code: AllowCode = False,
) -> int:
    """Validate a scenario and its model, and print each field with unit and origin of its value."""
    resolved = load_scenario(scenario, overrides or ())
    # Pyomo takes a second to import: a refused scenario need not wait for it.
    import_scipy_alone()
    from pyomo_quad.model.build import model_builder  # noqa: PLC0415
    from pyomo_quad.model.screening import inspect_model  # noqa: PLC0415

    builder = model_builder(resolved, is_code_allowed=allow_code)
    inspection = inspect_model(builder(resolved))
    if as_json or not quiet:
        from pyomo_quad.study.check import check_mission  # noqa: PLC0415
        from pyomo_quad.study.effort import estimate_effort  # noqa: PLC0415

        findings = check_mission(resolved, builder=builder)
        unknowns = len(inspection.states) + len(inspection.other_variables)
        effort = estimate_effort(resolved, unknowns)
        if as_json:
            print(json.dumps(_as_mapping(resolved, inspection, findings, effort), indent=2))
        else:
            result_console().print(_table(resolved))
            for line in _verdict(inspection, findings):
                print(line)
            print(f"Effort: {effort.line}")
            for remark in resolved.remarks:
                print(f"Note: {remark}")
    return ExitCode.VERIFIED if inspection.is_unit_consistent else ExitCode.BAD_INPUT


def _verdict(inspection: "ModelInspection", findings: Sequence["Finding"]) -> Iterator[str]:
    yield (
        f"Model: {len(inspection.states)} states, {len(inspection.other_variables)} other "
        f"variables, {inspection.equations} equations over time, {inspection.path_limits} path "
        f"limits, {inspection.boundary_conditions} boundary conditions, "
        f"{inspection.parameters} parameters."
    )
    yield f"Degrees of freedom over time (controls): {inspection.degrees_of_freedom}."
    if inspection.is_unit_consistent:
        yield "Units: consistent in every declared relation."
    for error in inspection.unit_errors:
        yield f"Units: inconsistent in {error}"
    if not findings:
        yield "Mission: no impossible demand and no doubtful value found."
    for finding in findings:
        yield f"Mission, {finding.severity}: {finding.message}"


def _table(scenario: Scenario) -> Table:
    table = Table(title=f"Scenario {scenario.name}", title_justify="left", box=SIMPLE_HEAD)
    table.add_column("field", no_wrap=True)
    for column in ("value", "unit", "from", "meaning"):
        table.add_column(column, overflow="fold")
    for field in describe_fields(scenario):
        cells = (field.path, _shown(field.value), field.unit, field.origin, field.meaning)
        table.add_row(*(escape(cell) for cell in cells))
    return table


def _shown(value: Any) -> str:  # noqa: ANN401
    if value is None:
        return "-"
    if isinstance(value, tuple) and len(value) > _LONGEST_LIST:
        return f"{len(value)} values, {_shown(value[0])} to {_shown(value[-1])}"
    if isinstance(value, tuple):
        return f"[{', '.join(_shown(item) for item in value)}]"
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.10g}" if isinstance(value, float) else str(value)


def _as_mapping(
    scenario: Scenario,
    inspection: "ModelInspection",
    findings: Sequence["Finding"],
    effort: "Effort",
) -> dict[str, Any]:
    return {
        "scenario": scenario.name,
        "scenario_resolved": scenario.model_dump(mode="json"),
        "provenance": dict(scenario.provenance),
        "model": {
            **asdict(inspection),
            "degrees_of_freedom": inspection.degrees_of_freedom,
            "is_unit_consistent": inspection.is_unit_consistent,
        },
        "findings": [asdict(finding) for finding in findings],
        "effort": {"seconds": effort.seconds, "features": dict(effort.features)},
        "notes": list(scenario.remarks),
    }


def library(
    kind: Annotated[
        str | None, typer.Argument(metavar="[KIND]", help="vehicles, batteries or winds.")
    ] = None,
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="One of the names.")] = None,
    *,
    as_json: AsJson = False,
) -> int:
    """List the library of vehicles, batteries and winds, or show an entry with its sources."""
    if kind is not None and name is not None:
        _show_entry(library_entry(kind, name), as_json=as_json)
        return ExitCode.VERIFIED
    kinds = LIBRARY_KINDS if kind is None else [kind]
    names = {kind: list(library_names(kind)) for kind in kinds}
    if as_json:
        print(json.dumps(names, indent=2))
    else:
        for kind_shown, listed in names.items():
            print(f"{kind_shown}: {', '.join(listed)}")
    return ExitCode.VERIFIED


def _show_entry(entry: LibraryEntry, *, as_json: bool) -> None:
    values = entry.values()
    if as_json:
        rows = {
            path: {"value": value, "unit": field_unit(path), "source": entry.sources[path]}
            for path, value in values.items()
        }
        print(json.dumps({"kind": entry.kind, "name": entry.name, "fields": rows}, indent=2))
        return
    table = Table(title=f"{entry.kind} / {entry.name}", title_justify="left", box=SIMPLE_HEAD)
    for column in ("field", "value", "unit", "source"):
        table.add_column(column, overflow="fold")
    for path, value in values.items():
        table.add_row(path, escape(str(value)), field_unit(path), escape(entry.sources[path]))
    result_console().print(table)


def init(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="Name of the scenario and of its file.")
    ] = None,
    *,
    template: Annotated[
        str,
        typer.Option(
            "--from",
            metavar="NAME",
            help="A shipped scenario: parcel, delivery, inspection, paper, ...",
            autocompletion=lambda: list(shipped_scenarios()),
        ),
    ] = "parcel",
    quiet: Quiet = False,
) -> int:
    """Write a commented example scenario that runs, and the JSON Schema for editors."""
    own = template if name is None else name
    text = started_scenario(template, own)
    schema_file = Path("scenario.schema.json")
    for file, content in (
        (Path(f"{own}.toml"), text),
        (schema_file, _schema_text(Scenario, "scenario", _REQUIRED)),
    ):
        if file == schema_file and file.exists():
            continue
        write_new({file: content})
    for named, source in files_beside(template).items():
        target = Path(named)
        if not target.exists():
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(source, target)
    if not quiet:
        print(f"Written to {own}.toml. Fly it: pyomo-quad run {own}.toml")
    return ExitCode.VERIFIED


def write_new(texts: Mapping[Path, str]) -> None:
    """Write texts to new files, all of them or none.

    Parameters
    ----------
    texts : mapping
        Content of each file to create, written as UTF-8.

    Raises
    ------
    ScenarioError
        If one of the files exists already.
    """
    written: list[Path] = []
    try:
        for file, text in texts.items():
            with file.open("x", encoding="utf-8", newline="\n") as stream:
                written.append(file)
                stream.write(text)
    except OSError as error:
        for file in written:
            file.unlink(missing_ok=True)
        if not isinstance(error, FileExistsError):
            raise
        raise ScenarioError(
            f"{error.filename}: exists already; give another NAME or move it."
        ) from None


_REQUIRED = ("name", "mission")


def _schema_text(model: type[BaseModel], kind: str, required: tuple[str, ...]) -> str:
    schema = {"$comment": f"{MARK}.", **editor_schema(model, f"pyomo_quad {kind}", required)}
    return f"{json.dumps(schema, indent=1)}\n"


def schema(
    out: Annotated[Path, option("--out", "DIR", "Folder of the three files.")] = Path(),
) -> int:
    """Write the JSON Schemas of scenario and study files, and a page that lists every field."""
    from pyomo_quad.report.render import render_markdown  # noqa: PLC0415  takes a second
    from pyomo_quad.sweep.study_file import Study  # noqa: PLC0415

    kinds: dict[str, tuple[type[BaseModel], tuple[str, ...]]] = {
        "scenario": (Scenario, _REQUIRED),
        "study": (Study, ("name", "scenario", "axis")),
    }
    fields = {kind: list(writable_fields(model)) for kind, (model, _) in kinds.items()}
    pages = {"README.md": render_markdown("cli/schema.md.j2", mark=MARK, kinds=fields)}
    for kind, (model, required) in kinds.items():
        pages[f"{kind}.schema.json"] = _schema_text(model, kind, required)
    if not out.is_dir():
        raise ScenarioError(f"--out {out}: is not a folder; create it first.")
    with ExitStack() as files:
        # Before any of the three files is replaced, check that all of them may be.
        asides = {name: files.enter_context(output_file(out / name)) for name in pages}
        for name, aside in asides.items():
            aside.write_text(pages[name], encoding="utf-8")
    for name in pages:
        print(out / name)
    return ExitCode.VERIFIED


def plot(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="Report folder of a run, a solve or a flight.")
    ],
    what: Annotated[
        str, typer.Argument(metavar="[WHAT]", help="A figure, or a column of the table.")
    ] = "path",
    *,
    out: Annotated[
        Path | None, option("--out", "FILE", "File .png, .svg or .pdf; by default RUN_WHAT.png.")
    ] = None,
    quiet: Quiet = False,
) -> int:
    """Draw a figure of a finished run: path, states, energy, battery, ... or any table column."""
    flight, hover_energy_J, mission = _flight(run)
    front = read_front(run)
    from pyomo_quad.report.gallery import flight_drawings, front_drawing  # noqa: PLC0415
    from pyomo_quad.report.presenting import (  # noqa: PLC0415  matplotlib takes a second
        chosen_drawing,
        refuse_other_endings,
    )
    from pyomo_quad.report.style import save_figure  # noqa: PLC0415

    if out is not None:
        refuse_other_endings(out, "--out")
    offered = (
        *flight_drawings([flight], hover_energy_J, mission=mission),
        *(() if front is None else (front_drawing(front),)),
    )
    drawing = chosen_drawing(offered, flight, what, "WHAT")
    path = out or Path(f"{run.resolve().name}_{what}.png")
    with output_file(path) as aside:
        save_figure(drawing.draw, {path.suffix.removeprefix("."): aside}, MARK)
    if not quiet:
        others = (one.name for one in offered if one.name != what)
        print(f"Written to {path}. Others: {', '.join(others)}.")
    return ExitCode.VERIFIED


def _flight(run: Path) -> "tuple[StyledFlight, float, Scenario | None]":
    is_flight = (run / FLIGHT_NAME).is_file()
    summary, frame = read_report(run, FLIGHT_NAME if is_flight else PLAN_NAME)
    name, hover_energy_J = summary.get("flight", "optimal"), summary.get("hover_energy_J")
    if not isinstance(name, str) or not isinstance(hover_energy_J, int | float):
        refuse_report(run / SUMMARY_NAME, "is not the summary of a run, a solve or a flight")
    from pyomo_quad.report.style import flight_of_table  # noqa: PLC0415

    return flight_of_table(printable(name), frame), float(hover_energy_J), _mission(summary)


def _mission(summary: dict[str, Any]) -> Scenario | None:
    """Return the scenario in `summary`, the content of a `summary.json`, with the flight's times.

    The duration and the waypoint times of the flight replace those of the scenario. The result is
    None if scenario or duration is missing or cannot be read.
    """
    try:
        scenario = Scenario.model_validate(summary["scenario_resolved"])
        return scenario.lasting(summary["duration_s"], summary.get("passing_times_s", ()))
    except (PyomoQuadError, KeyError, TypeError, ValueError):
        return None
