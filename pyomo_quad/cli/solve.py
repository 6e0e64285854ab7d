"""`pyomo-quad solve`: the minimum-energy flight of a scenario, verified and written down."""

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
    real_number,
)
from pyomo_quad.cli.stopwatch import Stopwatch
from pyomo_quad.report.folder import refuse_output_folder
from pyomo_quad.report.summary import plan_summary, write_summary
from pyomo_quad.scenario import load_scenario

__all__ = ["Rate", "solve"]

Rate = Annotated[
    float | None,
    typer.Option(
        "--rate",
        metavar="HZ",
        parser=real_number,
        help="Rows per second of plan.csv; one per node without.",
    ),
]


def solve(
    scenario: ScenarioFile,
    *,
    out: Output = None,
    rate: Rate = None,
    overrides: Overrides = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
    allow_code: AllowCode = False,
) -> int:
    """Solve a scenario, verify the plan by flying it, and write the report."""
    watch = Stopwatch()
    resolved = load_scenario(scenario, overrides or ())
    folder = folder_of(resolved, out)
    refuse_output_folder(folder)
    with watch.phase("import"):
        from pyomo_quad.cli import solving, verdict  # noqa: PLC0415  takes a second, see there
        from pyomo_quad.report.solve_report import write_solve_report  # noqa: PLC0415
        from pyomo_quad.study.cautions import plan_cautions  # noqa: PLC0415
    planner = solving.planner_for(resolved, is_code_allowed=allow_code, is_quiet=quiet or as_json)
    with solving.report_folder(folder) as aside:
        plan = planner.solve(resolved)
        cautions = plan_cautions(plan, planner=planner)
        with watch.phase("report"):
            write_solve_report(aside, plan, cautions, rate)
        summary = plan_summary(plan, wall_s=watch.seconds, warnings=cautions)
        write_summary(aside, summary)
    verdict.answer(verdict.verdict_lines(plan), summary, folder, is_quiet=quiet, as_json=as_json)
    verdict.complain_about(plan, folder, cautions)
    return solving.exit_code_of(plan)
