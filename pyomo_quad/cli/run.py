"""`pyomo-quad run` and `compare`: the optimum beside what else could be flown, with its proof."""

from pathlib import Path
from typing import Annotated

import typer

from pyomo_quad.cli.options import (
    AllowCode,
    AsJson,
    Output,
    Overrides,
    Quiet,
    ScenarioFile,
    folder_of,
)
from pyomo_quad.cli.stopwatch import Stopwatch
from pyomo_quad.report.folder import refuse_output_folder
from pyomo_quad.report.summary import compare_summary, run_summary, write_summary
from pyomo_quad.scenario import load_scenario

__all__ = ["compare", "run"]

_COMPARISON_FOLDER = Path("reports") / "comparison"

ScenarioFiles = Annotated[
    list[Path], typer.Argument(metavar="SCENARIO...", help="Scenario files (TOML).")
]
ComparisonOutput = Annotated[
    Path, typer.Option("--out", metavar="DIR", help="Output folder of the table.")
]


def run(
    scenario: ScenarioFile,
    *,
    out: Output = None,
    overrides: Overrides = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
    allow_code: AllowCode = False,
) -> int:
    """Solve, verify, fly every baseline, compare, certify and report."""
    watch = Stopwatch()
    resolved = load_scenario(scenario, overrides or ())
    folder = folder_of(resolved, out)
    refuse_output_folder(folder)
    with watch.phase("import"):
        from pyomo_quad.cli import solving, verdict  # noqa: PLC0415  takes a second, see there
        from pyomo_quad.report.run_report import write_run_report  # noqa: PLC0415
        from pyomo_quad.study.run import run_scenario  # noqa: PLC0415
    planner = solving.planner_for(resolved, is_code_allowed=allow_code, is_quiet=quiet or as_json)
    with solving.report_folder(folder) as aside:
        result = run_scenario(resolved, planner=planner)
        with watch.phase("report"):
            write_run_report(aside, result)
        summary = run_summary(result, wall_s=watch.seconds)
        write_summary(aside, summary)
    verdict.answer(verdict.run_lines(result), summary, folder, is_quiet=quiet, as_json=as_json)
    verdict.complain_about(result.plan, folder, result.warnings)
    return solving.exit_code_of(result.plan)


def compare(
    scenarios: ScenarioFiles,
    *,
    out: ComparisonOutput = _COMPARISON_FOLDER,
    overrides: Overrides = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
    allow_code: AllowCode = False,
) -> int:
    """Run many scenarios and put all their flights into one table."""
    missions = [load_scenario(file, overrides or ()) for file in scenarios]
    refuse_output_folder(out)
    from pyomo_quad.cli import solving, verdict  # noqa: PLC0415  takes a second, see there
    from pyomo_quad.report.comparison_tables import write_comparison  # noqa: PLC0415
    from pyomo_quad.study.comparison import combine  # noqa: PLC0415
    from pyomo_quad.study.run import run_scenario  # noqa: PLC0415

    is_quiet = quiet or as_json
    planners = [
        solving.planner_for(m, is_code_allowed=allow_code, is_quiet=is_quiet) for m in missions
    ]
    with solving.report_folder(out) as aside:
        results = [
            run_scenario(mission, planner=planner)
            for mission, planner in zip(missions, planners, strict=True)
        ]
        comparison = combine([result.comparison for result in results])
        write_comparison(aside, comparison)
        summary = compare_summary(results)
        write_summary(aside, summary)
    lines = [verdict.comparison_table(comparison)]
    verdict.answer(lines, summary, out, is_quiet=quiet, as_json=as_json)
    for result in results:
        verdict.complain_about(result.plan, out, result.warnings)
    return max(solving.exit_code_of(result.plan) for result in results)
