"""Whether frames follow one another in time: a person who moves goes a shorter way from frame to frame than between any two, and
nobody leaps."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ...kernels.arrays import Floats
from .cameras import Finding

SHORTEST = 6  # frames: of fewer no order is told
SAME = 1e-6  # m: frames no farther apart
LONGEST = 0.5  # m: farther, a keypoint is one that was mistaken
AS_ANY = 0.75  # times the mean distance of any two frames: in order of time neighbours are nearer, unless hardly anything moves
SPRINT = 12.5  # m/s: nobody ran faster
UNSURE = 0.1  # m: so far keypoints lie apart that are uncertain; between frames at a high rate nobody runs as far
LEAPS = 3  # in a message
LONGER = 1.5  # times the shortest way between all frames: where hardly anything moves, every way is as long


def out_of_order(points: Floats) -> list[Finding]:
    """Frames whose keypoints in space (T,K,3) [m], NaN where unknown, are as far from those of the next frame as from those of any,
    while another order of the same frames would be much shorter."""
    known = points[np.isfinite(points).all(-1).any(1)]
    if len(known) < SHORTEST:
        return []
    apart = _distances(known)
    step = float(
        np.median(np.diagonal(apart, 1))
    )  # of single frames whose keypoints are another person's no other order comes
    any_two = float(np.median(apart[np.triu_indices(len(apart), 1)]))
    shortest = _shortest(apart)
    if step <= max(AS_ANY * any_two, LONGER * shortest):
        return []
    text = f"frames: keypoints lie {1e3 * step:.0f} mm from those of the next frame, and {1e3 * any_two:.0f} mm from those of any"
    ask = f"another order would need steps of {1e3 * shortest:.0f}; are the frames numbered in the order of time?"
    return [Finding(f"{text}: {ask}", serious=False)]


def leaps(points: Floats, first: int, fps: float) -> list[Finding]:
    """Frames between which half of the keypoints in space (T,K,3) [m] go farther than anybody runs and than they are UNSURE; `first`:
    number of the first."""
    known = np.flatnonzero(np.isfinite(points).all(-1).any(1))
    told = []
    for one, other in pairwise(known.tolist()):
        ways = np.linalg.norm(points[other] - points[one], axis=-1)
        farthest = max(SPRINT * (other - one) / fps, UNSURE)
        if np.isfinite(ways).any() and (way := float(np.nanmedian(ways))) > farthest:
            told.append(f"{way:.2f} m from {first + one} to {first + other}")
    if not told:
        return []
    shown = f"{', '.join(told[:LEAPS])}{', ...' * (len(told) > LEAPS)}"
    text = f"keypoints: they leap in {len(told)} places, faster than anybody runs at {fps:g} frames a second: {shown}"
    return [Finding(f"{text}: are they another person's there, or fps another?", serious=False)]


def _distances(points: Floats) -> Floats:
    """(T,T) [m] of frames, medians over the keypoints that both have, up to LONGEST, and that where they share none."""
    apart = np.full((len(points), len(points)), LONGEST)
    for own, row in zip(points, apart):
        lengths = np.linalg.norm(points - own, axis=-1)
        both = np.isfinite(lengths).any(1)
        row[both] = np.minimum(np.nanmedian(lengths[both], axis=1), LONGEST)
    return apart


def _shortest(apart: Floats) -> float:
    """Mean edge [m] of the minimum spanning tree, than which no way through all frames is shorter."""
    from scipy.sparse.csgraph import minimum_spanning_tree

    edges = np.maximum(apart, SAME)  # 0 is no edge to scipy
    return float(minimum_spanning_tree(edges).data.sum() / (len(apart) - 1))
