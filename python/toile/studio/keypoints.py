"""2D keypoints: the body model's own table on the truth body, with noise, outliers and left-right swaps."""

from __future__ import annotations

import numpy as np

THICKNESS = {"body": 0.14, "face": 0.015, "hand_left": 0.03, "hand_right": 0.03}  # m of surface a point may lie under
SWAPS = 0.5  # share of the outliers that are left-right swaps
FAR_PX = (0.04, 0.20)  # share of the image by which the other outliers are off


class KeypointTable:
    """Names and definition from the packaged body model, so that truth means the same anatomical points."""

    def __init__(self, model):
        self.model = model
        self.names = tuple(model.keypoint_names)
        self.thickness = np.array([THICKNESS[n.split(".")[0]] for n in self.names])
        self.pairs = swap_pairs(self.names)

    def points(self, V, joints):
        """True points (q,3) on posed truth vertices and joints."""
        return self.model.keypoints(V, joints)


def swap_pairs(names):
    """Index pairs of points that differ only in .L/.R or in hand_left/hand_right."""
    place = {n: i for i, n in enumerate(names)}
    pairs = []
    for i, n in enumerate(names):
        other = n[:-2] + ".R" if n.endswith(".L") else n
        other = other.replace("hand_left.", "hand_right.")
        if other != n and other in place:
            pairs.append((i, place[other]))
    return pairs


def seen_by(camera, depth, points, thickness):
    """Pixels (q,2), and whether each point (q,3) is in the picture and at most `thickness` under what is seen."""
    uv, z = camera.project(points)
    j, i = np.floor(uv).astype(int).T
    inside = (z > 0) & (i >= 0) & (j >= 0) & (i < camera.height) & (j < camera.width)
    seen = np.zeros(len(points), bool)
    seen[inside] = depth[i[inside], j[inside]] >= z[inside] - thickness[inside]
    return uv, seen


def noisy(table, camera, depth, points, sigma, outliers, rng):
    """[[u, v, confidence], ...] (q,3) as a detector gives them; unseen points are 0, 0, 0."""
    uv, seen = seen_by(camera, depth, points, table.thickness)
    out = np.zeros((len(points), 3))
    out[:, :2] = uv + rng.normal(0, sigma, uv.shape)
    out[:, 2] = rng.uniform(0.6, 1.0, len(uv))
    bad = rng.uniform(size=len(uv)) < outliers
    swap = rng.uniform(size=len(uv)) < SWAPS
    angle, off = rng.uniform(0, 2 * np.pi, len(uv)), rng.uniform(*FAR_PX, len(uv)) * camera.width
    far = bad & ~swap
    out[far, :2] += (off * np.stack([np.cos(angle), np.sin(angle)]))[:, far].T
    out[bad, 2] = rng.uniform(0.3, 0.9, len(uv))[bad]
    for a, b in table.pairs:
        if bad[a] and swap[a] and seen[a] and seen[b]:
            out[[a, b]] = out[[b, a]]
    out[~seen] = 0
    return out
