"""Rendering of Jinja templates as Markdown, with number formats and escaping of text."""

import re
from functools import cache
from math import degrees, isfinite, isnan
from pathlib import Path
from unicodedata import category

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from pyomo_quad.flight import PlanStatus
from pyomo_quad.flight.limit_words import limit_amount, limit_words, percent
from pyomo_quad.scenario import PowerModel, WindCoupling
from pyomo_quad.study.comparison import against_hovering

#: Text of a table cell without a number.
NOTHING = "n/a"

POWER_WORDS = {
    PowerModel.MOTOR: "electrical power of the motors, with copper loss",
    PowerModel.EFFICIENCY: "shaft power divided by the recovered f_r of Yacef et al., eq. (8)",
    PowerModel.SHAFT: "shaft power",
    PowerModel.CONSTANT_EFFICIENCY: "shaft power divided by a constant efficiency",
    PowerModel.MOTOR_WITH_FRICTION: "electrical power of the motors, with their friction",
    PowerModel.MOMENTUM: "momentum theory: lift, blade drag and climb depend on the airspeed",
}

COUPLING_WORDS = {
    WindCoupling.ACCELERATION: "acts as an acceleration of 1 1/s times its speed, as in eq. (9) of "
    "Yacef et al.",
    WindCoupling.DRAG: "acts by drag on the airspeed",
}

STATUS_WORDS = {
    PlanStatus.VERIFIED: "Verified in simulation",
    PlanStatus.USABLE: "Usable",
    PlanStatus.SOLVED: "Not verified",
    PlanStatus.NOT_CONVERGED: "Failed, not converged",
    PlanStatus.INFEASIBLE: "Failed, infeasible",
    PlanStatus.INTERRUPTED: "Failed, interrupted",
}


def fixed(value: float, digits: int = 2) -> str:
    """Format a number with a fixed number of decimals; "-0.00" becomes "0.00".

    Returns "n/a" if the number is not finite.

    Parameters
    ----------
    value : float
        The number.
    digits : int, optional
        Number of decimals.
    """
    if not isfinite(value):
        return NOTHING
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def rough(value: float, digits: int = 2) -> str:
    """Format a number with the given significant digits; "n/a" if it is not finite.

    Parameters
    ----------
    value : float
        The number.
    digits : int, optional
        Number of significant digits.
    """
    return f"{value:.{digits}g}" if isfinite(value) else NOTHING


def yes_no(value: object) -> str:
    """Return "yes" for a true value, "no" otherwise."""
    return "yes" if value else "no"


FIGURE_FOLDER = "figures"

# Characters that are invisible although `str.isprintable` accepts them: fillers, joiners and
# selectors (Unicode's Default_Ignorable_Code_Point without its format characters).
_BLANK = re.compile(
    "[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180f\u2800\u3164\ufe00-\ufe0f\uffa0"
    "\U000e0000-\U000e0fff]"
)


def visible(text: str) -> str:
    r"""Replace the invisible characters of a text by Python escapes such as ``\u200b``.

    Control characters, direction marks, zero-width characters and lone surrogates are replaced.
    Blanks and line breaks are kept.
    """
    # Two names that differ only in invisible characters look different after the replacement.
    return "".join(
        letter
        if letter in "\t\n\r" or category(letter) == "Zs" or _is_seen(letter)
        else letter.encode("unicode_escape").decode("ascii")
        for letter in text
    )


def _is_seen(letter: str) -> bool:
    return letter.isprintable() and not _BLANK.match(letter)


_ENTITIES = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;"})
_SPECIAL = re.compile(r"([\\`*_\[\]#|~$])")
# Text at the start of a line that Markdown would read as a list item or a rule.
_LINE_START = re.compile(r"^([-+](?=\s|$)|-{3,}$|\d+(?=[.)](?:\s|$)))")


def escape_markdown(text: str) -> str:
    """Escape a text for Markdown and HTML, with each run of white space as one space.

    Invisible characters are replaced by Python escapes, and web addresses do not become links.
    """
    one_line = visible(" ".join(text.split()))
    escaped = _SPECIAL.sub(r"\\\1", one_line.translate(_ENTITIES))
    # Web addresses in a text must not become links.
    unlinked = escaped.replace("://", ":&#47;&#47;").replace("www.", "www&#46;")
    return _LINE_START.sub(lambda found: _entities(found[0]), unlinked)


def _entities(text: str) -> str:
    return "".join(f"&#{ord(character)};" for character in text)


def written(text: str) -> Markup:
    """Mark a text that is Markdown or HTML already, so that templates do not escape it again."""
    return Markup(text)  # noqa: S704  every caller has escaped foreign text


def _code(text: str) -> Markup:
    """Format a name as a Markdown code span, or as escaped text if a code span cannot hold it."""
    # A code span has no escapes, so text that would end the span is printed without a span.
    if set(visible(text)) & set("`|\\\n\r") or text != text.strip() or not text:
        return written(escape_markdown(text))
    return written(f"`{text}`")


def _finalize(value: object) -> Markup:
    """Escape a value that a template prints.

    Jinja calls this function for each printed value. A value of type `Markup` is Markdown already
    and is returned unchanged.
    """
    return value if isinstance(value, Markup) else written(escape_markdown(str(value)))


@cache
def environment() -> Environment:
    """Return the Jinja environment of all reports, which escapes every value for Markdown."""
    made = Environment(
        loader=FileSystemLoader(Path(__file__).parents[1]),
        # Marks the results of macros and blocks as written by a template.
        autoescape=True,
        finalize=_finalize,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.filters |= {
        "against_hovering": against_hovering,
        "code": _code,
        "degrees": degrees,
        "fixed": fixed,
        "limit": limit_words,
        "one_line": lambda text: written(" ".join(text.split())),
        "rough": rough,
        "percent": percent,
        "seconds": lambda value: f"{value:.6g} s",
        "yes_no": yes_no,
    }
    made.tests["known"] = lambda value: not isnan(value)
    made.globals |= {
        "COUPLING_WORDS": COUPLING_WORDS,
        "FIGURE_FOLDER": FIGURE_FOLDER,
        "NOTHING": NOTHING,
        "POWER_WORDS": POWER_WORDS,
        "STATUS_WORDS": STATUS_WORDS,
        "limit_amount": limit_amount,
    }
    return made


def render_markdown(template: str, **values: object) -> str:
    """Fill in a template and return the Markdown, with one blank line between blocks.

    Parameters
    ----------
    template : str
        Template, as a path below the package's folder.
    **values
        Variables of the template; texts are escaped for Markdown.
    """
    text = environment().get_template(template).render(values)
    return re.sub(r"\n{3,}", "\n\n", text).strip() + "\n"
