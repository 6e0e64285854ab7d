"""A file that is made to keep the parser busy is answered at once, in one line."""

import subprocess
import sys
from time import process_time

import pytest

from pyomo_quad.scenario.messages import ScenarioError
from pyomo_quad.scenario.resolution import read_toml
from tests.command import ENVIRONMENT
from tests.fuzz.hostile import hostile_files

# Those on which the work once grew with the square of the size.
LONG_WORDS = ("dashes", "underscores", "digits", "dates", "long key", "quotes", "dotted key")
PATIENCE_S = 60


def test_all_hostile_files_together_take_seconds():
    command = [sys.executable, "-m", "tests.fuzz.hostile", "40000"]
    done = subprocess.run(
        command, env=ENVIRONMENT, capture_output=True, text=True, timeout=PATIENCE_S, check=True
    )
    assert int(done.stdout) > len(hostile_files(1))


def seconds(file, text):
    """Return the least of three, which the machine's other work disturbs least."""
    file.write_text(text, newline="")
    spent = []
    for _ in range(3):
        started = process_time()
        with pytest.raises(ScenarioError):
            read_toml(file)
        spent.append(process_time() - started)
    return min(spent)


@pytest.mark.parametrize("name", LONG_WORDS)
def test_the_work_grows_no_faster_than_the_file(name, tmp_path):
    small, large = (
        seconds(tmp_path / "hostile.toml", hostile_files(size)[name] + "\n]")
        for size in (2000, 64000)
    )
    assert large < 0.05 + 32 * 5 * small


def test_brackets_and_dots_in_texts_and_comments_are_not_counted(tmp_path):
    file = tmp_path / "harmless.toml"
    many = "[" * 100 + "a." * 100
    file.write_text(
        f'title = "{many}\\" {many}" # {many}\nother = \'{many}\'\n'
        f'long = """\n{many} "" {many}"""\nraw = \'\'\'{many}\n\'{many}\'\'\'\n'
    )
    assert set(read_toml(file)) == {"title", "other", "long", "raw"}
