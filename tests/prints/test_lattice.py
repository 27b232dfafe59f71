"""The lattice: interpolation, gradients and blurring on a mesh."""

import numpy as np
import pytest

from toile import kernels
from toile.prints.lattice import Lattice


def patch(n=9, seed=0):
    """A flat, irregular square of 0.4 m in space."""
    x, y = np.meshgrid(np.linspace(0, 0.4, n), np.linspace(0, 0.4, n))
    V = np.stack([x, y, 0 * x], -1).reshape(-1, 3)
    inner = ((V[:, :2] > 0.01) & (V[:, :2] < 0.39)).all(1)
    V[inner, :2] += np.random.default_rng(seed).normal(0, 0.006, (inner.sum(), 2))
    i, j = (k.ravel() for k in np.meshgrid(np.arange(n - 1), np.arange(n - 1), indexing="ij"))
    a = i * n + j
    return V, np.concatenate([np.stack([a, a + 1, a + n + 1], 1), np.stack([a, a + n + 1, a + n], 1)]).astype(np.int32)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_points_are_the_mesh_cut_evenly(n):
    V, F = patch()
    lattice = Lattice(V, F, n)
    edges = kernels.unique_edges(F)
    assert len(lattice) == len(V) + (n - 1) * len(edges) + (n - 1) * (n - 2) // 2 * len(F)
    assert len(lattice.triangles) == n * n * len(F)
    assert np.allclose(kernels.face_areas(lattice.positions, lattice.triangles).sum(), kernels.face_areas(V, F).sum())
    assert np.isclose(lattice.areas.sum(), kernels.face_areas(V, F).sum())
    assert len(np.unique(np.round(lattice.positions, 9), axis=0)) == len(lattice)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_values_between_points_are_linear(n):
    V, F = patch()
    lattice, rng = Lattice(V, F, n), np.random.default_rng(1)
    face = rng.integers(0, len(F), 2000)
    bary = rng.dirichlet([0.5] * 3, 2000)
    bary[:300] = rng.integers(0, n + 1, (300, 3))
    bary[:300, 2] = n
    bary[:300] = np.eye(3)[rng.integers(0, 3, 300)]  # corners
    bary[300:600, 0] = 0  # edges
    bary /= bary.sum(1, keepdims=True)
    ids, w = lattice.look_up(face, bary)
    assert (
        np.abs(np.einsum("nk,nki->ni", w, lattice.positions[ids]) - np.einsum("nk,nki->ni", bary, V[F[face]])).max()
        < 1e-12
    )
    assert w.min() >= 0


def test_places_on_points_read_those_points():
    lattice = Lattice(*patch(), 4)
    ids, w = lattice.look_up(lattice.face, lattice.bary)
    assert (
        np.array_equal(ids[np.arange(len(lattice)), w.argmax(1)], np.arange(len(lattice))) and w.max(1).min() > 1 - 1e-9
    )


def test_gradients_of_linear_values_are_exact():
    lattice, slope = Lattice(*patch(), 3), np.array([2.0, -3.0, 0.0])
    found = np.stack([G @ (lattice.positions @ slope) for G in lattice.gradient], 1)
    assert np.abs(found - slope).max() < 1e-9


def test_blurring_is_a_gaussian_of_that_width_and_loses_nothing():
    lattice = Lattice(*patch(33, seed=2), 1)
    middle = np.linalg.norm(lattice.positions - [0.2, 0.2, 0], axis=1).argmin()
    one = np.zeros((len(lattice), 1))
    one[middle] = 1
    sums, weights = lattice.blurred(one, np.ones(len(lattice)), 0.03)
    offset = lattice.positions[:, :2] - lattice.positions[middle, :2]
    assert np.isclose(sums.sum(), 1) and np.allclose(weights, 1)
    assert np.sqrt((sums * offset**2).sum(0)) == pytest.approx([0.03, 0.03], rel=0.25)
