"""LoopInterpolation against the same problem as a dense matrix."""

import numpy as np
import pytest

from toile.config import preset
from toile.surface.curves import Curve, tangents
from toile.surface.loops import LoopInterpolation

SETTINGS = preset("standard").dress.loop


def dense(wanted, known, at, bending, hold=1e-6):
    """The normal equations, entry by entry."""
    k, way = len(at), tangents(Curve(at, True))
    stretch = SETTINGS.stretch + SETTINGS.stretch_share * bending
    first, second = np.roll(np.eye(k), -1, 0) - np.eye(k), np.roll(np.eye(k), -1, 0) + np.roll(np.eye(k), 1, 0)
    second -= 2 * np.eye(k)
    A = np.kron(bending * second.T @ second + stretch * first.T @ first, np.eye(3)) + hold * np.eye(3 * k)
    b = np.zeros(3 * k)
    for i in np.flatnonzero(known):
        P = np.eye(3) - (1 - SETTINGS.slide) * np.outer(way[i], way[i])
        A[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += P
        b[3 * i : 3 * i + 3] = P @ wanted[i]
    return np.linalg.solve(A, b).reshape(-1, 3)


@pytest.mark.parametrize("k", [3, 4, 5, 6, 21, 90])
@pytest.mark.parametrize("bending", [30.0, 0.3])
def test_the_folded_band_solves_the_closed_loop(k, bending):
    rng, angle = np.random.default_rng(k), np.arange(k) * 2 * np.pi / k
    at = 0.1 * np.stack([np.cos(angle), np.sin(angle), rng.normal(0, 0.1, k)], 1)
    wanted, known = rng.normal(0, 0.01, (k, 3)), rng.random(k) < 0.7
    known[0] = True
    solve = LoopInterpolation([k], SETTINGS)
    for _ in range(2):  # nothing is left of the first call
        assert np.abs(solve(wanted, known, at, bending) - dense(wanted, known, at, bending)).max() < 1e-11


def test_a_loop_moves_as_a_whole_where_all_of_it_is_asked_to():
    at = np.random.default_rng(0).normal(size=(30, 3))
    moved = LoopInterpolation([30], SETTINGS)(np.full((30, 3), 0.01), np.ones(30, bool), at, 30.0)
    assert np.abs(moved - 0.01).max() < 1e-6
