"""Command `pyomo-quad campaign`: plan missions in turn until the battery is empty."""

from pathlib import Path
from typing import Annotated

from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.cli.startup import import_scipy_alone
from pyomo_quad.cli.terminal import (
    Options,
    ScenarioFiles,
    option,
    positive_count,
    with_options,
)
from pyomo_quad.report.folder import refuse_output_folder

Charges = Annotated[
    int | None,
    option(
        "--charges", "N", "Full packs to fly, one after the other; 1 by default.", positive_count
    ),
]


@with_options
def campaign(
    scenarios: ScenarioFiles,
    *,
    charges: Charges = None,
    options: Options,
) -> int:
    """Plan missions one after the other, until the battery charge allows no further flight."""
    missions = [options.load(file) for file in scenarios]
    folder = options.out or Path("reports") / f"{'+'.join(one.name for one in missions)}-campaign"
    refuse_output_folder(folder)
    import_scipy_alone()
    from pyomo_quad.cli import solving  # noqa: PLC0415  takes seconds
    from pyomo_quad.report.campaign import campaign_words, write_campaign  # noqa: PLC0415
    from pyomo_quad.study.campaign import fly_campaign  # noqa: PLC0415

    planners = [solving.planner_for(mission, options) for mission in missions]
    with solving.report_folder(folder) as aside:
        flown = fly_campaign(missions, planners, charges=charges or 1)
        summary = write_campaign(aside, flown, options.figures)
    solving.answer(campaign_words(flown), summary, folder, options)
    return ExitCode.VERIFIED if flown.flights else ExitCode.NOT_SOLVED
