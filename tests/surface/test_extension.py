"""Surfaces of which a part goes on as the rest of them leads."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.shapes import tube
from toile.surface.extension import continued


@pytest.fixture
def sleeve():
    """A tube at rest, its faces, one whose end is dented inwards by up to 3 cm on one side, and where it is."""
    rest, F = tube(40, 48, 0.1, 0.4)
    free = (rest[:, 2] < 0.04) & (rest[:, 0] > 0.02)
    return rest, F, rest - np.outer(free * (0.04 - rest[:, 2]), [0.75, 0, 0]), free


def test_a_dented_end_of_a_tube_goes_on_as_the_tube(sleeve):
    rest, F, dented, free = sleeve
    radius = np.hypot(*continued(rest, F, dented, free)[:, :2].T)
    assert np.abs(np.hypot(*dented[:, :2].T) - 0.1).max() > 0.025
    assert np.abs(radius - 0.1).max() < 0.005


def test_what_is_not_free_keeps_its_bits_and_whatever_lay_in_the_gap_is_forgotten(sleeve):
    rest, F, dented, free = sleeve
    out = continued(rest, F, dented, free)
    np.testing.assert_array_equal(out[~free], dented[~free])
    np.testing.assert_array_equal(out, continued(rest, F, np.where(free[:, None], 7.0, dented), free))


def test_it_moves_with_the_surface(sleeve):
    rest, F, dented, free = sleeve
    R, t = Rotation.from_rotvec([0.4, -1.0, 0.3]).as_matrix(), np.array([3.0, 1, 2])
    moved = continued(rest, F, dented @ R.T + t, free)
    np.testing.assert_allclose(moved, continued(rest, F, dented, free) @ R.T + t, atol=1e-9)


@pytest.mark.parametrize("share", [0, 1])
def test_without_a_lead_or_without_need_all_stays(sleeve, share):
    rest, F, dented, _ = sleeve
    np.testing.assert_array_equal(continued(rest, F, dented, np.full(len(rest), bool(share))), dented)


def test_a_part_of_its_own_that_is_free_as_a_whole_stays(sleeve):
    rest, F, dented, free = sleeve
    n = len(rest)
    both, faces = np.concatenate([rest, rest + [0, 1, 0]]), np.concatenate([F, F + n]).astype(np.int32)
    out = continued(both, faces, np.concatenate([dented] * 2), np.concatenate([free, np.ones(n, bool)]))
    np.testing.assert_array_equal(out[n:], dented)
    np.testing.assert_allclose(out[:n], continued(rest, F, dented, free), atol=1e-9)
