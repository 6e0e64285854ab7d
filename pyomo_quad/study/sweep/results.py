"""Rows of a store as a pandas frame."""

from typing import Any

import pandas as pd

from pyomo_quad.study.sweep.cases import Case, expand
from pyomo_quad.study.sweep.design import SweepDesign, cell_of
from pyomo_quad.study.sweep.store import ResultStore, StoredCase

__all__ = ["CASE_COLUMN", "REASON_COLUMN", "STATUS_COLUMN", "results_frame"]

CASE_COLUMN = "case"
STATUS_COLUMN = "status"
REASON_COLUMN = "reason"


def results_frame(store: ResultStore) -> pd.DataFrame:
    """Return the rows of a store in the order of its design.

    Parameters
    ----------
    store : ResultStore
        Any store, also of a sweep that has not ended.

    Returns
    -------
    DataFrame
        Columns: case, the fields that vary, status, reason, then the outputs that the study
        keeps.  Wall times are left out: everything here is the same for each run.
    """
    design, rows = store.design, store.rows()
    ended = [(case, rows[case.key]) for case in expand(design) if case.key in rows]
    outputs = _output_columns(design, [row for _, row in ended])
    frame = pd.DataFrame([_record(case, row, outputs) for case, row in ended])
    columns = [CASE_COLUMN, *design.paths, STATUS_COLUMN, REASON_COLUMN, *outputs]
    return frame.reindex(columns=columns)


def _record(case: Case, row: StoredCase, outputs: list[str]) -> dict[str, Any]:
    fields = {path: cell_of(value) for path, value in case.overrides.items()}
    return {
        CASE_COLUMN: case.position,
        **fields,
        STATUS_COLUMN: row.status.value,
        REASON_COLUMN: row.reason,
        **{name: row.outputs[name] for name in outputs if name in row.outputs},
    }


def _output_columns(design: SweepDesign, rows: list[StoredCase]) -> list[str]:
    kept = design.outputs or [name for row in rows for name in row.outputs]
    return list(dict.fromkeys((*kept, *design.report_on)))
