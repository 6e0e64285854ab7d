"""What a report says of a plan that is not verified: what went wrong, and what would help."""

from typing import TYPE_CHECKING

from pyomo_quad.report.document import Block, Bullets, Code, Heading, Paragraph, Piece, Table
from pyomo_quad.report.wording import rough

if TYPE_CHECKING:
    from pyomo_quad.collocation import ActiveLimit, Residual
    from pyomo_quad.flight import Plan
    from pyomo_quad.flight.failure import Failure

__all__ = ["attempt_blocks", "failure_blocks"]

_BEST_ITERATE = Paragraph(
    (
        "The best iterate is kept in ",
        Code("plan.csv"),
        " and drawn below. It breaks equations or limits and is not a flight.",
    )
)


def failure_blocks(plan: "Plan") -> tuple[Block, ...]:
    """Say what kept a plan from being verified.

    Parameters
    ----------
    plan : Plan
        Of any status.

    Returns
    -------
    tuple of Block
        Nothing for a verified plan.
    """
    if plan.is_verified:
        return ()
    return (
        Heading("What went wrong"),
        Paragraph((plan.message,)),
        *(_diagnosis(plan.failure) if plan.failure is not None else ()),
        *((_BEST_ITERATE,) if plan.verification is None else ()),
        *attempt_blocks(plan),
    )


def attempt_blocks(plan: "Plan") -> tuple[Block, ...]:
    """Log what was tried when the first solve was not enough.

    Parameters
    ----------
    plan : Plan
        Of any status.

    Returns
    -------
    tuple of Block
        Nothing when the first solve was enough.
    """
    if not plan.attempts:
        return ()
    return (
        Paragraph(("What was tried, in order:",)),
        Bullets(tuple((attempt,) for attempt in plan.attempts)),
    )


def _diagnosis(failure: "Failure") -> tuple[Block, ...]:
    causes = tuple((cause,) for cause in failure.causes())
    diagnosis = failure.diagnosis
    blocks: list[Block] = [Bullets(causes)] if causes else []
    if diagnosis.residuals:
        blocks.append(
            Table(
                caption="Worst equations of the best iterate",
                header=("Equation", "Element", "Time (s)", "Off by", "Unit"),
                rows=[_residual(residual) for residual in diagnosis.residuals],
                numeric=frozenset({1, 2, 3}),
            )
        )
    if diagnosis.active:
        blocks.append(
            Table(
                caption="Limits that it touches",
                header=("Limit", "At", "Unit", "Share of the points (%)"),
                rows=[_active(limit) for limit in diagnosis.active],
                numeric=frozenset({1, 3}),
            )
        )
    return tuple(blocks)


def _residual(residual: "Residual") -> tuple[Piece, ...]:
    element = "" if residual.element is None else str(residual.element + 1)
    time = "" if residual.time is None else f"{residual.time:.4g}"
    return Code(residual.name), element, time, rough(residual.violation), Code(residual.unit)


def _active(limit: "ActiveLimit") -> tuple[Piece, ...]:
    return Code(limit.name), f"{limit.limit:.6g}", Code(limit.unit), f"{100 * limit.share:.0f}"
