"""Tables as CSV files: the same bytes from run to run, and nothing that a spreadsheet would run."""

from pathlib import Path

import pandas as pd

__all__ = ["neutral_cell", "write_table"]

_NUMBER_FORMAT = "%.12g"
# A cell that starts with one of these, full-width forms included, is a formula to a spreadsheet.
_FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")


def neutral_cell(value: object) -> object:
    """Return a cell that a spreadsheet shows and does not run.

    Parameters
    ----------
    value : object
        Any cell; only text is changed.

    Returns
    -------
    object
        Text that would be a formula gets a leading apostrophe, all else is returned as it is.
    """
    if isinstance(value, str) and value.lstrip(" ").startswith(_FORMULA_STARTS):
        return f"'{value}"
    return value


def write_table(frame: pd.DataFrame, path: Path) -> None:
    """Write a table as CSV.

    Parameters
    ----------
    frame : DataFrame
        Any table; the index is left out.
    path : Path
        The file.
    """
    safe = frame.rename(columns=neutral_cell)
    texts = [name for name, kind in safe.dtypes.items() if not pd.api.types.is_numeric_dtype(kind)]
    safe = safe.assign(**{str(name): safe[name].map(neutral_cell) for name in texts})
    safe.to_csv(path, index=False, float_format=_NUMBER_FORMAT, lineterminator="\n")
