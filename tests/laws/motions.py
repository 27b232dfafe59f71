"""What the laws draw from: similarities, orders, seeds; examples are the same in every run."""

import numpy as np
import trimesh
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

seeds = st.integers(0, 2**32 - 1)


def examples(count):
    return settings(
        max_examples=count, derandomize=True, deadline=None, database=None, suppress_health_check=list(HealthCheck)
    )


class Similarity:
    """x -> scale R x + t."""

    def __init__(self, rotation, translation, scale=1.0):
        self.R, self.t, self.scale = Rotation.from_rotvec(rotation).as_matrix(), np.array(translation), scale

    def __call__(self, X):
        return self.scale * X @ self.R.T + self.t

    def turn(self, D):
        return self.scale * D @ self.R.T

    def back(self, X):
        return (X - self.t) @ self.R / self.scale

    def __repr__(self):
        return f"Similarity(R={self.R.tolist()}, t={self.t.tolist()}, scale={self.scale})"


def _vectors(size):
    return st.tuples(*[st.floats(-size, size, allow_subnormal=False)] * 3)


rigid = st.builds(Similarity, _vectors(3.0), _vectors(10.0))
similar = st.builds(Similarity, _vectors(3.0), _vectors(10.0), st.sampled_from([1e-3, 0.3, 1.0, 7.0, 1e3]))


def shuffled(V, F, seed):
    """(V, F, order) with vertices, faces and first corners in another order: V_new = V[order]."""
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(V))
    rank = np.empty(len(V), np.int64)
    rank[order] = np.arange(len(V))
    F = rank[F[rng.permutation(len(F))]]
    turns = (np.arange(3) + rng.integers(0, 3, (len(F), 1))) % 3
    return V[order], np.take_along_axis(F, turns, 1), order


def egg(subdivisions=3, seed=0):
    """A closed bumpy surface without symmetries, about 0.6 by 0.8 by 1.2."""
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    d = np.array(sphere.vertices)
    rng = np.random.default_rng(seed)
    bumps = 0.15 * np.sin(4 * d[:, :1] + 1) * np.cos(3 * d[:, 1:2]) + 0.02 * np.sin(d @ rng.normal(0, 3, (3, 1)))
    return d * [0.3, 0.4, 0.6] * (1 + bumps), np.array(sphere.faces)


def sheet(n=9, seed=0):
    """An open bumpy patch of n by n vertices."""
    rng = np.random.default_rng(seed)
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    V = np.c_[i.ravel(), j.ravel(), np.zeros(n * n)] / n + 0.02 * rng.normal(size=(n * n, 3))
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    return V, np.concatenate([np.c_[a, a + n, a + 1], np.c_[a + 1, a + n, a + n + 1]])
