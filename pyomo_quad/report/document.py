"""A report's content, free of Markdown and HTML, so that both say the same.

Text is kept as written; each renderer escapes it, so no title or message of a scenario can act
as markup.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from unicodedata import category

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
    "visible",
]


FIGURE_FOLDER = "figures"

# Characters that are printed as nothing although Python calls them printable: fillers, joiners and
# selectors (Unicode's Default_Ignorable_Code_Point without its format characters).
_BLANK = re.compile(
    "[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180f\u2800\u3164\ufe00-\ufe0f\uffa0"
    "\U000e0000-\U000e0fff]"
)


def visible(text: str) -> str:
    """Spell out what a reader would not see, as Python escapes.

    Parameters
    ----------
    text : str
        Any text.

    Returns
    -------
    str
        Blanks and line breaks are kept; control characters, marks of direction, characters of no
        width and halves of surrogate pairs are spelled out.
    """
    return "".join(
        letter
        if letter in "\t\n\r" or category(letter) == "Zs" or _is_seen(letter)
        else letter.encode("unicode_escape").decode("ascii")
        for letter in text
    )


def _is_seen(letter: str) -> bool:
    return letter.isprintable() and not _BLANK.match(letter)


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
