"""raster at the edges of what it may be given: each row is solved or refused."""

import numpy as np
import pytest

from toile.kernels import InputError, raster

K = np.array([[100.0, 0, 32], [0, 100.0, 24], [0, 0, 1]])
SIZE = (48, 64)


def sheet(n=10, distance=2.0):
    """A wavy square before the camera that fills its image, (n+1)^2 vertices."""
    x, y = np.meshgrid(np.linspace(-1, 1, n + 1), np.linspace(-1, 1, n + 1))
    a = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)[:-1, :-1].ravel()
    F = np.concatenate([np.c_[a, a + 1, a + n + 2], np.c_[a, a + n + 2, a + n + 1]])
    return np.stack([x, y, distance + 0.1 * np.sin(3 * x) * np.cos(2 * y)], -1).reshape(-1, 3), F


@pytest.mark.parametrize("scale", [1e-6, 1e3, 1e6])
def test_raster_solved_in_any_unit(scale):
    V, F = sheet()
    one, other = raster(V, F, K, SIZE), raster(scale * V, F, K, SIZE)
    same = one.face == other.face
    assert same.mean() > 0.999
    np.testing.assert_allclose(other.depth[same], scale * one.depth[same], rtol=1e-9)


def test_raster_solved_1e6_m_away():
    V, F = sheet()
    far = K * [[1e6], [1e6], [1]]
    far[:2, 2] = K[:2, 2]
    result = raster(V * [2, 2, 1] + [0, 0, 1e6], F, far / [[2], [2], [1]] + [[0, 0, 16], [0, 0, 12], [0, 0, 0]], SIZE)
    assert (result.face >= 0).all() and np.abs(result.depth - 1e6).max() < 3


def needles(V, F):
    tips = V[F[:40, 0]] + 1e-9 * (V[F[:40]].mean(1) - V[F[:40, 0]])
    new = len(V) + np.arange(40)
    fans = [np.column_stack([F[:40, c], F[:40, (c + 1) % 3], new]) for c in range(3)]
    return np.vstack([V, tips]), np.vstack([F[40:], *fans])


def zero_area(V, F):
    return V, np.vstack([F, np.stack([F[:, 0], F[:, 1], F[:, 1]], 1), np.stack([F[:, 0]] * 3, 1)])


def duplicate_faces(V, F):
    return V, np.vstack([F, F[:, [1, 2, 0]], F[:, [0, 2, 1]]])


def isolated_vertices(V, F):
    return np.vstack([V, [[0, 0, 1], [0, 0, 0], [1e30, 0, -1e30]]]), F


@pytest.mark.parametrize("spoil", [needles, zero_area, duplicate_faces, isolated_vertices])
def test_raster_solved_with_bad_faces_and_vertices(spoil):
    V, F = sheet()
    expected = raster(V, F, K, SIZE).depth
    result = raster(*spoil(V, F), K, SIZE)
    assert (result.face >= 0).all()
    np.testing.assert_allclose(result.depth, expected, rtol=1e-5)


def test_raster_solved_with_a_face_through_the_camera_and_one_as_large_as_the_earth():
    V = np.array([[-1e7, 1, -1e7], [1e7, 1, -1e7], [0, 1, 2e7]])
    result = raster(V, [[0, 1, 2]], K, SIZE)
    rows = np.arange(SIZE[0]) + 0.5 - K[1, 2]
    expected = np.where(rows > 0, 100 / np.where(rows > 0, rows, 1), np.inf)
    np.testing.assert_allclose(result.depth, np.tile(expected[:, None], SIZE[1]), rtol=1e-6)
    through = np.array([[-1.0, 0, 0], [1, 0, 0], [0, 0, 1]])  # its plane holds the camera's centre: no width
    assert np.isfinite(raster(through, [[0, 1, 2]], K, SIZE).depth).sum() <= SIZE[1]


def test_raster_solved_when_all_lies_behind_or_beside():
    V, F = sheet()
    for moved in (V * [1, 1, -1], V + [100, 0, 0]):
        assert (raster(moved, F, K, SIZE).face == -1).all()


def test_raster_solved_on_one_pixel_and_on_the_largest_side():
    V, F = sheet()
    assert raster(V, F, K, (1, 1)).face.shape == (1, 1)
    assert raster(V, F, K, (1, 32768)).face.shape == (1, 32768)


def test_raster_solved_on_1_000_000_vertices():
    V, F = sheet(999)
    result = raster(V, F, K, SIZE)
    assert (result.face >= 0).all()
    np.testing.assert_allclose(result.depth, raster(*sheet(100), K, SIZE).depth, atol=1e-3)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_raster_refuses_what_is_not_finite(value):
    V, F = sheet()
    V[33, 2] = value
    with pytest.raises(InputError, match=r"vertices_camera\[33\] is not finite"):
        raster(V, F, K, SIZE)
    bad = K.copy()
    bad[1, 2] = value
    with pytest.raises(InputError, match=r"K\[1\] is not finite"):
        raster(sheet()[0], F, bad, SIZE)
