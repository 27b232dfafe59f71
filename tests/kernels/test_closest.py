"""SurfaceIndex: what a guess may and may not do."""

import numpy as np
import pytest
import trimesh

from toile import kernels


def test_a_guess_changes_nothing():
    mesh = trimesh.creation.icosphere(subdivisions=4)
    index, rng = kernels.SurfaceIndex(mesh.vertices, mesh.faces), np.random.default_rng(0)
    points = rng.normal(size=(2000, 3))
    points[:200] = mesh.vertices[:200]  # ties of all faces around
    plain = index.closest(points)
    for guess in (plain[0], rng.integers(-1, len(mesh.faces), 2000), np.full(2000, 7)):
        assert all(np.array_equal(a, b) for a, b in zip(plain, index.closest(points, guess=guess)))
    near = index.closest(points, 0.3)
    assert (near[0] < 0).any() and all(
        np.array_equal(a, b) for a, b in zip(near, index.closest(points, 0.3, guess=plain[0]))
    )


def test_guesses_that_name_no_face_are_refused():
    mesh = trimesh.creation.icosphere(subdivisions=1)
    index = kernels.SurfaceIndex(mesh.vertices, mesh.faces)
    with pytest.raises(kernels.InputError, match=r"closest: guess\[1\] is face 80 of 80"):
        index.closest(np.zeros((2, 3)), guess=[3, 80])
    with pytest.raises(kernels.InputError, match="closest: guess has 1 entries, points 2"):
        index.closest(np.zeros((2, 3)), guess=[3])


def bent_sheet():
    """A sheet 40 x 10 cm bent double, its halves 1 cm apart: V, F, the first half below."""
    u, v = np.meshgrid(np.linspace(0, 0.4, 41), np.linspace(0, 0.1, 11), indexing="ij")
    bend = np.pi * np.clip((u - 0.19) / 0.02, 0, 1)
    x = np.minimum(np.minimum(u, 0.4 - u), 0.19) + 0.005 * np.sin(bend)
    V = np.stack([x, v, 0.005 * (1 - np.cos(bend))], -1).reshape(-1, 3)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(40), np.arange(10), indexing="ij"))
    corner = [11 * i + j, 11 * i + 11 + j, 11 * i + 12 + j, 11 * i + 1 + j]
    return V, np.concatenate([np.stack([corner[k] for k in t], 1) for t in ((0, 1, 2), (0, 2, 3))]).astype(np.int32)


def test_what_is_reached_lies_on_the_sheet_that_it_started_from():
    V, F = bent_sheet()
    index = kernels.SurfaceIndex(V, F)
    lower = (V[F][:, :, 2] < 0.002).all(1)
    points = np.stack(
        [np.linspace(0.02, 0.17, 50), np.full(50, 0.05), np.full(50, 0.008)], 1
    )  # nearer to the upper one
    assert not lower[index.closest(points)[0]].any()
    start = np.full(50, np.flatnonzero(lower)[0])
    face, at, bary, distance = index.reached(points, start)
    assert lower[face].all() and np.allclose(distance, 0.008)
    assert np.allclose(at, np.einsum("nk,nki->ni", bary, V[F[face]])) and np.allclose(at[:, :2], points[:, :2])


def test_on_a_convex_mesh_the_nearest_of_all_is_reached_from_anywhere():
    mesh = trimesh.creation.icosphere(subdivisions=4)
    index, rng = kernels.SurfaceIndex(mesh.vertices, mesh.faces), np.random.default_rng(1)
    points = rng.normal(size=(1000, 3))
    points *= rng.uniform(1.01, 2, (1000, 1)) / np.linalg.norm(points, axis=1, keepdims=True)
    near = index.closest(points)
    found = index.reached(points, near[0][rng.permutation(1000)])
    assert np.allclose(found[3], near[3], atol=1e-12)


def test_nothing_is_reached_across_a_gap_and_a_border_is_an_end():
    V = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [3, 0, 0], [2, 1, 0]], np.float64)
    index = kernels.SurfaceIndex(V, np.array([[0, 1, 2], [3, 4, 5]], np.int32))
    face, at, _, distance = index.reached(np.array([[2.2, 0.2, 0.0]]), [0])
    assert face[0] == 0 and np.allclose(at[0], [1, 0, 0]) and np.isclose(distance[0], np.hypot(1.2, 0.2))


def test_starts_that_name_no_face_are_refused():
    mesh = trimesh.creation.icosphere(subdivisions=1)
    index = kernels.SurfaceIndex(mesh.vertices, mesh.faces)
    for start in ([3, 80], [3, -1]):
        with pytest.raises(kernels.InputError, match=rf"reached: start\[1\] is face {start[1]} of 80"):
            index.reached(np.zeros((2, 3)), start)
    with pytest.raises(kernels.InputError, match="reached: start has 1 entries, points 2"):
        index.reached(np.zeros((2, 3)), [3])
    with pytest.raises(kernels.InputError, match="reached: points"):
        index.reached(np.full((1, 3), np.nan), [3])


@pytest.mark.parametrize("height", [1e-3, 1e-6, 1e-9, 1e-13, 0.0])
def test_of_a_triangle_with_a_corner_all_but_on_the_opposite_edge_no_edge_is_nearer_than_the_nearest_point(height):
    rng = np.random.default_rng(4)
    for _ in range(200):
        a, along, off = rng.normal(size=(3, 3))
        V = rng.permutation([a, a + along, a + rng.uniform() * along + height * off])
        p = a + rng.uniform(-0.5, 1.5) * along + rng.normal(size=3) * 10 ** rng.uniform(-4, 0.5)
        _, point, bary, distance = kernels.SurfaceIndex(V, [[0, 1, 2]]).closest(p[None])
        edge = np.roll(V, -1, 0) - V
        t = np.clip(((p - V) * edge).sum(1) / (edge**2).sum(1), 0, 1)
        assert distance[0] <= np.linalg.norm(V + t[:, None] * edge - p, axis=1).min() + 1e-9
        assert np.allclose(point[0], bary[0] @ V, atol=1e-12) and bary[0].min() >= 0
