"""What a report says of a whole run: the answer and the certificate."""

from typing import TYPE_CHECKING

import pandas as pd

from pyomo_quad.flight.baselines import OPEN_LOOP, baseline_name
from pyomo_quad.report.document import Block, Code, Heading, Paragraph, Piece, Strong, Verdict
from pyomo_quad.report.flights import FAIR_BASELINE
from pyomo_quad.report.plan_sections import plan_verdict
from pyomo_quad.report.wording import STATUS_WORDS, fixed, rough, seconds
from pyomo_quad.scenario import Reference
from pyomo_quad.study.comparison import ComparisonColumn

if TYPE_CHECKING:
    from pyomo_quad.flight import Plan
    from pyomo_quad.study.certificate import Certificate
    from pyomo_quad.study.run import RunResult

__all__ = ["certificate_blocks", "run_verdict"]

_FOLLOWED_PLAN = baseline_name(Reference.PLAN)

_LOCAL_ONLY = (
    " The optimum is one that no small change improves; a quite different flight may still spend "
    "less."
)


def run_verdict(result: "RunResult") -> Verdict:
    """Return the answer of a run: what the optimum spends, and what it saves.

    Parameters
    ----------
    result : RunResult
        Of any status.

    Returns
    -------
    Verdict
        One sentence on the energy, and what it rests on; of a plan made for another wind than
        blows, what became of it.
    """
    plan = result.plan
    if plan.is_verified and plan.scenario.wind.forecast is not None:
        return _untold_verdict(plan, result.comparison)
    fair = _fair_row(result.comparison)
    if not plan.is_verified or fair is None:
        return plan_verdict(plan)
    return Verdict(
        is_good=True,
        pieces=(
            Strong(f"{STATUS_WORDS[plan.status]}."),
            f" The optimal flight spends {fixed(plan.energy)} J, ",
            f"{_less(fair[ComparisonColumn.SAVING])} than ",
            Code(str(fair[ComparisonColumn.FLIGHT])),
            f" ({_settled(fair)})",
            _above_hover(plan, fair),
            *_proof(plan, result.certificate),
        ),
    )


def _untold_verdict(plan: "Plan", comparison: pd.DataFrame) -> Verdict:
    """Say what became of a plan in a wind that it was not told of, with feedback and without."""
    rows = {str(row[ComparisonColumn.FLIGHT]): row for _, row in comparison.iterrows()}
    pieces: list[Piece] = [
        Strong(
            f"{STATUS_WORDS[plan.status]} in the wind that it was told, not in the one that blows."
        ),
        f" There the plan spends {fixed(plan.energy)} J. In the wind that blows",
    ]
    alone, followed = rows.get(OPEN_LOOP), rows.get(_FOLLOWED_PLAN)
    if alone is not None:
        pieces += [" ", Code(OPEN_LOOP), f", without feedback, {_end(alone)}"]
    if followed is not None:
        spent = f"{fixed(_spent(followed))} J"
        pieces += [
            "; " if alone is not None else " ",
            Code(_FOLLOWED_PLAN),
            f", under feedback, {_end(followed)} and spends {spent}",
        ]
    pieces += ["." if rows.keys() & {OPEN_LOOP, _FOLLOWED_PLAN} else " it was not flown."]
    fair = rows.get(FAIR_BASELINE)
    if followed is not None and fair is not None and followed[ComparisonColumn.ARRIVED]:
        pieces += _gain_of_the_plan(followed, fair)
    return Verdict(
        is_good=all(bool(row[ComparisonColumn.ARRIVED]) for row in rows.values()), pieces=pieces
    )


def _end(row: "pd.Series") -> str:
    miss = rough(row[ComparisonColumn.TERMINAL_MISS])
    if row[ComparisonColumn.ARRIVED]:
        return f"arrives {miss} m from the goal"
    return f"misses the goal by {miss} m"


def _gain_of_the_plan(followed: "pd.Series", fair: "pd.Series") -> list[Piece]:
    """Compare following the untold plan with following a reference that needs no plan."""
    if not fair[ComparisonColumn.ARRIVED]:
        return [" ", Code(FAIR_BASELINE), ", which needs no plan, does not arrive."]
    share = 100.0 * (1.0 - _spent(followed) / _spent(fair))
    outcome = f"saves {fixed(share)} %" if float(fixed(share)) > 0.0 else "gains nothing"
    return [
        f" Following it {outcome} over ",
        Code(FAIR_BASELINE),
        f" ({fixed(_spent(fair))} J), which needs no plan.",
    ]


def _spent(row: "pd.Series") -> float:
    """Return the energy by which flights are compared, what the end owes included, J."""
    return float(row[ComparisonColumn.HOVER_ENERGY] + row[ComparisonColumn.EXCESS_ENERGY])


def certificate_blocks(plan: "Plan", certificate: "Certificate") -> tuple[Block, ...]:
    """Say how far below the optimum any other flight could lie.

    Parameters
    ----------
    plan : Plan
        The optimum.
    certificate : Certificate
        Of the same mission.

    Returns
    -------
    tuple of Block
        A heading and a paragraph.
    """
    heading = Heading("Certificate of global optimality")
    if certificate.lower_bound_J is None:
        lacking = (Strong("There is none:"), f" {certificate.reason}", _LOCAL_ONLY)
        return (heading, Paragraph(lacking))
    bounded = (
        "No flight of this mission spends less than ",
        Strong(f"{fixed(certificate.lower_bound_J)} J"),
    )
    return (
        heading,
        Paragraph((*bounded, _held_against(plan, certificate), f" Reason: {certificate.reason}")),
    )


def _held_against(plan: "Plan", certificate: "Certificate") -> str:
    gap = certificate.gap_percent(plan.energy)
    if plan.scenario.wind.forecast is not None or gap is None:
        return " in the wind that really blows. The optimum was made for the forecast."
    return (
        f". The optimum spends {fixed(plan.energy)} J, so no flight whatever can save more than "
        f"{fixed(gap)} % of it."
    )


def _fair_row(comparison: pd.DataFrame) -> "pd.Series | None":
    """Return the arrived baseline to measure against: the smooth one, or else the cheapest."""
    has_saving = comparison[ComparisonColumn.SAVING].notna()
    rivals = comparison[comparison[ComparisonColumn.ARRIVED].astype(bool) & has_saving]
    if rivals.empty:
        return None
    fair = rivals[rivals[ComparisonColumn.FLIGHT] == FAIR_BASELINE]
    return (rivals.sort_values(ComparisonColumn.ENERGY) if fair.empty else fair).iloc[0]


def _settled(fair: "pd.Series") -> str:
    energy, owed = fair[ComparisonColumn.ENERGY], fair[ComparisonColumn.OWED_ENERGY]
    spent = f"{fixed(energy + owed)} J"
    is_plain = fixed(owed) == fixed(0.0)
    return spent if is_plain else f"{spent}, {fixed(owed)} J of it still owed at its end"


def _less(percent: float, digits: int = 2) -> str:
    return f"{fixed(abs(percent), digits)} % {'less' if percent >= 0.0 else 'more'}"


def _above_hover(plan: "Plan", fair: "pd.Series") -> str:
    saving = fair[ComparisonColumn.SAVING_OF_EXCESS]
    if pd.isna(saving):
        return "."
    duration = seconds(plan.scenario.mission.duration)
    optimum = fixed(plan.energy - plan.hover_energy_J)
    rival = fixed(fair[ComparisonColumn.EXCESS_ENERGY])
    return (
        f"; above the {fixed(plan.hover_energy_J)} J of hovering for the same {duration} it "
        f"spends {optimum} J against {rival} J, {_less(saving, 1)}."
    )


def _proof(plan: "Plan", certificate: "Certificate") -> tuple[Piece, ...]:
    said = []
    if plan.verification is not None:
        miss = rough(plan.verification.terminal_miss_m)
        said.append(f" Flown by SciPy, it ends {miss} m from the goal.")
    bound, gap = certificate.lower_bound_J, certificate.gap_percent(plan.energy)
    if bound is not None and gap is not None:
        said.append(
            f" No flight of this mission can spend less than {fixed(bound)} J, {fixed(gap)} % "
            "below the optimum."
        )
    return tuple(said)
