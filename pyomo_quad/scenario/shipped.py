"""The shipped scenarios, which own ones start from: in a checkout or in the installed package."""

import re
from collections.abc import Mapping
from pathlib import Path

from pyomo_quad.scenario.messages import ScenarioError, shown
from pyomo_quad.scenario.schema import NAME_PATTERN

# A wheel carries them inside the package; a checkout has them beside it.
_PACKAGE = Path(__file__).parents[1]
_PLACES = (_PACKAGE / "shipped", _PACKAGE.parent / "scenarios")
_STUDY = "study_"
#: The paper's own mission goes by a short name.
_SHORT_NAMES = {"paper": "paper_calm"}
_NAME = re.compile(r'^name = ".*"$', re.MULTILINE)
_SCHEMA_LINE = "#:schema ./scenario.schema.json\n"


def shipped_scenarios() -> Mapping[str, Path]:
    """Return the file of each shipped scenario by its name, the short ones included."""
    place = next(place for place in _PLACES if place.is_dir())
    found = {f.stem: f for f in sorted(place.glob("*.toml")) if not f.stem.startswith(_STUDY)}
    return {short: found[name] for short, name in _SHORT_NAMES.items() if name in found} | found


def started_scenario(template: str, name: str) -> str:
    """Return the text of a shipped scenario under another name.

    Raises
    ------
    ScenarioError
        If there is no such scenario, or the name is none.
    """
    shipped = shipped_scenarios()
    if template not in shipped:
        raise ScenarioError(
            f"--from {shown(template)[1:-1]}: must be one of {', '.join(sorted(shipped))}."
        )
    if not re.fullmatch(NAME_PATTERN, name):
        raise ScenarioError(
            f"NAME = {shown(name)}; must be 1 to 64 letters, digits, '_', '-' or '.', starting "
            "with a letter or digit."
        )
    text = shipped[template].read_text(encoding="utf-8")
    hint = (
        f"# Begun from {template}. `pyomo-quad check {name}.toml` shows every field, "
        f"`pyomo-quad run {name}.toml` flies it.\n"
    )
    named = _NAME.sub(f'name = "{name}"', text, count=1)
    return named.replace(_SCHEMA_LINE, _SCHEMA_LINE + hint, 1)
