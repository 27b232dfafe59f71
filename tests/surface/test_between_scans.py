"""What frames without scans take from those with: all of it between near scans, nothing from far ones, and no jump anywhere."""

import numpy as np
import pytest

from toile.surface.between_scans import between_scans, told_by

RNG = np.random.default_rng(3)


def scanned_at(T, *scans):
    return np.isin(np.arange(T), scans)


def test_scanned_frames_keep_their_bits_and_so_do_all_where_no_scan_is():
    y = RNG.standard_normal((9, 5, 3))
    filled = between_scans(y, scanned_at(9, 0, 4, 8), 30)
    assert np.array_equal(filled[[0, 4, 8]], y[[0, 4, 8]])
    assert np.array_equal(between_scans(y, scanned_at(9), 30), y)
    assert np.array_equal(between_scans(y, scanned_at(9, *range(9)), 30), y)


def test_between_scans_nothing_is_left_of_what_was_guessed():
    y, guessed = np.zeros((13, 4, 3)), RNG.standard_normal((13, 4, 3))
    y[[0, 6, 12]] = RNG.standard_normal((3, 4, 3))
    scanned = scanned_at(13, 0, 6, 12)
    other = np.where(scanned[:, None, None], y, guessed)
    assert np.allclose(between_scans(y, scanned, 6), between_scans(other, scanned, 6), atol=1e-12)
    assert np.allclose(between_scans(y, scanned, 6)[3], (y[0] + y[6]) / 2)  # half way


def test_what_all_scans_share_is_kept_and_nothing_leaves_its_two_scans():
    still = np.broadcast_to(RNG.standard_normal((4, 3)), (11, 4, 3)).copy()
    wrong = still + np.where(scanned_at(11, 0, 5, 10), 0, 1)[:, None, None]
    assert np.allclose(between_scans(wrong, scanned_at(11, 0, 5, 10), 10), still)
    y = RNG.standard_normal((11, 4, 3))
    filled = between_scans(y, scanned_at(11, 0, 10), 10)
    low, high = np.minimum(y[0], y[10]), np.maximum(y[0], y[10])
    assert (filled >= low - 1e-12).all() and (filled <= high + 1e-12).all()


@pytest.mark.parametrize("reach", [3, 8, 20, 60])
def test_nothing_jumps_whatever_the_gaps(reach):
    """Gaps shorter and longer than the reach, and both ends; guesses and scans that stand apart."""
    T = 120
    scanned = scanned_at(T, 20, 26, 32, 70, 75)
    y = np.where(scanned, 1.0, 0.0)[:, None, None]
    filled = between_scans(y, scanned, reach)[:, 0, 0]
    assert np.abs(np.diff(filled)).max() <= 1.5 / min(reach, 5) + 1e-12  # the steepest of a smooth step
    assert filled[:20].max() < 1 and (reach >= 50 or filled[119] == 0)
    assert np.allclose(filled[20:33], 1) or reach < 6


def test_what_lies_beyond_the_reach_tells_nothing():
    """So a window that holds a frame's reach gives the frame its bits, whatever else it holds."""
    reach, T = 10, 90
    y = RNG.standard_normal((T, 3, 3))
    scanned = RNG.random(T) < 0.06
    scanned[[5, 80]] = True
    whole = between_scans(y, scanned, reach)
    for t in range(reach, T - reach):
        window = slice(t - reach, t + reach + 1)
        assert np.array_equal(between_scans(y[window], scanned[window], reach)[reach], whole[t])


def test_who_tells_a_frame_is_who_gives_it_at_least_half():
    scanned = scanned_at(40, 10, 15, 35)
    told = told_by(scanned, 6)
    assert told[[10, 15, 35]].tolist() == [10, 15, 35]
    assert told[11:15].tolist() == [10, 10, 15, 15]  # between near scans always one of them
    assert told[[7, 6, 18, 19, 32, 31]].tolist() == [10, 6, 15, 19, 35, 31]  # half the reach, and beyond
    assert np.array_equal(told_by(scanned_at(5), 6), np.arange(5))
    for t in range(40):
        one = between_scans(np.eye(40)[:, :, None], scanned, 6)[t, :, 0]
        assert one[told[t]] == pytest.approx(one.max())
