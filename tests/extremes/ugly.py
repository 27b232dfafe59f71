"""What may be wrong with a mesh whose surface is right: each spoils vertices V (n,3) and faces F, and keeps the surface.
The first n vertices stay what they were. In UGLY the surface is whole; in HOLES a part of it is missing.
"""

import numpy as np

from toile.kernels import unique_edges

INT32 = np.int32


def needles(V, F):
    """Every tenth face split within 1e-9 of its first corner."""
    split = F[::10]
    tips = V[split[:, 0]] + 1e-9 * (V[split].mean(1) - V[split[:, 0]])
    new = len(V) + np.arange(len(split))
    fans = [np.column_stack([split[:, c], split[:, (c + 1) % 3], new]) for c in range(3)]
    return np.vstack([V, tips]), np.vstack([np.delete(F, np.s_[::10], axis=0), *fans]).astype(INT32)


def caps(V, F):
    """Every tenth face split at the middle of a side, which the face beyond does not know; a face of no area between."""
    i, j, k = F[::10].T
    m = len(V) + np.arange(len(i))
    split = [np.c_[i, m, k], np.c_[m, j, k], np.c_[i, j, m]]
    return np.vstack([V, (V[i] + V[j]) / 2]), np.vstack([np.delete(F, np.s_[::10], axis=0), *split]).astype(INT32)


def zero_area(V, F):
    return V, np.vstack([F, np.stack([F[:60, 0], F[:60, 1], F[:60, 1]], 1), np.stack([F[60:90, 0]] * 3, 1)])


def some_faces_twice(V, F):
    return V, np.vstack([F, F[::3, [1, 2, 0]]])


def all_faces_twice(V, F):
    return V, np.vstack([F, F])


def both_sides(V, F):
    """Each face and its reverse."""
    return V, np.hstack([F, F[:, ::-1]]).reshape(-1, 3)


def seam(V, F):
    """Two halves that share places but no vertices."""
    left = V[F].mean(1)[:, 0] < 0
    return np.vstack([V, V]), np.where(left[:, None], F + len(V), F).astype(INT32)


def soup(V, F):
    """Each face has corners of its own; the old vertices stay, unused."""
    return np.vstack([V, V[F].reshape(-1, 3)]), len(V) + np.arange(3 * len(F), dtype=INT32).reshape(-1, 3)


def copies(V, F):
    """A tenth of the faces again, on vertices of their own in the same places."""
    return np.vstack([V, V]), np.vstack([F, F[::10] + len(V)]).astype(INT32)


def isolated(V, F):
    return np.vstack([V, [[0, 0, 0], [90, 0, 0], [1e6, -1e6, 0], [1e25, 0, 0]]]), F


def non_manifold(V, F):
    """Fins on every fiftieth edge."""
    edges = unique_edges(F)[::50]
    tips = 1.05 * (V[edges[:, 0]] + V[edges[:, 1]]) / 2
    return np.vstack([V, tips]), np.vstack([F, np.c_[edges, len(V) + np.arange(len(tips))]]).astype(INT32)


def inner_component(V, F):
    return np.vstack([V, 0.1 * V]), np.vstack([F, F + len(V)]).astype(INT32)


def far_component(V, F):
    return np.vstack([V, 0.1 * V + [3, 0, 0]]), np.vstack([F, F + len(V)]).astype(INT32)


def flipped(V, F):
    return V, F[:, ::-1].copy()


def tenth_flipped(V, F):
    turn = np.random.default_rng(0).random(len(F)) < 0.1
    return V, np.where(turn[:, None], F[:, ::-1], F)


def round_holes(V, F):
    """A quarter of the surface is missing."""
    centres, keep = V[F].mean(1), np.ones(len(F), bool)
    for p in V[np.random.default_rng(1).choice(len(V), 12)]:
        keep &= np.linalg.norm(centres - p, axis=1) > 0.12
    return V, F[keep]


def third_missing(V, F):
    return V, F[np.random.default_rng(0).random(len(F)) > 0.3]


UGLY = [needles, caps, zero_area, some_faces_twice, all_faces_twice, both_sides, seam, soup, copies, isolated, non_manifold,
        inner_component, far_component, flipped, tenth_flipped]  # fmt: skip
HOLES = [round_holes, third_missing]
