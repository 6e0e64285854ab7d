"""Reports of plans and of runs: tables, figures, Markdown text and HTML pages.

A run compares the minimum-energy plan of a mission with the flights of a controller. Matplotlib is
imported only by modules that draw reports.
"""

from enum import StrEnum


class Figures(StrEnum):
    """Choice of the figure files of a report: SVG, PNG, both (`ALL`) or none."""

    SVG = "svg"
    PNG = "png"
    ALL = "all"
    NONE = "none"

    @property
    def formats(self) -> tuple[str, ...]:
        """Endings of the files that are written for each figure.

        For `ALL`, they are ``("svg", "png")``. The report displays the file with the first ending.
        The result is empty for `NONE`.
        """
        return {"all": ("svg", "png"), "none": ()}.get(self, (str(self),))
