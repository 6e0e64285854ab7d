"""Runs of the real command that several tests read."""

import pytest

from tests.command import IMPOSSIBLE, solve


@pytest.fixture(scope="session")
def calm(tmp_path_factory):
    """The paper's calm mission, solved."""
    return solve(tmp_path_factory.mktemp("calm") / "report")


@pytest.fixture(scope="session")
def impossible(tmp_path_factory):
    """A mission that cannot be flown: 8 m up in 0.3 s."""
    return solve(tmp_path_factory.mktemp("impossible") / "report", *IMPOSSIBLE, "--json")
