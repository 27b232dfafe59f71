"""Whether frames follow one another in time: a person who moves goes a shorter way from frame to frame than between any two."""

from __future__ import annotations

import numpy as np

from ...kernels.arrays import Floats
from .cameras import Finding

SHORTEST = 6  # frames: of fewer no order is told
SAME = 1e-6  # m: frames no farther apart
LONGEST = 0.5  # m: farther, a keypoint is one that was mistaken
AS_ANY = 0.75  # times the mean distance of any two frames: in order of time neighbours are nearer, unless hardly anything moves
LONGER = 1.5  # times the shortest way between all frames: where hardly anything moves, every way is as long


def out_of_order(points: Floats) -> list[Finding]:
    """Frames whose keypoints in space (T,K,3) [m], NaN where unknown, are as far from those of the next frame as from those of any,
    while another order of the same frames would be much shorter."""
    known = points[np.isfinite(points).all(-1).any(1)]
    if len(known) < SHORTEST:
        return []
    apart = _distances(known)
    step = float(np.diagonal(apart, 1).mean())
    any_two = float(apart[np.triu_indices(len(apart), 1)].mean())
    shortest = _shortest(apart)
    if step <= max(AS_ANY * any_two, LONGER * shortest):
        return []
    text = f"frames: keypoints lie {1e3 * step:.0f} mm from those of the next frame, and {1e3 * any_two:.0f} mm from those of any"
    ask = f"another order would need steps of {1e3 * shortest:.0f}; are the frames numbered in the order of time?"
    return [Finding(f"{text}: {ask}", serious=False)]


def _distances(points: Floats) -> Floats:
    """(T,T) [m] of frames, root mean squares over the keypoints that both have; LONGEST where they share none."""
    apart = np.zeros((len(points), len(points)))
    for own, row in zip(points, apart):
        squares = np.minimum(np.sum((points - own) ** 2, axis=-1), LONGEST**2)
        both = np.isfinite(squares)
        row[:] = np.sqrt(np.where(both, squares, 0).sum(1) / np.maximum(both.sum(1), 1))
        row[~both.any(1)] = LONGEST
    return apart


def _shortest(apart: Floats) -> float:
    """Mean edge [m] of the minimum spanning tree, than which no way through all frames is shorter."""
    from scipy.sparse.csgraph import minimum_spanning_tree

    edges = np.maximum(apart, SAME)  # 0 is no edge to scipy
    return float(minimum_spanning_tree(edges).data.sum() / (len(apart) - 1))
