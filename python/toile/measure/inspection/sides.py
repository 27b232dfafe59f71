"""Left and right exchanged in single pictures, told by the other cameras, and in single frames, told by those before and after."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from ...frame_numbers import frame_ranges
from ...kernels.arrays import Anything, Bools, Floats
from .body import MOST
from .cameras import BETTER, Finding, agrees
from .rays import SURE, Sighting, directions, meet

JOINTS = ("upperarm01", "lowerarm01", "wrist", "upperleg01", "lowerleg01", "foot")
FEWEST = 6  # detections, half of those of a picture, that tell its sides, or points of a frame
FAR = 0.1  # rad between a ray and the plane of another: farther, a detection is of something else
SPIN = 0.1  # s: nobody turns half about in less, which looks as if sides were exchanged
MANY = 4  # numbers in a message


def exchanged_sides(sighting: Sighting, first: int, fps: float) -> tuple[list[Finding], Sighting]:
    """Pictures and frames in which what is called left is right, and the sighting with them set right. `first`: number of the
    sighting's first frame."""
    limbs = [k for k, name in enumerate(sighting.names) if re.fullmatch(rf"body\.({'|'.join(JOINTS)})\.[LR]", name)]
    few = replace(
        sighting,
        names=tuple(sighting.names[k] for k in limbs),
        uv=sighting.uv[:, :, limbs],
        weight=sighting.weight[:, :, limbs],
    )
    pictures = (
        _in_pictures(few) if len(limbs) >= FEWEST and len(few.cameras) > 2 else np.zeros(sighting.uv.shape[:2], bool)
    )
    frames = (
        _in_frames(meet(turned_about(few, pictures)).points, few.names, fps) if len(limbs) >= FEWEST else pictures[0]
    )
    found = [Finding(text, serious=False) for text in _words(sighting, pictures, frames, first)]
    return found, turned_about(sighting, pictures ^ frames)


def _words(sighting: Sighting, pictures: Bools, frames: Bools, first: int) -> list[str]:
    found = []
    for camera, own, weight in zip(sighting.cameras, pictures, sighting.weight):
        seen = int((weight > SURE).any(1).sum())
        if own.any():
            where = frame_ranges((first + np.flatnonzero(own)).tolist(), MANY)
            found.append(
                f"{camera.name}: left and right are exchanged in {own.sum()} of its {seen} frames, against the other cameras: {where}"
            )
    if frames.any():
        where = frame_ranges((first + np.flatnonzero(frames)).tolist(), MANY)
        found.append(
            f"keypoints: left and right are exchanged in {frames.sum()} frames, against those before and after: {where}"
        )
    return found


def turned_about(sighting: Sighting, pictures: Bools) -> Sighting:
    """With what is called left called right, and the other way round, in some pictures (C,T)."""
    at, uv, weight = other_side(sighting.names), sighting.uv.copy(), sighting.weight.copy()
    uv[pictures], weight[pictures] = uv[pictures][:, at], weight[pictures][:, at]
    return replace(sighting, uv=uv, weight=weight)


def other_side(names: Sequence[str]) -> Anything:
    """Of each keypoint (K,) the one of the same name on the other side; itself on the middle, or where that is not given."""
    other = {"L": "R", "R": "L", "left": "right", "right": "left"}
    mirrored = [re.sub(r"left|right|(?<=\.)[LR]$", lambda found: other[found[0]], name) for name in names]
    return np.array([names.index(name) if name in names else k for k, name in enumerate(mirrored)], dtype=int)


def _in_pictures(sighting: Sighting) -> Bools:
    """(C,T): pictures of the smaller party, if those of a frame agree better in two parties of unlike sides. Only such count of which
    nearly all detections come to lie where the others say: a detector exchanges single limbs as well, which is another fault."""
    party = _parties(_alike(sighting))
    as_given, turned = (np.nan_to_num(meet(one).error, nan=0.0) for one in (sighting, turned_about(sighting, party)))
    turned = np.where(party[..., None], turned[..., other_side(sighting.names)], turned)  # of the same detections
    told = np.maximum(as_given, turned) > agrees(sighting)  # elsewhere left and right lie behind one another
    nearer = told & (turned < as_given)
    return party & (told.sum(-1) >= FEWEST) & (nearer.sum(-1) >= MOST * told.sum(-1))


def _alike(sighting: Sighting) -> Floats:
    """(T,C,C) [rad]: by how much nearer pairs of pictures lie to each other's epipolar planes with like sides than with unlike ones,
    summed over their detections."""
    D = np.stack([directions(camera, uv) for camera, uv in zip(sighting.cameras, sighting.uv)])
    seen, at = sighting.weight > SURE, other_side(sighting.names)
    alike = np.zeros((seen.shape[1], len(seen), len(seen)))
    for a, b in combinations(range(len(seen)), 2):
        base = sighting.cameras[b].centre - sighting.cameras[a].centre
        normal = np.cross(base, D[b])
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
        far = lambda rays: np.minimum(np.abs(np.einsum("tki,tki->tk", normal, rays)), FAR)
        both = seen[a] & seen[a][:, at] & seen[b]
        alike[:, a, b] = alike[:, b, a] = np.where(both, far(D[a][:, at]) - far(D[a]), 0.0).sum(1)
    return alike


def _parties(alike: Floats) -> Bools:
    """(C,T): the smaller of two parties of each frame's pictures that agree best within and least between: pictures change over, one
    by one, as long as that gains. Of two as large it is in every frame the one without the first camera."""
    found = np.zeros((alike.shape[1], len(alike)), bool)
    for t, gain in enumerate(alike):
        side = np.where(np.linalg.eigh(gain)[1][:, -1] < 0, -1.0, 1.0)
        for _ in range(2 * len(side)):
            loss = side * (gain @ side)  # what a picture agrees with its own party more than with the other
            if loss.min() >= 0:
                break
            side[loss.argmin()] *= -1
        told = gain.any(1)
        side *= side[told.argmax()]
        other, rest = told & (side < 0), told & (side > 0)
        found[:, t] = other if other.sum() <= rest.sum() else rest
    return found


def _in_frames(points: Floats, names: tuple[str, ...], fps: float) -> Bools:
    """(T,): the fewer of the frames between which points (T,K,3) of left and right change places within SPIN."""
    known, at = np.flatnonzero(np.isfinite(points).all(-1).sum(1) >= FEWEST), other_side(names)
    side = np.zeros(len(points), bool)
    for one, next_ in zip(known, known[1:]):
        same, other = (np.linalg.norm(points[next_][order] - points[one], axis=-1) for order in (slice(None), at))
        both = np.isfinite(same) & np.isfinite(other)
        changed = both.sum() >= FEWEST and np.median(other[both]) < BETTER * np.median(same[both])
        side[next_] = side[one] ^ bool(changed and next_ - one <= SPIN * fps)
    unknown = np.setdiff1d(np.arange(len(points)), known)
    side = side if side.sum() * 2 <= len(known) else ~side
    side[unknown] = False
    return side
