"""A plan file from a stranger is read as data or refused in one line."""

import random
import zipfile

import numpy as np
import pytest

from pyomo_quad import Plan
from pyomo_quad.scenario import ScenarioError
from tests.fuzz.mutations import damaged


@pytest.fixture(scope="module")
def content(tmp_path_factory):
    """A file with the names of a plan's arrays and nothing sound in them."""
    file = tmp_path_factory.mktemp("plan") / "plan.npz"
    names = ("about", "breakpoints", "degrees", "states", "controls", "energy", "costates")
    with file.open("wb") as stream:
        np.savez(stream, **{name: np.arange(3.0) for name in names})
    return file.read_bytes()


def assert_refused(file):
    with pytest.raises(ScenarioError, match=r"plan\.npz: ") as caught:
        Plan.load(file)
    assert len(str(caught.value).splitlines()) == 1


def test_damaged_plan_files_are_refused(content, tmp_path):
    chance = random.Random(7)
    file = tmp_path / "plan.npz"
    for _ in range(300):
        file.write_bytes(damaged(content, chance))
        assert_refused(file)


def test_pickled_objects_are_refused(tmp_path):
    file = tmp_path / "plan.npz"
    with file.open("wb") as stream:
        np.savez(stream, about=np.array([{"run": print}], dtype=object))
    assert_refused(file)


@pytest.mark.lengthy
def test_a_zip_bomb_is_refused(tmp_path):
    file = tmp_path / "plan.npz"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("about.npy", bytes(300 * 1024 * 1024))
    assert_refused(file)
