"""Tables, figures and documents of a plan or a run; the only floor that draws."""

from enum import StrEnum


class Figures(StrEnum):
    """Which figures a report holds; the values name what is drawn of each."""

    SVG = "svg"
    PNG = "png"
    ALL = "all"
    NONE = "none"

    @property
    def formats(self) -> tuple[str, ...]:
        """Endings of the files of each figure; the first is what a report shows."""
        return {"all": ("svg", "png"), "none": ()}.get(self, (str(self),))
