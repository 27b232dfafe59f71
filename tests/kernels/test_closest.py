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
