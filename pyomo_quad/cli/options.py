"""Arguments and options that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.complaint import shown
from pyomo_quad.scenario.fields import number_in_text

__all__ = [
    "AllowCode",
    "AsJson",
    "Output",
    "Overrides",
    "Quiet",
    "ScenarioFile",
    "folder_of",
    "positive_count",
    "real_number",
]

_MOST_DIGITS = 9

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


def real_number(text: str) -> float:
    """Read an option that is a number.

    Parameters
    ----------
    text : str
        As given on the command line.

    Returns
    -------
    float
        The number.

    Raises
    ------
    BadParameter
        If the text is something else.
    """
    try:
        return number_in_text(text)
    except ValueError:
        raise typer.BadParameter(f"{shown(text)} must be a number, such as 50 or 0.5.") from None


def positive_count(text: str) -> int:
    """Read an option that counts something, from 1 on.

    Parameters
    ----------
    text : str
        As given on the command line.

    Returns
    -------
    int
        The count.

    Raises
    ------
    BadParameter
        If the text is something else.
    """
    digits = text.strip()
    if digits.isascii() and digits.isdecimal() and 1 <= len(digits) <= _MOST_DIGITS and int(digits):
        return int(digits)
    raise typer.BadParameter(f"{shown(text)} must be a whole number >= 1.")
