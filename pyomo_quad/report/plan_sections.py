"""What a report says of a plan: the verdict, the mission, the verification and the solve."""

from collections.abc import Iterable, Sequence

from pyomo_quad.flight import Plan
from pyomo_quad.flight.verification import (
    BALANCE_TOLERANCE,
    ENERGY_TOLERANCE,
    MISS_TOLERANCE,
    VIOLATION_TOLERANCE,
    Verification,
)
from pyomo_quad.report.document import (
    Block,
    Bullets,
    Code,
    Heading,
    Paragraph,
    Picture,
    Piece,
    Strong,
    Table,
    Verdict,
)
from pyomo_quad.report.failure_section import attempt_blocks
from pyomo_quad.report.wording import (
    STATUS_WORDS,
    fixed,
    rough,
    seconds,
    title_of,
)
from pyomo_quad.version import __version__

__all__ = [
    "figure_blocks",
    "origin_blocks",
    "plan_title",
    "plan_verdict",
    "solve_blocks",
    "verification_blocks",
    "warning_blocks",
]


_HOW_VERIFIED = (
    "The planned controls were flown through the declared equations by SciPy's adaptive "
    "integrator DOP853, which had no part in the solve."
)


def plan_title(plan: Plan) -> str:
    """Return the report's title, which says so when the plan is not verified.

    Parameters
    ----------
    plan : Plan
        Of any status.

    Returns
    -------
    str
        One line.
    """
    title = title_of(plan.scenario)
    return title if plan.is_verified else f"{STATUS_WORDS[plan.status]}: {title}"


def plan_verdict(plan: Plan) -> Verdict:
    """Return the answer of a solve.

    Parameters
    ----------
    plan : Plan
        Of any status.

    Returns
    -------
    Verdict
        The energy, or why there is none to rely on.
    """
    status = Strong(f"{STATUS_WORDS[plan.status]}.")
    if plan.verification is None:
        return Verdict(
            is_good=False,
            pieces=(status, f" No flight was found: {_first_cause(plan)}"),
        )
    excess = fixed(plan.energy - plan.hover_energy_J)
    energy = (
        f" The optimal flight spends {fixed(plan.energy)} J: {excess} J above what hovering for "
        f"the same {seconds(plan.scenario.mission.duration)} takes "
        f"({fixed(plan.hover_energy_J)} J)."
    )
    if plan.is_verified:
        return Verdict(is_good=True, pieces=(status, energy))
    doubt = " Flying the plan, or the mesh, did not confirm it: do not rely on these numbers."
    return Verdict(is_good=False, pieces=(status, doubt, energy))


def _first_cause(plan: Plan) -> str:
    causes = plan.failure.causes() if plan.failure is not None else iter(())
    return next(causes, plan.message)


def verification_blocks(plan: Plan) -> tuple[Block, ...]:
    """Say what flying the plan found.

    Parameters
    ----------
    plan : Plan
        Of any status.

    Returns
    -------
    tuple of Block
        A heading, how it was done, and a table; nothing if there was no plan to fly.
    """
    found = plan.verification
    if found is None:
        return ()
    return (
        Heading("Verification"),
        Paragraph((_HOW_VERIFIED,)),
        Table(
            caption="Flown against planned",
            header=("Check", "Worst", "Found", "Allowed"),
            rows=_checks(found, plan.energy),
            numeric=frozenset({2, 3}),
        ),
    )


def _checks(found: Verification, energy: float) -> list[tuple[str, Piece, Piece, Piece]]:
    worst = found.worst_miss
    return [
        ("Miss of the goal (m)", "", rough(found.terminal_miss_m), rough(MISS_TOLERANCE)),
        (
            "Largest miss of a final state (SI)",
            Code(worst),
            rough(abs(found.terminal_miss[worst])),
            f"{rough(MISS_TOLERANCE)}, relative above 1",
        ),
        (
            "Worst breach of a limit (relative)",
            Code(found.worst_constraint),
            rough(max(found.max_violation, 0.0)),
            rough(VIOLATION_TOLERANCE),
        ),
        (
            "Energy flown minus planned (J)",
            "",
            rough(found.energy_difference_J),
            rough(ENERGY_TOLERANCE * max(1.0, abs(energy))),
        ),
        (
            "Power or charge that the battery lacks (relative)",
            "",
            rough(max(found.battery_imbalance, 0.0)),
            rough(BALANCE_TOLERANCE),
        ),
    ]


def solve_blocks(plan: Plan) -> tuple[Block, ...]:
    """Say how the solve went, from mesh to mesh.

    Parameters
    ----------
    plan : Plan
        Of any status.

    Returns
    -------
    tuple of Block
        A heading and a table, and what was tried before.
    """
    rows = [
        (
            str(number),
            str(record.elements),
            str(record.points),
            str(record.iterations),
            fixed(record.objective, 4),
            rough(record.error),
        )
        for number, record in enumerate(plan.history, start=1)
    ]
    header = ("Mesh", "Elements", "Points", "Iterations", "Energy (J)", "Error estimate")
    return (
        Heading("Solve"),
        Table(
            caption=f"Meshes, until the error is below {plan.scenario.solver.tolerance:.3g}",
            header=header,
            rows=rows,
            numeric=frozenset(range(len(header))),
        ),
        *(attempt_blocks(plan) if plan.is_verified else ()),
    )


def warning_blocks(warnings: Sequence[str]) -> tuple[Block, ...]:
    """Repeat what the run warned of.

    Parameters
    ----------
    warnings : sequence of str
        One line each.

    Returns
    -------
    tuple of Block
        Nothing when there is nothing to say.
    """
    if not warnings:
        return ()
    return (Heading("Warnings"), Bullets(tuple((warning,) for warning in warnings)))


def figure_blocks(pictures: Iterable[Picture]) -> tuple[Block, ...]:
    """Show figures, each under its own heading.

    Parameters
    ----------
    pictures : iterable of Picture
        In order.

    Returns
    -------
    tuple of Block
        Two for each figure.
    """
    return tuple(block for picture in pictures for block in (Heading(picture.title), picture))


def origin_blocks(files: Sequence[tuple[str, str]]) -> tuple[Block, ...]:
    """Say what made the report, and what lies beside it.

    Parameters
    ----------
    files : sequence of (str, str)
        Name and content of each file beside the report.

    Returns
    -------
    tuple of Block
        A heading and a list.
    """
    return (
        Heading("Files"),
        Bullets(tuple((Code(name), f": {content}") for name, content in files)),
        Paragraph((f"Made by pyomo_quad {__version__}.",)),
    )
