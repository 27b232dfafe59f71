"""Masks that are empty in pictures that show the person: a segmenter's fault, that tells nothing of where the surface lies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..kernels.arrays import Bools, Floats
from ..scene import Camera
from .evidence import UNSEEN
from .glimpse import Glimpse
from .judged import JudgedLayer

NEAREST = 1e-3  # m before a camera: points nearer, or behind it, have no pixel
PATCH = 4e-4  # m^2: less of a silhouette is a mask's speck
DETECTED = 6  # keypoints of one picture that show the person in it
OTHERS = 3  # masks that are not empty, and show together where the person is


def wrongly_empty(
    seen: Glimpse, cameras: Mapping[str, Camera], body: JudgedLayer, masks: Mapping[str, tuple[Bools, float]]
) -> list[str]:
    """Names of the `masks` {camera: (mask (H,W), maybe thinned, side of its pixel where the body is [m])} that are empty, but for
    specks, although scan, keypoints or the other masks show the person in their pictures. None where more than half of the masks are
    so: then it may not be there."""
    empty = [name for name, (mask, side) in masks.items() if mask.sum() * side**2 < PATCH]
    V = body.vertices[body.looks]
    hull = _in_hull(V, [(mask, cameras[name]) for name, (mask, _) in masks.items() if name not in empty])
    shown = lambda camera: _detected(seen, camera) or _scanned(seen, camera, V) or _confirmed(hull, camera, V)
    found = [name for name in empty if shown(cameras[name])]
    return found if 2 * len(found) <= len(masks) else []


def misses_body(mask: Bools, camera: Camera, V: Floats) -> bool:
    """Whether a mask (H,W) is empty, but for specks, although at least half of the registered body's vertices V (n,3) lie in the
    picture."""
    return bool(mask.sum() * pixel_side(camera, V) ** 2 < PATCH and 2 * camera.sees(V).mean() >= 1)


def pixel_side(camera: Camera, V: Floats) -> float:
    """Side of a camera's pixel [m] at the median depth of points V (n,3)."""
    return float(np.median(np.maximum(camera.project(V)[1], NEAREST))) / float(camera.K[0, 0])


def _detected(seen: Glimpse, camera: Camera) -> bool:
    """Whether keypoints were detected in a picture."""
    if camera.name not in seen.keypoint_views:
        return False
    u, v, confidence = seen.keypoints[seen.keypoint_views.index(camera.name)].T
    inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    return (inside & (confidence > UNSEEN)).sum() >= DETECTED


def _scanned(seen: Glimpse, camera: Camera, V: Floats) -> bool:
    """Whether at least half as large a share of the scan lies in a picture as of the body's vertices V (n,3)."""
    if not len(seen.points):
        return False
    shown, due = (camera.sees(points).mean() for points in (seen.points, V))
    return bool(shown > 0 and 2 * shown >= due)


def _in_hull(V: Floats, masks: Sequence[tuple[Bools, Camera]]) -> Bools:
    """Which of the points V (n,3) all masks show that have them in their pictures, of OTHERS at least."""
    seen, off = np.zeros(len(V), int), np.zeros(len(V), bool)
    for mask, camera in masks:
        there = np.flatnonzero(camera.sees(V))
        x, y = (camera.project(V[there])[0].astype(int) * mask.shape[::-1] // camera.size[::-1]).T
        seen[there] += 1
        off[there] |= ~mask[y, x]
    return (seen >= OTHERS) & ~off


def _confirmed(hull: Bools, camera: Camera, V: Floats) -> bool:
    """Whether a picture shows at least half of the body's vertices V (n,3), and most of these lie in the `hull` (n,) of the others."""
    there = camera.sees(V)
    return bool(2 * there.mean() >= 1 and 2 * hull[there].mean() >= 1)
