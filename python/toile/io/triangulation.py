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
    """Which of the polygons with corners P (c,3) have a corner that points inwards (p,), and their normals (p,3), as long as twice
    their areas."""
    first, owner = np.cumsum(counts) - counts, np.repeat(np.arange(len(counts)), counts)
    after = np.arange(len(P)) + 1
    after[first + counts - 1] = first
    before = np.argsort(after)
    with np.errstate(invalid="ignore", over="ignore"):  # vertices that are not finite
        spokes = P - P[first[owner]]
        fans = np.cross(spokes, spokes[after])
        normals = np.stack([np.bincount(owner, axis, len(counts)) for axis in fans.T], 1)
        turns = np.vecdot(np.cross(P - P[before], P[after] - P), normals[owner])
        inwards = turns < -FLAT * np.vecdot(normals, normals)[owner]
    return np.bincount(owner, inwards, len(counts)) > 0, normals


def _in_plane(P: Floats, normal: Floats) -> Floats:
    """Corners (k,2) along the two axes that lie nearest to the plane, counter-clockwise as seen against the normal."""
    axis = int(np.abs(normal).argmax())
    Q = P[:, [(axis + 1) % 3, (axis + 2) % 3]]
    return Q if normal[axis] > 0 else Q[:, ::-1]


def _ears(Q: Floats) -> Anything:
    """Triangles (k-2,3) of a counter-clockwise polygon (k,2)."""
    left, ears = list(range(len(Q))), []
    while len(left) > 3:
        rest = Q[left]
        ear = next((i for i in range(len(left)) if _is_ear(rest, i)), 1)  # none: it crosses itself
        ears.append([left[ear - 1], left[ear], left[(ear + 1) % len(left)]])
        del left[ear]
    return np.array([*ears, left])


def _is_ear(Q: Floats, i: int) -> bool:
    """Whether corner i of a counter-clockwise polygon (k,2) points outwards, and its triangle holds no other corner."""
    a, b, c = Q[i - 1], Q[i], Q[(i + 1) % len(Q)]
    left_of = lambda p, q: (q[0] - p[0]) * (Q[:, 1] - p[1]) - (q[1] - p[1]) * (Q[:, 0] - p[0])
    if left_of(a, b)[(i + 1) % len(Q)] <= 0:
        return False
    held = (left_of(a, b) >= 0) & (left_of(b, c) >= 0) & (left_of(c, a) >= 0)
    at_corner = (Q[:, None] == np.stack([a, b, c])).all(2).any(1)
    return not (held & ~at_corner).any()
