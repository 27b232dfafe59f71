"""Lenses."""

import numpy as np
import pytest

from toile.lens import distort, lens_limit
from toile.scene import Camera


def polynomial(xy, lens):
    k1, k2, p1, p2, k3 = lens
    x, y = xy.T
    r2 = x * x + y * y
    radial, xy2 = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), 2 * x * y
    return np.stack([x * radial + p1 * xy2 + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + p2 * xy2], 1)


@pytest.mark.parametrize(
    "lens",
    [
        [-0.3, 0, 0, 0, 0],
        [-0.3, 0, 0.004, -0.003, 0],
        [-0.28, 0.09, 0, 0, -0.01],
        [-0.12, 0.05, 0.001, -0.002, 0],
        [0.2, 0, 0, 0, 0],
        [0] * 5,
    ],
)
def test_a_lens_moves_places_by_its_polynomial_as_far_as_that_grows_and_folds_none_back(lens):
    rng, lens = np.random.default_rng(0), np.array(lens)
    r = np.linspace(0, 5, 5001)[1:]
    falls = np.diff(r * (1 + lens[0] * r**2 + lens[1] * r**4 + lens[4] * r**6)) <= 0
    turn = r[np.flatnonzero(falls)[0]] if falls.any() else np.inf
    limit = lens_limit(lens)
    assert abs(limit * turn - 1) < 2e-3 if falls.any() else limit < 0.2
    xy = rng.uniform(-4, 4, (500, 2))
    near = np.linalg.norm(xy, axis=1) < turn - 0.002
    moved, slope = distort(xy, lens, limit, derivative=True)
    assert (moved == distort(xy, lens, limit)).all()
    np.testing.assert_allclose(moved[near], polynomial(xy[near], lens), rtol=1e-12)
    for i, step in enumerate(1e-6 * np.eye(2)):
        difference = (distort(xy + step, lens, limit) - distort(xy - step, lens, limit)) / 2e-6
        np.testing.assert_allclose(slope[:, :, i], difference, rtol=1e-5, atol=1e-5)
    for angle in np.linspace(0, 6, 7):
        ray = r[:, None] * [np.cos(angle), np.sin(angle)]
        camera = Camera("a", 640, 480, np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]), lens, np.eye(4))
        pixels = camera.project(np.c_[ray, np.ones(len(ray))])[0]
        out = np.linalg.norm(pixels - [320, 240], axis=1)
        assert (np.maximum.accumulate(out) - out).max() < 0.2  # what the tangential terms may take back
