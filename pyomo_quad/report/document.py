"""A report's content, free of Markdown and HTML, so that both say the same.

Text is kept as written; each renderer escapes it, so no title or message of a scenario can act
as markup.
"""

from collections.abc import Sequence
from dataclasses import dataclass

__all__ = [
    "FIGURE_FOLDER",
    "Block",
    "Bullets",
    "Code",
    "Document",
    "Heading",
    "Paragraph",
    "Picture",
    "Piece",
    "Strong",
    "Table",
    "Verdict",
]


FIGURE_FOLDER = "figures"


@dataclass(frozen=True)
class Code:
    """A name from a program: of a flight, a file, a field, a command."""

    text: str


@dataclass(frozen=True)
class Strong:
    """Words that carry the sentence."""

    text: str


Piece = str | Code | Strong


@dataclass(frozen=True)
class Heading:
    """A heading below the title."""

    text: str


@dataclass(frozen=True)
class Paragraph:
    """Running text."""

    pieces: Sequence[Piece]


@dataclass(frozen=True)
class Bullets:
    """A list of short texts."""

    items: Sequence[Sequence[Piece]]


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The answer, set apart from all else."""

    is_good: bool
    pieces: Sequence[Piece]


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table whose first column names the rows.

    ``numeric`` holds the positions of the columns that are aligned to the right.
    """

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[Piece]]
    numeric: frozenset[int] = frozenset()


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A figure, by the name of its files without suffix."""

    name: str
    title: str
    caption: str


Block = Heading | Paragraph | Bullets | Verdict | Table | Picture


@dataclass(frozen=True, kw_only=True)
class Document:
    """A title and what stands below it."""

    title: str
    blocks: Sequence[Block]
