"""Skin that gives way to cloth for which two parts of the body leave no room (docs/method/animation.md)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .. import kernels
from ..scene import Floats, Ints

STEP = 0.0005  # [m] by which skin goes back at a time
MOST = 0.01  # [m]; what lies deeper is no matter of room
SLOPE = 0.3  # at which a dent rises to the skin about it


def dented(V: Floats, F: Ints, cloths: Sequence[tuple[Floats, Ints]]) -> Floats | None:
    """Skin V (n,3), F (m,3) [m] drawn in along its normals until no triangle meets one of the `cloths` (vertices, faces), by at
    most MOST; None where that does not do."""
    normals, edges, depth = inwards(V, F), kernels.unique_edges(F), np.zeros(len(V))
    rise = SLOPE * np.linalg.norm(V[edges[:, 0]] - V[edges[:, 1]], axis=1)
    skin = V
    while len(met := _faces_met(skin, F, cloths)):
        if depth.max() > MOST - STEP / 2:
            return None
        depth[np.unique(F[met])] += STEP
        depth = _sloped(depth, edges, rise)
        skin = V + depth[:, None] * normals
    return skin


def inwards(V, F):
    """Unit normals (n,3) into the skin, whichever way its faces are turned."""
    a, b, c = (V[F[:, k]] - V.mean(0) for k in range(3))
    volume = np.einsum("fi,fi->", a, np.cross(b, c))
    return -np.sign(volume) * kernels.vertex_normals(V, F)


def _faces_met(V, F, cloths):
    return np.unique(np.concatenate([kernels.intersecting_pairs(V, F, C, C_F)[:, 0] for C, C_F in cloths]))


def _sloped(depth, edges, rise):
    """The least depths (n,) that are nowhere less than these and differ along no edge (e,2) by more than its `rise` (e,)."""
    i, j = edges.T
    while True:
        sloped = depth.copy()
        np.maximum.at(sloped, i, depth[j] - rise)
        np.maximum.at(sloped, j, depth[i] - rise)
        if np.array_equal(sloped, depth):
            return depth
        depth = sloped
