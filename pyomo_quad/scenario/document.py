"""A TOML document from a stranger: data only, bounded in size and depth."""

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pyomo_quad.scenario.messages import ScenarioError, printable
from pyomo_quad.scenario.tree import depth

LARGEST_FILE_BYTES = 1_000_000
DEEPEST_NESTING = 8
# More brackets open at once, or a key of more parts, is an attack on the parser: it takes them one
# inside the other, or all anew for each.
_MOST_OPEN = 64
_MOST_KEY_PARTS = 32
# Comments, texts closed or not, and the signs that nest or join; no part is read twice.
_SIGNS = re.compile(
    r"""#[^\n]*+|\"{3}(?:[^"\\]++|\\.|"(?!""))*+(?:\"{3})?|'{3}(?:[^']++|'(?!''))*+(?:'{3})?"""
    r"""|"(?:[^"\\\n]++|\\.)*+"?|'[^'\n]*+'?|[\[\]{}.,=\n]""",
    re.DOTALL,
)


def read_toml(file: Path) -> dict[str, Any]:
    """Read a TOML file that may come from a stranger.

    Raises
    ------
    ScenarioError
        If it is missing, too large, nested too deep or not TOML.
    """
    source = printable(str(file))
    try:
        with file.open("rb") as stream:
            content = stream.read(LARGEST_FILE_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ScenarioError(
            f"{source}: cannot be read ({reason}); give an existing TOML file."
        ) from None
    if len(content) > LARGEST_FILE_BYTES:
        raise ScenarioError(
            f"{source}: larger than {LARGEST_FILE_BYTES} bytes; a scenario is a short file."
        )
    try:
        tables = parse_toml(content.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        reason = printable(" ".join(str(error).split())[:120])
        raise ScenarioError(f"{source}: not valid TOML ({reason}); correct it.") from None
    refuse_deep(tables, source)
    return tables


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML, once it is known not to nest so deep that the parser would suffer."""
    open_brackets, key_parts = 0, 1
    for sign in _SIGNS.finditer(text):
        match sign[0]:
            case "[" | "{":
                open_brackets, key_parts = open_brackets + 1, 1
            case "]" | "}":
                open_brackets, key_parts = max(open_brackets - 1, 0), 1
            case ".":
                key_parts += 1
            case "," | "=" | "\n":
                key_parts = 1
        if open_brackets > _MOST_OPEN or key_parts > _MOST_KEY_PARTS:
            raise ValueError("nested too deep")
    return tomllib.loads(text)


def refuse_deep(tables: Mapping[str, Any], source: str) -> None:
    """Refuse tables that nest deeper than any scenario."""
    if depth(tables, DEEPEST_NESTING) > DEEPEST_NESTING:
        raise ScenarioError(
            f"{source}: nested deeper than {DEEPEST_NESTING} levels; a scenario is a shallow file."
        )
