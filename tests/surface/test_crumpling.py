"""Stretched and turned faces of a garment."""

import numpy as np
import pytest

from tests.support.shapes import tube
from toile.surface.crumpling import crumpling


def test_crumpling_of_a_rigid_motion_a_stretch_and_a_fold_is_exact():
    V, F = tube(20, 24, 0.1, 0.5)
    turned = V @ np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]]).T + [1, 2, 3]
    found = crumpling(V, turned, turned, F)
    assert found["stretch_p95"] == pytest.approx(1, abs=1e-6) and found["flipped_share"] == 0
    assert crumpling(V, V, V * [1, 1, 2.5], F)["stretch_p95"] == pytest.approx(2.5, abs=1e-9)
    through = V * [1, 1, -1]  # the tube mirrored along its axis: every face looks inwards
    assert crumpling(V, V, through, F) == pytest.approx({"stretch_p95": 1, "flipped_share": 1})
