"""Masks that are empty in pictures that show the person: a segmenter's fault, that tells nothing of where the surface lies."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..kernels.arrays import Bools, Floats
from ..scene import Camera
from .evidence import UNSEEN
from .glimpse import Glimpse
from .judged import JudgedLayer

PATCH = 4e-4  # m^2: less of a silhouette is a mask's speck
DETECTED = 6  # keypoints of one picture that show the person in it


def wrongly_empty(
    seen: Glimpse, cameras: Mapping[str, Camera], body: JudgedLayer, masks: Mapping[str, tuple[Bools, float]]
) -> list[str]:
    """Names of the `masks` {camera: (mask (H,W), side of its pixel where the body is [m])} that are empty, but for specks, although
    scan or keypoints show the person in their pictures. None where more than half of the masks are so: then it may not be there."""
    empty = [name for name, (mask, side) in masks.items() if mask.sum() * side**2 < PATCH]
    found = [name for name in empty if _detected(seen, cameras[name]) or _scanned(seen, cameras[name], body)]
    return found if 2 * len(found) <= len(masks) else []


def misses_body(mask: Bools, camera: Camera, V: Floats) -> bool:
    """Whether a mask (H,W) is empty, but for specks, although at least half of the registered body's vertices V (n,3) lie in the
    picture."""
    side = float(np.median(camera.project(V)[1])) / camera.K[0, 0]  # of a pixel where the body is [m]
    return bool(mask.sum() * side**2 < PATCH and 2 * camera.sees(V).mean() >= 1)


def _detected(seen: Glimpse, camera: Camera) -> bool:
    """Whether keypoints were detected in a picture."""
    if camera.name not in seen.keypoint_views:
        return False
    u, v, confidence = seen.keypoints[seen.keypoint_views.index(camera.name)].T
    inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    return (inside & (confidence > UNSEEN)).sum() >= DETECTED


def _scanned(seen: Glimpse, camera: Camera, body: JudgedLayer) -> bool:
    """Whether at least half as large a share of the scan lies in a picture as of the body."""
    if not len(seen.points):
        return False
    shown, due = (camera.sees(points).mean() for points in (seen.points, body.vertices[body.looks]))
    return shown > 0 and 2 * shown >= due
