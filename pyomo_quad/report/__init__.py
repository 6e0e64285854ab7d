"""Tables, figures and documents of a plan or a run; the only package that draws."""

from enum import StrEnum


class Figures(StrEnum):
    """Choice of the figures in a report; the values name the file formats."""

    SVG = "svg"
    PNG = "png"
    ALL = "all"
    NONE = "none"

    @property
    def formats(self) -> tuple[str, ...]:
        """Endings of the files of each figure; a report shows the first."""
        return {"all": ("svg", "png"), "none": ()}.get(self, (str(self),))
