"""CITATION.cff, the changelog and the metadata name one version, and where the book is."""

import re
import tomllib
from pathlib import Path

from pyomo_quad.version import __version__

ROOT = Path(__file__).parents[2]
CITATION = (ROOT / "CITATION.cff").read_text(encoding="utf-8").splitlines()
CHANGELOG = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_the_citation_names_this_version():
    assert f"version: {__version__}" in CITATION


def test_the_changelog_has_a_page_on_this_version():
    released = re.split(r"^## ", CHANGELOG, flags=re.MULTILINE)
    (own,) = [part for part in released if part.startswith(f"[{__version__}]")]
    date = re.search(r"\d{4}-\d{2}-\d{2}", own.splitlines()[0])[0]
    assert f"date-released: {date}" in CITATION
    assert len(own.splitlines()) <= 80


def test_the_metadata_names_the_book():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert f"url: {project['urls']['Documentation']}" in CITATION
