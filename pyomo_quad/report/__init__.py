"""Tables, figures and documents of a plan or a run; the only floor that draws."""

from enum import StrEnum


class Figures(StrEnum):
    """Which figures a report holds; the values name what is drawn of each."""

    ALL = "all"
    PNG = "png"
    NONE = "none"
