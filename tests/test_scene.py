"""The types that flow through the pipeline."""

from toile.scene import frame_ranges


def test_frame_numbers_in_words_are_the_runs_of_them():
    assert frame_ranges([1, 2, 3, 7, 9, 10]) == "1-3, 7, 9-10" and frame_ranges([]) == ""
    assert frame_ranges([1, 3, 5, 6, 8], 2) == "1, 3, ..." and frame_ranges([1, 3], 2) == "1, 3"
    assert frame_ranges([0, 1, 2, 7], between=",") == "0-2,7"
