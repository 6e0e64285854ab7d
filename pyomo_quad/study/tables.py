"""Base class for the columns of result tables: names and order, and functions for the values."""

from collections.abc import Callable, Iterable, Sequence
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    import pandas as pd


class TableColumn(StrEnum):
    """Base class of enumerations of a table's columns, one member for each column, in order.

    The value of a member is the heading of the column. If the rows are made from objects, the
    function `read` of a member returns the column's value for a given object.
    """

    read: Callable[[Any], object]

    def __new__(cls, name: str, read: Callable[[Any], object] = str) -> Self:
        """Make a column of a table, with the heading `name`.

        `read` takes the object from which a row is made, and returns the column's value. The method
        `of_objects` calls it; `of_rows` does not.
        """
        column = str.__new__(cls, name)
        column._value_ = name
        column.read = read
        return column

    @classmethod
    def of_rows(cls, rows: Sequence[Any]) -> "pd.DataFrame":
        """Return a table from its rows.

        Each row in `rows` is a sequence of values in the order of the columns, or a mapping from
        columns to values.
        """
        import pandas as pd  # noqa: PLC0415  0.3 s that a solve has no use for

        return pd.DataFrame(rows, columns=[column.value for column in cls])

    @classmethod
    def of_objects(cls, objects: Iterable[object]) -> "pd.DataFrame":
        """Return a table with one row for each object.

        The function `read` of each column computes the column's value from the object.
        """
        return cls.of_rows([[column.read(one) for column in cls] for one in objects])
