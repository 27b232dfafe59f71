"""Triangles of polygons: a fan of a convex one, ears of one with a concave corner, in its plane.

G. H. Meisters, Polygons have ears, American Mathematical Monthly 82 (1975).
"""

from __future__ import annotations

import numpy as np

from ..kernels.arrays import Anything, Bools, Floats

FLAT = 1e-6  # of a polygon's area by which a corner may point inwards, as digits in files round


def triangles_of(V: Anything, corners: Anything, counts: Anything) -> Anything:
    """Triangles (m,3) as positions in `corners` (c,), which names the vertices V (n,3) of polygons of `counts` (p,) corners one
    after the other: as many as corners less two of each, in their order. Corners that name no vertex are for the caller to refuse."""
    corners, counts = np.asarray(corners, np.int64), np.asarray(counts, np.int64)
    many = np.maximum(counts - 2, 0)
    first, row = np.cumsum(counts) - counts, np.cumsum(many) - many
    step = np.arange(many.sum()) - np.repeat(row, many)
    triangles = np.repeat(first, many)[:, None] + np.stack([0 * step, step + 1, step + 2], 1)
    if len(V) == 0:
        return triangles
    wide = np.flatnonzero(counts > 3)
    P = np.asarray(V, np.float64)[np.clip(corners[np.repeat(counts > 3, counts)], 0, len(V) - 1)]
    concave, normals = _concave(P, counts[wide])
    begin = np.cumsum(counts[wide]) - counts[wide]
    for i in np.flatnonzero(concave):
        p = wide[i]
        polygon = P[begin[i] : begin[i] + counts[p]]
        triangles[row[p] : row[p] + many[p]] = first[p] + _ears(_in_plane(polygon, normals[i]))
    return triangles


def _concave(P: Floats, counts: Anything) -> tuple[Bools, Floats]:
    """Which of the polygons with corners P (c,3) have a corner that points inwards, or fans that overlap, as of many corners that point
    inwards by little (p,), and their normals (p,3), as long as twice their areas."""
    first, owner = np.cumsum(counts) - counts, np.repeat(np.arange(len(counts)), counts)
    after = np.arange(len(P)) + 1
    after[first + counts - 1] = first
    before = np.argsort(after)
    with np.errstate(invalid="ignore", over="ignore"):  # vertices that are not finite
        spokes = P - P[first[owner]]
        fans = np.cross(spokes, spokes[after])
        normals = np.stack([np.bincount(owner, axis, len(counts)) for axis in fans.T], 1)
        turns = np.vecdot(np.cross(P - P[before], P[after] - P), normals[owner])
        flat = FLAT * np.vecdot(normals, normals)
        overlap = np.bincount(owner, np.minimum(np.vecdot(fans, normals[owner]), 0), len(counts))
    return (np.bincount(owner, turns < -flat[owner], len(counts)) > 0) | (overlap < -flat), normals


def _in_plane(P: Floats, normal: Floats) -> Floats:
    """Corners (k,2) along the two axes that lie nearest to the plane, counter-clockwise as seen against the normal."""
    axis = int(np.abs(normal).argmax())
    Q = P[:, [(axis + 1) % 3, (axis + 2) % 3]]
    return Q if normal[axis] > 0 else Q[:, ::-1]


def _ears(Q: Floats) -> Anything:
    """Triangles (k-2,3) of a counter-clockwise polygon (k,2)."""
    left, ears, at = np.arange(len(Q)), [], 0
    while (n := len(left)) > 3:
        rest = Q[left]
        at = next((i % n for i in range(at, at + n) if _is_ear(rest, i % n)), 1)  # none: it crosses itself
        ears.append(left[[at - 1, at, (at + 1) % n]])
        left = np.delete(left, at)
    return np.array([*ears, left])


def _is_ear(Q: Floats, i: int) -> bool:
    """Whether corner i of a counter-clockwise polygon (k,2) points outwards, and its triangle holds no other corner."""
    a, b, c = Q[i - 1], Q[i], Q[(i + 1) % len(Q)]
    left_of = lambda p, q: (q[0] - p[0]) * (Q[:, 1] - p[1]) - (q[1] - p[1]) * (Q[:, 0] - p[0])
    if (b[0] - a[0]) * (c[1] - a[1]) <= (b[1] - a[1]) * (c[0] - a[0]):
        return False
    held = Q[(left_of(a, b) >= 0) & (left_of(b, c) >= 0) & (left_of(c, a) >= 0)]
    return bool((held[:, None] == np.stack([a, b, c])).all(2).any(1).all())  # corners at its own
