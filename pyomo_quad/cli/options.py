"""Arguments and options that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

from pyomo_quad.scenario import Scenario

__all__ = ["AllowCode", "AsJson", "Output", "Overrides", "Quiet", "ScenarioFile", "folder_of"]

ScenarioFile = Annotated[Path, typer.Argument(metavar="SCENARIO", help="Scenario file (TOML).")]
Output = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", help="Output folder, reports/NAME by default."),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="PATH=VALUE", help="Set a field to a TOML value; repeatable."),
]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress and no summary.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
AllowCode = Annotated[
    bool, typer.Option("--allow-code", help="Let the scenario run its own model builder.")
]


def folder_of(scenario: Scenario, output: Path | None) -> Path:
    """Return where the report of a scenario goes.

    Parameters
    ----------
    scenario : Scenario
        Its name is safe as a folder's name.
    output : Path or None
        The folder asked for.

    Returns
    -------
    Path
        ``reports/NAME`` unless told otherwise.
    """
    return output or Path("reports") / scenario.name
