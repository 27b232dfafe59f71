"""What the studio cuts from a body."""

import numpy as np

from tests.support.shapes import tube
from toile.studio.cut import smoothed


def test_smoothing_moves_the_border_along_the_border_only():
    V, F = tube(12, 40, 0.2, 0.6)
    inner = np.abs(V[:, 2:] - 0.3) < 0.299
    rough = V + np.random.default_rng(0).normal(0, 0.01, V.shape) * inner
    done = smoothed(rough, F)
    np.testing.assert_allclose(done[~inner[:, 0], 2], V[~inner[:, 0], 2], atol=1e-12)
    bends = lambda X: np.abs(np.diff(X.reshape(12, 40, 3)[:, :, 2], 2, axis=0)).mean()
    assert bends(done) < 0.5 * bends(rough)
