"""Frame numbers."""

import pytest

from toile.frame_numbers import evenly, frame_ranges


def test_frame_numbers_in_words_are_the_runs_of_them():
    assert frame_ranges([1, 2, 3, 7, 9, 10]) == "1-3, 7, 9-10" and frame_ranges([]) == ""
    assert frame_ranges([1, 3, 5, 6, 8], 2) == "1, 3, ..." and frame_ranges([1, 3], 2) == "1, 3"
    assert frame_ranges([0, 1, 2, 7], between=",") == "0-2,7"


@pytest.mark.parametrize(
    "n, count, wanted",
    [(7, 3, [0, 3, 6]), (5, 9, [0, 1, 2, 3, 4]), (4, 1, [0]), (1, 3, [0]), (10, 4, [0, 3, 6, 9]), (0, 3, [])],
)
def test_items_are_spread_evenly_with_both_ends(n, count, wanted):
    assert evenly(range(n), count) == wanted
