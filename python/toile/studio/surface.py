"""Small things on triangles that several files of the studio need: (n,3) vertices, (m,3) faces."""

from __future__ import annotations

import numpy as np

from ..surface.operators import border_sides, sides


def vertex_normals(V, F):
    """Area-weighted unit normals (n,3); zero where a vertex has no area."""
    fn = np.cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]])
    N = np.stack([np.bincount(F.ravel(), np.repeat(fn[:, i], 3), minlength=len(V)) for i in range(3)], 1)
    return N / np.maximum(np.linalg.norm(N, axis=1, keepdims=True), 1e-30)


def smooth_noise(points, length, rng, waves=64):
    """A Gaussian random field at points (n,3): unit variance, correlation exp(-d^2 / (2 length^2))."""
    k = rng.standard_normal((waves, 3)) / length
    phase = rng.uniform(0, 2 * np.pi, waves)
    turn = (points @ k.T + phase).astype(np.float32)  # whose cosine takes a fifth of the time
    return np.sqrt(2 / waves) * np.cos(turn, out=turn).sum(1, dtype=np.float64)


def barycentric(p, T):
    """Coordinates (m,3) of points p (m,3) in triangles T (m,3,3), clipped to the triangle."""
    n = np.cross(T[:, 1] - T[:, 0], T[:, 2] - T[:, 0])
    area = np.maximum((n * n).sum(1), 1e-30)
    b1 = (np.cross(T[:, 2] - p, T[:, 0] - p) * n).sum(1) / area
    b2 = (np.cross(T[:, 0] - p, T[:, 1] - p) * n).sum(1) / area
    b = np.clip(np.stack([1 - b1 - b2, b1, b2], 1), 0, 1)
    return b / b.sum(1, keepdims=True)


def open_loops(F):
    """Boundary loops as vertex cycles, longest first, ties by lowest index."""
    half = sides(F)
    seen = set(map(tuple, half))
    after = {a: b for a, b in map(tuple, half) if (b, a) not in seen}
    loops = []
    while after:
        loop = [min(after)]
        while (n := after.pop(loop[-1], None)) is not None and n != loop[0]:
            loop.append(n)
        loops.append(np.array(loop))
    return sorted(loops, key=lambda c: (-len(c), c[0]))


def border_edges(F):
    """Boundary edges (e,2) and the face of each."""
    open_side = border_sides(F)
    return sides(F)[open_side], np.tile(np.arange(len(F)), 3)[open_side]


def unique_edges(F):
    return np.unique(np.sort(sides(F), 1), axis=0)
