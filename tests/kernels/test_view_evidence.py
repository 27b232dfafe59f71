"""view_odds and view_edges against the same told view by view in numpy, and their laws."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from toile import kernels

LABELS = 3
ODDS = dict(tolerance=0.02, min_cosine=0.15, floating=0.02, behind=0.5, most=4.0)
EDGES = dict(tolerance=0.02, min_cosine=0.15, flank=0.55, contrast=0.1, disorder=0.1, shift=0.6)
K = np.array([[60.0, 0.3, 33], [0, 58, 25], [0, 0, 1]])


class Camera:
    """A camera that looks at the origin from 4 m, with noise for depths and picture."""

    def __init__(self, seed, channels=2 * LABELS + 4):
        rng = np.random.default_rng(seed)
        self.T, self.distortion = np.eye(4), rng.normal(0, 0.02, 5)
        self.T[:3, :3], self.T[:3, 3] = Rotation.from_rotvec([0, rng.uniform(0, 6), 0]).as_matrix(), [0, 0, 4]
        self.depth = rng.uniform(3.5, 4.2, (48, 64))
        self.depth[rng.random((48, 64)) < 0.1] = np.inf
        self.picture = rng.random((40, 50, channels)).astype(np.float32)
        self.corner = np.array([7.0, 3.0])

    @property
    def view(self):
        return kernels.View(K, self.distortion, self.T, self.depth, self.picture, self.corner)

    def see(self, points, normals):
        see = points, normals, K, self.distortion, self.T, self.depth
        return kernels.visibility(*see, ODDS["tolerance"], ODDS["min_cosine"])

    def read(self, uv):
        return kernels.bilinear(self.picture, uv - self.corner).astype(np.float64)


def scene(n, seed=1):
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(n, 3))
    return rng.normal(0, 0.4, (n, 3)), normals / np.linalg.norm(normals, axis=1, keepdims=True)


def odds_by_views(cameras, points, normals, column, rival, free):
    out, i, L = np.zeros((len(points), 5)), np.arange(len(points)), LABELS
    for camera in cameras:
        uv, w, clear = camera.see(points, normals)
        at = camera.read(uv)
        if free:
            floats = clear > ODDS["floating"]
            out[floats, 4] = np.maximum(out[floats, 4], at[floats, -1])
            w = np.where(floats & (at[:, L + column] > ODDS["behind"]), 0, w)
        given = at[:, L : 2 * L]
        against = given.sum(1) - given[:, column] if free else given[i, rival]
        ratio = np.clip(at[:, column] - at[i, rival], -ODDS["most"], ODDS["most"])
        out[:, :4] += w[:, None] * np.stack([ratio, np.ones_like(w), given[:, column], against], 1)
    return out


@pytest.mark.parametrize("free", [False, True])
def test_odds_are_those_of_each_view_added(free):
    cameras, (points, normals) = [Camera(k) for k in range(3)], scene(800)
    rival = np.random.default_rng(3).integers(0, LABELS, len(points))
    found = kernels.view_odds([c.view for c in cameras], points, normals, LABELS, 1, rival, free=free, **ODDS)
    expected = odds_by_views(cameras, points, normals, 1, rival, free)
    assert np.abs(found - expected).max() < 1e-6  # the pictures are of single precision
    assert (found[:, 1] > 0).sum() > 100 and (found[:, 4] > 0).any() == free


def test_one_picture_s_ratio_is_bounded_and_no_view_says_nothing():
    camera, (points, normals) = Camera(0), scene(300)
    camera.picture[..., 1] = 100
    found = kernels.view_odds([camera.view], points, normals, LABELS, 1, np.zeros(300, int), **ODDS)
    seen = found[:, 1] > 0
    assert seen.any() and np.allclose(found[seen, 0], ODDS["most"] * found[seen, 1])
    assert not kernels.view_odds([], points, normals, LABELS, 1, np.zeros(300, int), **ODDS).any()


def profiles(shift, k=6):
    """k profiles across the plane z = 0 seen from 4 m, whose colour changes `shift` from their middle; the views see all."""
    s, camera = np.linspace(-0.4, 0.4, 41), Camera(0)
    camera.T[:3, :3], camera.distortion, camera.corner = np.diag([1.0, -1, -1]), np.zeros(5), np.zeros(2)
    camera.depth = np.full((48, 64), 4.0)
    across = (np.arange(64) + 0.5 - K[0, 2]) / K[0, 0] * 4
    ramp = np.clip((across - shift) / (4 / K[0, 0]) + 0.5, 0, 1)  # the border pixel mixes both colours
    camera.picture = np.zeros((48, 64, 2 * LABELS + 4), np.float32)
    camera.picture[..., 2 * LABELS : 2 * LABELS + 3] = (ramp[:, None] * [0.5, 0.2, -0.3] + [0.2, 0.3, 0.6]).astype("f4")
    points = np.zeros((k, len(s), 3))
    points[..., 0], points[..., 1] = s, np.linspace(-0.2, 0.2, k)[:, None]
    return camera, points.reshape(-1, 3), np.tile([0.0, 0, 1], (points.size // 3, 1)), s


@pytest.mark.parametrize("shift", [-0.13, 0.0, 0.02, 0.11])
def test_an_edge_is_found_where_the_colours_change(shift):
    camera, points, normals, s = profiles(shift)
    total, weight = kernels.view_edges([camera.view] * 2, points, normals, LABELS, s, **EDGES).T
    assert (weight > 0.1).all() and np.abs(total / weight - shift).max() < 0.004  # pixels are 67 mm wide


def test_profiles_of_one_colour_or_out_of_sight_say_nothing():
    camera, points, normals, s = profiles(0.0)
    assert not kernels.view_edges([camera.view], points, -normals, LABELS, s, **EDGES).any()
    camera.picture[:] = 0.5
    assert kernels.view_edges([camera.view], points, normals, LABELS, s, **EDGES)[:, 1].max() < 1e-12


def test_the_number_of_threads_is_no_matter(threads):
    cameras, (points, normals) = [Camera(k) for k in range(3)], scene(3000)
    rival, found = np.zeros(len(points), int), []
    for count in (1, 3):
        threads(count)
        found.append(kernels.view_odds([c.view for c in cameras], points, normals, LABELS, 1, rival, free=True, **ODDS))
    assert np.array_equal(*found)


def test_what_does_not_fit_is_refused():
    camera, (points, normals) = Camera(0), scene(10)
    for call, said in (
        (
            lambda: kernels.view_odds([camera.view], points, normals[:5], LABELS, 1, np.zeros(10, int), **ODDS),
            "normals",
        ),
        (lambda: kernels.view_odds([camera.view], points, normals, 2, 1, np.zeros(10, int), **ODDS), "channels"),
        (lambda: kernels.view_odds([camera.view], points, normals, LABELS, 3, np.zeros(10, int), **ODDS), "column"),
        (lambda: kernels.view_odds([camera.view], points, normals, LABELS, 1, np.full(10, 3), **ODDS), "rival"),
        (lambda: kernels.view_edges([camera.view], points, normals, LABELS, np.arange(-1.0, 2.0), **EDGES), "profile"),
    ):
        with pytest.raises(kernels.InputError, match=said):
            call()
    with pytest.raises(TypeError, match="no option named"):
        kernels.view_odds([camera.view], points, normals, LABELS, 1, np.zeros(10, int), far=1)
