"""A short run of the fuzz campaign; `python -m tests.fuzz` makes a long one."""

import pytest

from tests.fuzz.campaign import run_campaign


@pytest.mark.lengthy
@pytest.mark.parametrize("seed", [1, *(pytest.param(n, marks=pytest.mark.slow) for n in (2, 3))])
def test_damaged_input_is_answered_in_one_line(tmp_path, seed):
    statuses = run_campaign(tmp_path, 60, seed)
    assert statuses.total() == 60
    assert len(statuses) == 2  # some inputs survive their damage, some do not
