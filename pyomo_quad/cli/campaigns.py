"""Command `pyomo-quad campaign`: fly missions in turn until the battery is empty."""

from pathlib import Path
from typing import Annotated

from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.cli.startup import import_scipy_alone
from pyomo_quad.cli.terminal import (
    AllowCode,
    AsJson,
    FigureChoice,
    Output,
    Overrides,
    Quiet,
    ScenarioFiles,
    option,
    positive_count,
)
from pyomo_quad.report import Figures
from pyomo_quad.report.folder import refuse_output_folder
from pyomo_quad.scenario import load_scenario

Charges = Annotated[
    int | None,
    option(
        "--charges", "N", "Full packs to fly, one after the other; 1 by default.", positive_count
    ),
]


def campaign(
    scenarios: ScenarioFiles,
    *,
    charges: Charges = None,
    out: Output = None,
    overrides: Overrides = None,
    figures: FigureChoice = Figures.SVG,
    quiet: Quiet = False,
    as_json: AsJson = False,
    allow_code: AllowCode = False,
) -> int:
    """Plan missions one after the other on one battery charge, until the battery is at a limit."""
    missions = [load_scenario(file, overrides or ()) for file in scenarios]
    folder = out or Path("reports") / f"{'+'.join(one.name for one in missions)}-campaign"
    refuse_output_folder(folder)
    import_scipy_alone()
    from pyomo_quad.cli import solving  # noqa: PLC0415  takes seconds
    from pyomo_quad.report.campaign import campaign_words, write_campaign  # noqa: PLC0415
    from pyomo_quad.study.campaign import fly_campaign  # noqa: PLC0415

    is_quiet = quiet or as_json
    planners = [
        solving.planner_for(one, is_code_allowed=allow_code, is_quiet=is_quiet) for one in missions
    ]
    with solving.report_folder(folder) as aside:
        flown = fly_campaign(missions, planners, charges=charges or 1)
        summary = write_campaign(aside, flown, figures)
    solving.answer(campaign_words(flown), summary, folder, is_quiet=quiet, as_json=as_json)
    return ExitCode.VERIFIED if flown.flights else ExitCode.NOT_SOLVED
