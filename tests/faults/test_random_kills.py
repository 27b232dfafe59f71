"""A registration killed at random instants goes on to the bits of an undisturbed one; see random_kills for a hundred."""

import pytest

from tests.faults.random_kills import kill_at_random


@pytest.mark.slow(seconds=90)
@pytest.mark.parametrize("workers", [1, 2])
def test_kills_at_random_instants_lose_nothing(tmp_path, workers):
    found = kill_at_random(tmp_path, kills=5, workers=workers, seed=workers)
    assert found["kills"] == 5 and found["ended"] >= 1
