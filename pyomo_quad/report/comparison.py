"""What a report says of the flights beside each other: their table and its reading."""

from collections.abc import Callable
from dataclasses import dataclass
from math import degrees
from pathlib import Path

import pandas as pd

from pyomo_quad.report.render import (
    Block,
    Code,
    Document,
    Heading,
    Paragraph,
    Piece,
    Table,
    fixed,
    render_markdown,
    rough,
    yes_no,
)
from pyomo_quad.report.tables import write_table
from pyomo_quad.study.comparison import (
    ARRIVAL_DISTANCE_M,
    ARRIVAL_SPEED_M_PER_S,
    INSIDE_DISTANCE_M,
    ComparisonColumn,
)

STAND_IN = (
    "The adaptive controller is adaptive backstepping by published laws; it stands in for the "
    "controller that the paper cites but does not print, so its energies are not the paper's."
)

_HOW_TO_READ = (
    "The hover floor is what hovering for the same time takes. A controlled flight ends a little "
    "off the goal, moving, with rotors off the speed of hover: what that end still owes is priced "
    "at the optimum's costates and added, and everything beyond the first column of energies is "
    "of the sum. A saving is that of the optimum over the flight of its row, in per cent of that "
    "flight's sum and of its sum above the hover floor. A flight that ends more than "
    f"{ARRIVAL_DISTANCE_M:g} m from the goal, or faster than {ARRIVAL_SPEED_M_PER_S:g} m/s, has "
    "not arrived; one that did not, or that broke a limit, has no saving, bound or gap. Nor has "
    "an optimum that was told another wind than the one that blows."
)


@dataclass(frozen=True)
class _Shown:
    """A column of the comparison as it is printed."""

    column: ComparisonColumn
    header: str
    say: Callable[[float], str]

    @property
    def is_number(self) -> bool:
        return self.say not in (yes_no, str)


def _energy(value: float) -> str:
    return fixed(value, 2)


def _percent(value: float) -> str:
    return fixed(value, 2)


def _tilt(value: float) -> str:
    return fixed(degrees(value), 1)


def _plain(value: float) -> str:
    return fixed(value, 1)


_ENERGIES = (
    _Shown(ComparisonColumn.ENERGY, "Energy (J)", _energy),
    _Shown(ComparisonColumn.OWED_ENERGY, "Owed at its end (J)", _energy),
    _Shown(ComparisonColumn.HOVER_ENERGY, "Hover floor (J)", _energy),
    _Shown(ComparisonColumn.EXCESS_ENERGY, "Above the floor (J)", _energy),
    _Shown(ComparisonColumn.SAVING, "Saving (%)", _percent),
    _Shown(ComparisonColumn.SAVING_OF_EXCESS, "Saving above the floor (%)", _percent),
    _Shown(ComparisonColumn.LOWER_BOUND, "Lower bound (J)", _energy),
    _Shown(ComparisonColumn.OPTIMALITY_GAP, "Gap to the bound (%)", _percent),
)
_MOTIONS = (
    _Shown(ComparisonColumn.ARRIVED, "Arrived", yes_no),
    _Shown(ComparisonColumn.LIMITS_KEPT, "Limits kept", yes_no),
    _Shown(ComparisonColumn.BROKEN_LIMITS, "Limits broken", str),
    _Shown(ComparisonColumn.VERIFIED, "Verified", yes_no),
    _Shown(ComparisonColumn.TERMINAL_MISS, "Miss of the goal (m)", rough),
    _Shown(ComparisonColumn.TIME_INSIDE, f"Within {INSIDE_DISTANCE_M:g} m of it (s)", _energy),
    _Shown(ComparisonColumn.PEAK_POWER, "Peak power (W)", _plain),
    _Shown(ComparisonColumn.PEAK_TILT, "Peak tilt (°)", _tilt),
    _Shown(ComparisonColumn.PEAK_ROTOR_ACCELERATION, "Peak rotor acceleration (rad/s²)", _plain),
    _Shown(ComparisonColumn.BATTERY_USED, "Battery used (%)", _energy),
)


def comparison_blocks(comparison: pd.DataFrame) -> tuple[Block, ...]:
    """Show the comparison of one scenario or of many.

    Parameters
    ----------
    comparison : DataFrame
        One row per flight, columns of `ComparisonColumn`.

    Returns
    -------
    tuple of Block
        A heading, the energies, the flights, and how to read them.
    """
    return (
        Heading("Comparison"),
        _table("Energy of each flight", comparison, _ENERGIES),
        Paragraph((_HOW_TO_READ,)),
        _table("The flights themselves", comparison, _MOTIONS),
        Paragraph((STAND_IN,)),
    )


def _table(caption: str, comparison: pd.DataFrame, shown: tuple[_Shown, ...]) -> Table:
    keys = [ComparisonColumn.FLIGHT]
    names = ["Flight"]
    if len(comparison[ComparisonColumn.SCENARIO].unique()) > 1:
        keys, names = [ComparisonColumn.SCENARIO, *keys], ["Scenario", *names]
    rows: list[list[Piece]] = [
        [*(Code(str(row[key])) for key in keys), *(item.say(row[item.column]) for item in shown)]
        for _, row in comparison.iterrows()
    ]
    numeric = {len(keys) + place for place, item in enumerate(shown) if item.is_number}
    header = [*names, *(item.header for item in shown)]
    return Table(caption=caption, header=header, rows=rows, numeric=frozenset(numeric))


COMPARISON_NAME = "comparison.csv"
COMPARISON_REPORT_NAME = "comparison.md"


def write_comparison(folder: Path, comparison: pd.DataFrame, title: str = "Comparison") -> None:
    """Write a comparison as CSV and as Markdown.

    Parameters
    ----------
    folder : Path
        An existing folder.
    comparison : DataFrame
        One row per flight, columns of `ComparisonColumn`.
    title : str, optional
        Of the Markdown file.
    """
    write_table(comparison, folder / COMPARISON_NAME)
    if not comparison.empty:
        document = Document(title=title, blocks=comparison_blocks(comparison))
        text = render_markdown(document)
        (folder / COMPARISON_REPORT_NAME).write_text(text, encoding="utf-8")
