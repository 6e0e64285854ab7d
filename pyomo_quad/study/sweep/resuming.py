"""What a study file that changed means for the rows that are there."""

from pyomo_quad.study.sweep.cases import expand
from pyomo_quad.study.sweep.design import SweepDesign
from pyomo_quad.study.sweep.errors import StoreError
from pyomo_quad.study.sweep.store import ResultStore

__all__ = ["adopt_design"]

_MOST_CHANGES = 5


def adopt_design(store: ResultStore, design: SweepDesign) -> list[str]:
    """Let a store go on with a design, if its rows fit.

    Rows fit when all of them are cases of the design and were solved in the same way.

    Parameters
    ----------
    store : ResultStore
        Open for writing.
    design : SweepDesign
        What the study file says now.

    Returns
    -------
    list of str
        How the axes were extended, empty when they are the same.

    Raises
    ------
    StoreError
        If the rows do not fit; it says what changed.
    """
    stored = store.design
    changes = list(design.changes_since(stored))
    axis_changes = list(design.axis_changes_since(stored))
    rows = store.statuses().keys()
    if rows and not rows <= {case.key for case in expand(design)}:
        changes += axis_changes
    if rows and changes:
        shown = "; ".join(changes[:_MOST_CHANGES])
        more = len(changes) - _MOST_CHANGES
        raise StoreError(
            f"{store.file.parent}: holds {len(rows)} cases of a study that has changed since "
            f"({shown}{f'; and {more} more' if more > 0 else ''}); start anew with --fresh, or "
            f"choose another --out."
        )
    if stored != design:
        store.replace_design(design, is_extended=bool(axis_changes))
    return axis_changes
