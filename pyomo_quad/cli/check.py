"""`pyomo-quad check`: what a scenario resolves to, and whether its equations hold together."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from pyomo_quad.cli.consoles import result_console
from pyomo_quad.cli.exit_codes import ExitCode
from pyomo_quad.cli.options import AllowCode, AsJson, Overrides, Quiet, ScenarioFile
from pyomo_quad.scenario import Scenario, describe_fields, load_scenario

if TYPE_CHECKING:
    from pyomo_quad.model.finding import Finding
    from pyomo_quad.model.inspection import ModelInspection

__all__ = ["check"]

_LONGEST_LIST = 6


def check(
    scenario: ScenarioFile,
    *,
    overrides: Overrides = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
    allow_code: AllowCode = False,
) -> int:
    """Validate a scenario and print every field with its unit and where it came from."""
    resolved = load_scenario(scenario, overrides or ())
    # Pyomo takes a second to import: a refused scenario need not wait for it.
    from pyomo_quad.model.custom import model_builder  # noqa: PLC0415
    from pyomo_quad.model.inspection import inspect_model  # noqa: PLC0415

    builder = model_builder(resolved, is_code_allowed=allow_code)
    inspection = inspect_model(builder(resolved))
    if as_json or not quiet:
        from pyomo_quad.study.diagnosis import diagnose  # noqa: PLC0415

        findings = diagnose(resolved, builder=builder)
        if as_json:
            print(json.dumps(_as_mapping(resolved, inspection, findings), indent=2))
        else:
            result_console().print(_table(resolved))
            for line in _verdict(inspection, findings):
                print(line)
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
        yield "Mission: nothing found that it must break, and nothing doubtful."
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
    scenario: Scenario, inspection: "ModelInspection", findings: Sequence["Finding"]
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
    }
