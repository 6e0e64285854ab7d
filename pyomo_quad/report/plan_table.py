"""plan.csv: the plan as a table."""

from pathlib import Path
from typing import TYPE_CHECKING

from pyomo_quad.report.table_file import write_table

if TYPE_CHECKING:
    from pyomo_quad.flight import Plan

__all__ = ["PLAN_NAME", "write_plan_table"]

PLAN_NAME = "plan.csv"

# Only the best iterate of a solve that failed has this column, last.
_STATUS_COLUMN = "status"


def write_plan_table(folder: Path, plan: "Plan", rate_hz: float | None = None) -> None:
    """Write a plan's table.

    Parameters
    ----------
    folder : Path
        An existing folder.
    plan : Plan
        Of any status; each row of a solve that failed is marked with its status.
    rate_hz : float, optional
        Rows per second; one per node of the mesh without.
    """
    frame = plan.to_frame(rate_hz)
    if plan.verification is None:
        frame[_STATUS_COLUMN] = plan.status.value
    write_table(frame, folder / PLAN_NAME)
