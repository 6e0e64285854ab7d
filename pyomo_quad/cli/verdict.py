"""What a command says of a plan: the answer on standard output, what is wrong on standard error."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from pyomo_quad.cli.consoles import complain
from pyomo_quad.flight import Plan, PlanStatus

__all__ = ["complain_about", "verdict_lines"]

_OUTCOMES = {
    PlanStatus.SOLVED: "solved but not verified",
    PlanStatus.NOT_CONVERGED: "not converged",
    PlanStatus.INFEASIBLE: "infeasible",
    PlanStatus.INTERRUPTED: "interrupted",
}


def verdict_lines(plan: Plan) -> Iterator[str]:
    """Yield the answer, or what is known of a failure besides its causes.

    Parameters
    ----------
    plan : Plan
        Failed or not.

    Yields
    ------
    str
        Lines for standard output.
    """
    if plan.is_verified:
        excess = plan.energy - plan.hover_energy_J
        yield (
            f"{plan.scenario.name}: verified, {plan.energy:.3f} J, {excess:.3f} J above hovering "
            f"for the same {plan.scenario.mission.duration:g} s; {plan.iteration_count} "
            f"iterations, {plan.timings['solve']:.2f} s."
        )
    if plan.failure is not None:
        diagnosis = plan.failure.diagnosis
        parts = {"Worst equations": diagnosis.residuals, "Limits reached": diagnosis.active}
        for heading, items in parts.items():
            if items:
                yield f"{heading}:"
                yield from (f"  {item}" for item in items)


def complain_about(plan: Plan, folder: Path, cautions: Sequence[str]) -> None:
    """Write on standard error what is wrong with a plan, one line for each matter.

    Parameters
    ----------
    plan : Plan
        Failed or not.
    folder : Path
        Where its report is.
    cautions : sequence of str
        What a reader should know beside the numbers.
    """
    name = plan.scenario.name
    if not plan.is_verified:
        causes = () if plan.failure is None else tuple(plan.failure.causes())
        first, *others = causes or (plan.message,)
        complain(f"{name}: {_OUTCOMES[plan.status]}: {first} See {folder}.")
        for cause in others:
            complain(f"{name}: {cause}")
    for caution in cautions:
        complain(f"{name}: warning: {caution}")
