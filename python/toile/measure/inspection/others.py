"""Keypoints of somebody else, or of another moment, in single pictures, told by the other cameras of the frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...frame_numbers import frame_ranges
from ...kernels.arrays import Bools, Floats
from .body import MOST
from .cameras import Finding, agrees
from .rays import SURE, Meeting, Sighting, meet
from .sides import FEWEST, MANY

POINTS = 12  # of the keypoints, that are compared
FEW = 3  # pictures in a row, from which on a camera may have been moved
CONFIRMED = 3  # pictures of a frame that agree, of which each is told by the others


def somebody_else(
    sighting: Sighting, first: int, shifts: Mapping[int, int] | None = None
) -> tuple[list[Finding], Sighting]:
    """Pictures whose keypoints are not of whom the frame's other cameras see, and the sighting without them. `first`: number of the
    sighting's first frame; `shifts` {camera: frames by which its pictures are later than that} of what was put in step."""
    pictures, found = _strange(sighting.thinned(POINTS * sighting.weight[..., 0].size)), []
    for i, (camera, own) in enumerate(zip(sighting.cameras, pictures)):
        if own.any():
            seen = np.flatnonzero((sighting.weight[i] > SURE).any(1))
            numbers = first + (shifts or {}).get(i, 0) + np.flatnonzero(own)
            text = f"{camera.name}: its keypoints in {own.sum()} of {len(seen)} frames are of somebody else, or of another moment"
            text = f"{text}, than those of the other cameras: {frame_ranges(numbers.tolist(), MANY)}{_moved(own[seen])}"
            found.append(Finding(text, serious=False))
    return found, _without(sighting, pictures)


def _moved(own: Bools) -> str:
    """What to ask where the pictures (T,) that see somebody else are all of the first or all of the last ones."""
    changes = np.count_nonzero(np.diff(own))
    when = "up to" if own[0] else "from"
    return (
        f"; all {when} then{'' if own[0] else ' on'}: was the camera moved?"
        if changes == 1 and own.sum() >= FEW
        else ""
    )


def _without(sighting: Sighting, pictures: Bools) -> Sighting:
    return replace(sighting, weight=np.where(pictures[..., None], 0.0, sighting.weight))


def _strange(sighting: Sighting) -> Bools:
    """(C,T): pictures that are left out of a frame, the farthest first, until the others agree: fewer than these, nearly all of whose
    detections lie off where these say, of cameras that agree in most of their frames."""
    limit, seen = agrees(sighting), (sighting.weight > SURE).any(2)
    strange, frames = np.zeros(seen.shape, bool), np.arange(seen.shape[1])
    for _ in range((len(seen) - 1) // 2):
        error = _typical(meet(_without(sighting, strange)))
        worst = error.argmax(0)
        odd = error[worst, frames] > limit
        if not odd.any():
            break
        strange[worst[odd], frames[odd]] = True
    if not strange.any():
        return strange
    meeting = meet(_without(sighting, strange))
    agreeing = (seen & ~strange).sum(0)
    told = (_typical(meeting).max(0) <= limit) & (agreeing >= CONFIRMED) & (agreeing > strange.sum(0))
    strange &= told & _off(sighting, meeting.points, limit)
    return strange & (2 * strange.sum(1) < seen.sum(1))[:, None]


def _typical(meeting: Meeting) -> Floats:
    """(C,T) [px]: median error of each picture, 0 where none is known."""
    error = np.ma.masked_invalid(np.where(np.isinf(meeting.error), 1e9, meeting.error))
    return np.ma.median(error, axis=2).filled(0.0)


def _off(sighting: Sighting, points: Floats, limit: float) -> Bools:
    """(C,T): whether nearly all detections of a picture lie more than `limit` [px] from where points (T,K,3) are seen."""
    off, known = np.zeros(sighting.weight.shape, bool), np.isfinite(points).all(-1) & (sighting.weight > SURE)
    for i, camera in enumerate(sighting.cameras):
        at, depth = camera.project(np.nan_to_num(points))
        off[i] = (np.linalg.norm(sighting.uv[i] - at, axis=-1) > limit) | (depth <= 0)
    count = known.sum(-1)
    return (count >= FEWEST) & ((off & known).sum(-1) >= MOST * count)
