"""The reports of a solve and of a run: what each section says, and their files."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from pyomo_quad.flight import Plan
from pyomo_quad.flight.baselines import OPEN_LOOP, baseline_name
from pyomo_quad.flight.verification import (
    BALANCE_TOLERANCE,
    ENERGY_TOLERANCE,
    MISS_TOLERANCE,
    VIOLATION_TOLERANCE,
    Verification,
)
from pyomo_quad.report.comparison import (
    COMPARISON_NAME,
    COMPARISON_REPORT_NAME,
    comparison_blocks,
    write_comparison,
)
from pyomo_quad.report.gallery import (
    PATH_NAME,
    Drawing,
    adaptation_drawing,
    comparison_drawings,
    plan_drawings,
    save_drawings,
)
from pyomo_quad.report.paths import view_markup, view_script
from pyomo_quad.report.render import (
    COUPLING_WORDS,
    FIGURE_FOLDER,
    POWER_WORDS,
    STATUS_WORDS,
    Block,
    Bullets,
    Code,
    Document,
    Heading,
    Paragraph,
    Picture,
    Piece,
    Strong,
    Table,
    Verdict,
    fixed,
    hover_place,
    render_html,
    render_markdown,
    rough,
    seconds,
    title_of,
)
from pyomo_quad.report.style import FAIR_BASELINE, StyledFlight, plan_flight, styled_flights
from pyomo_quad.report.tables import PLAN_NAME, SUMMARY_NAME, write_plan_table
from pyomo_quad.scenario import Reference, Scenario
from pyomo_quad.scenario.tables import Wind
from pyomo_quad.study.comparison import ComparisonColumn
from pyomo_quad.version import __version__

if TYPE_CHECKING:
    from pyomo_quad.collocation import ActiveLimit, Residual
    from pyomo_quad.flight.plan import Failure
    from pyomo_quad.study.certificate import Certificate
    from pyomo_quad.study.run import RunResult


def mission_blocks(scenario: Scenario) -> tuple[Block, ...]:
    """Say what was asked.

    Parameters
    ----------
    scenario : Scenario
        The mission.

    Returns
    -------
    tuple of Block
        A heading and a table.
    """
    vehicle, mission = scenario.vehicle, scenario.mission
    forecast = scenario.wind.forecast
    rows = [
        ("From", hover_place(mission.start)),
        ("To", hover_place(mission.goal)),
        ("Duration", f"{seconds(mission.duration)}, hover to hover"),
        ("Vehicle", f"{vehicle.title or vehicle.use}, {vehicle.total_mass:.6g} kg"),
        ("Battery", scenario.battery.title or scenario.battery.use),
        ("Power", POWER_WORDS[scenario.power.model]),
        ("Wind", _wind(scenario.wind)),
    ]
    if forecast is not None:
        rows.append(("Wind told to the optimiser", _wind(forecast)))
    if scenario.model is not None:
        rows.append(("Equations", f"the user's own, {scenario.model}"))
    return (
        Heading("Mission"),
        Table(caption="What was asked", header=("", "Scenario"), rows=rows),
        Paragraph(
            (
                "Every number of the scenario, with where it comes from: ",
                Code("pyomo-quad check"),
                ".",
            )
        ),
    )


def _wind(wind: Wind) -> str:
    source = f"measured, {wind.file}" if wind.file is not None else wind.title or wind.use
    return f"{source}; {COUPLING_WORDS[wind.coupling]}"


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


REPORT_NAME = "report.md"

PLAN_FILES = (
    (PLAN_NAME, "the flight as a table, SI units in the names of the columns"),
    (SUMMARY_NAME, "the outcome for programs: status, times, versions, the whole scenario"),
    (f"{FIGURE_FOLDER}/", "the figures as PNG and SVG"),
)


def write_solve_report(
    folder: Path, plan: "Plan", warnings: Sequence[str] = (), rate_hz: float | None = None
) -> None:
    """Write what there is to say of a plan.

    Parameters
    ----------
    folder : Path
        An existing folder, empty of reports.
    plan : Plan
        Of any status; one that is not verified is called so in title and text.
    warnings : sequence of str, optional
        What a reader should know beside the numbers, one line each.
    rate_hz : float, optional
        Rows per second of the table; one per node of the mesh without.
    """
    flights = styled_flights([plan_flight(plan)])
    drawings = plan_drawings(plan, flights)
    write_plan_table(folder, plan, rate_hz)
    save_drawings(drawings, folder)
    document = Document(
        title=plan_title(plan),
        blocks=(
            plan_verdict(plan),
            *failure_blocks(plan),
            *warning_blocks(warnings),
            *mission_blocks(plan.scenario),
            *verification_blocks(plan),
            *solve_blocks(plan),
            *figure_blocks([drawing.picture for drawing in drawings]),
            *origin_blocks(PLAN_FILES),
        ),
    )
    (folder / REPORT_NAME).write_text(render_markdown(document), encoding="utf-8")


PAGE_NAME = "report.html"

_RUN_FILES = (
    (REPORT_NAME, "this report"),
    (PAGE_NAME, "this report in one file, with a view of the paths to turn"),
)
_COMPARISON_FILES = (
    (COMPARISON_NAME, "all columns of the comparison"),
    (COMPARISON_REPORT_NAME, "the comparison alone"),
)


def write_run_report(folder: Path, result: "RunResult") -> None:
    """Write all there is to say of a run: tables, figures, `report.md` and `report.html`.

    Parameters
    ----------
    folder : Path
        An existing folder, empty of reports.
    result : RunResult
        Of any status; one whose plan is not verified is called so in title and text.
    """
    flights = styled_flights(result.flights or [plan_flight(result.plan)])
    drawings = plan_drawings(result.plan, flights)
    compared = _comparison_drawings(result, flights)
    studied = () if result.adaptation is None else (adaptation_drawing(result.adaptation),)
    write_plan_table(folder, result.plan)
    if not result.comparison.empty:
        write_comparison(folder, result.comparison, plan_title(result.plan))
    save_drawings([*compared, *studied, *drawings], folder)
    document = _document(
        result, *([drawing.picture for drawing in part] for part in (compared, studied, drawings))
    )
    (folder / REPORT_NAME).write_text(render_markdown(document), encoding="utf-8")
    (folder / PAGE_NAME).write_text(_page(folder, document, flights), encoding="utf-8")


def _comparison_drawings(
    result: "RunResult", flights: tuple[StyledFlight, ...]
) -> tuple[Drawing, ...]:
    comparison = result.comparison
    if comparison.empty:
        return ()
    arrived = comparison[ComparisonColumn.ARRIVED].astype(bool)
    absent = frozenset(comparison.loc[~arrived, ComparisonColumn.FLIGHT])
    return comparison_drawings(flights, result.plan.hover_energy_J, absent)


def _document(
    result: "RunResult", beside: list[Picture], studied: list[Picture], pictures: list[Picture]
) -> Document:
    plan = result.plan
    is_compared = not result.comparison.empty
    compared = comparison_blocks(result.comparison) if is_compared else ()
    files = (*_RUN_FILES, *PLAN_FILES, *(_COMPARISON_FILES if is_compared else ()))
    return Document(
        title=plan_title(plan),
        blocks=(
            run_verdict(result),
            *beside[:1],
            *failure_blocks(plan),
            *warning_blocks(result.warnings),
            *compared,
            *beside[1:],
            *figure_blocks(studied),
            *(certificate_blocks(plan, result.certificate) if plan.is_verified else ()),
            *figure_blocks(pictures[:1]),
            *mission_blocks(plan.scenario),
            *verification_blocks(plan),
            *solve_blocks(plan),
            *figure_blocks(pictures[1:]),
            *origin_blocks(files),
        ),
    )


def _page(folder: Path, document: Document, flights: tuple[StyledFlight, ...]) -> str:
    names = [block.name for block in document.blocks if isinstance(block, Picture)]
    drawn = {name: (folder / FIGURE_FOLDER / f"{name}.svg").read_bytes() for name in names}
    has_paths = PATH_NAME in drawn
    views = {PATH_NAME: view_markup()} if has_paths else {}
    return render_html(document, drawn, views, view_script(flights) if has_paths else "")
