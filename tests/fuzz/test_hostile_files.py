"""A file that is made to keep the parser busy is answered, in one line."""

import subprocess
import sys

import pytest

from pyomo_quad.scenario.resolution import LARGEST_FILE_BYTES, read_toml
from tests.command import ENVIRONMENT
from tests.fuzz.hostile import hostile_files

# Those on which the work once grew with the square of the size.
LONG_WORDS = ("dashes", "underscores", "digits", "dates", "long key", "quotes", "dotted key")
PATIENCE_S = 300


def refused(size, *names):
    """Return how many hostile files were refused by a process that must come to an end."""
    command = [sys.executable, "-m", "tests.fuzz.hostile", str(size), *names]
    done = subprocess.run(
        command, env=ENVIRONMENT, capture_output=True, text=True, timeout=PATIENCE_S, check=True
    )
    return int(done.stdout)


@pytest.mark.lengthy
def test_all_hostile_files_come_to_an_end():
    assert refused(40_000) > len(hostile_files(1))


@pytest.mark.lengthy
def test_long_words_come_to_an_end_at_the_largest_size_that_is_read():
    """Work that grew with the square of the size would take an hour."""
    assert refused(LARGEST_FILE_BYTES - 100, *LONG_WORDS) >= len(LONG_WORDS)


def test_brackets_and_dots_in_texts_and_comments_are_not_counted(tmp_path):
    file = tmp_path / "harmless.toml"
    many = "[" * 100 + "a." * 100
    file.write_text(
        f'title = "{many}\\" {many}" # {many}\nother = \'{many}\'\n'
        f'long = """\n{many} "" {many}"""\nraw = \'\'\'{many}\n\'{many}\'\'\'\n'
    )
    assert set(read_toml(file)) == {"title", "other", "long", "raw"}
