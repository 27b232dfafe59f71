"""Silhouettes against each other: the visual hull of the masks, and how much of each mask it covers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...kernels.arrays import Anything, Array, Floats
from ...scene import Camera, Frame
from .rays import Sighting, meet

GRID = 56  # cells a side
COVERED = 0.93  # share of the masks that the hull must explain
MARGIN = 1.15
SPECKS = 1e-4  # of a picture: a mask of less shows nobody
ASIDE = 6  # px, even, by which a silhouette may be moved upon a mask


def hardly(mask: Array) -> bool:
    """Whether a mask (H,W) is empty, but for specks."""
    return bool(np.count_nonzero(mask) < SPECKS * mask.size)


def without_specks(frame: Frame) -> Frame:
    """The frame whose masks are empty where they are so but for specks."""
    return replace(frame, masks={name: mask & (not hardly(mask)) for name, mask in frame.masks.items()})


def centroids(cameras: Mapping[str, Camera], masks: list[Mapping[str, Anything]]) -> Sighting:
    """Middles of the masks of some frames as detections of one point."""
    names = [name for name in cameras if any(name in frame for frame in masks)]
    uv = np.zeros((len(names), len(masks), 1, 2))
    weight = np.zeros((len(names), len(masks), 1))
    for t, frame in enumerate(masks):
        for i, name in enumerate(names):
            rows, columns = np.nonzero(frame[name]) if name in frame else ((), ())
            if len(rows):
                uv[i, t, 0] = columns.mean() + 0.5, rows.mean() + 0.5
                weight[i, t, 0] = 1.0
    return Sighting(tuple(cameras[name] for name in names), ("middle",), uv, weight)


def coverage(cameras: Mapping[str, Camera], masks: Mapping[str, Anything]) -> dict[str, tuple[float, float]]:
    """{camera: (share of its mask that the hull of all covers, mean share of the others' masks that the hull without it
    covers)} of one frame; {} where fewer than three cameras have a mask or their middles do not meet."""
    names = [name for name in masks if masks[name].any()]
    if len(names) < 3:
        return {}
    middle = meet(centroids({name: cameras[name] for name in names}, [masks])).points[0, 0]
    if not np.isfinite(middle).all():
        return {}
    radius = max(_reach(cameras[name], masks[name], middle) for name in names)
    axis = np.linspace(-radius, radius, GRID)
    points = middle + np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    seen = {name: cameras[name].project(points) for name in names}
    inside = {name: within(masks[name], *seen[name]) for name in names}
    missing = np.sum([~flags for flags in inside.values()], axis=0)
    step = 2 * radius / (GRID - 1)
    found = {}
    for name in names:
        whole = covered(cameras[name], masks[name], *seen[name], missing == 0, step)
        without = missing == ~inside[name]  # no other camera carves it
        rest = [covered(cameras[n], masks[n], *seen[n], without, step) for n in names if n != name]
        found[name] = whole, float(np.mean(rest))
    return found


def _reach(camera: Camera, mask: Anything, middle: Floats) -> float:
    """How far from the middle a mask may reach, in the world."""
    rows, columns = np.nonzero(mask)
    depth = float(camera.to_camera(middle)[2])
    size = max(np.ptp(rows), np.ptp(columns)) + 1
    return float(MARGIN * 0.5 * size * abs(depth) / np.sqrt(camera.K[0, 0] * camera.K[1, 1]))


def within(mask: Anything, uv: Floats, depth: Floats) -> Anything:
    """Whether points lie within a mask; those outside the picture are not known not to."""
    h, w = mask.shape
    x, y = np.floor(np.nan_to_num(uv, nan=-1, posinf=-1, neginf=-1)).clip(-1, 1e6).astype(int).T
    there = (x >= 0) & (x < w) & (y >= 0) & (y < h) & (depth > 0)
    return np.where(there, mask[y.clip(0, h - 1), x.clip(0, w - 1)], True)


def overlap_aside(shown: Array, mask: Array) -> float:
    """Intersection over union of a silhouette with a mask (H,W), the best of those moved aside by up to ASIDE pixels: what a scan
    that lies elsewhere, or a principal point that is off, does not change."""
    h, w = shown.shape
    padded, seen, best = np.pad(shown, ASIDE), np.count_nonzero(mask), 0.0
    for y in range(0, 2 * ASIDE + 1, 2):
        for x in range(0, 2 * ASIDE + 1, 2):
            aside = padded[y : y + h, x : x + w]
            both = np.count_nonzero(aside & mask)
            best = max(best, both / max(np.count_nonzero(aside) + seen - both, 1))
    return best


def covered(camera: Camera, mask: Anything, uv: Floats, depth: Floats, kept: Anything, step: float) -> float:
    """Share of a mask's cells in which kept points are seen; a cell is as large as a point's cell looks."""
    import cv2

    if not kept.any():
        return 0.0
    cell = max(1.0, float(np.median(step * camera.K[0, 0] / np.maximum(depth[kept], 1e-6))))
    h, w = (int(np.ceil(n / cell)) for n in mask.shape)
    hit = np.zeros((h, w), np.uint8)
    x, y = np.floor(uv[kept] / cell).clip(-1, 1e6).astype(int).T
    there = (x >= 0) & (x < w) & (y >= 0) & (y < h)
    hit[y[there], x[there]] = 1
    hit = cv2.dilate(hit, np.ones((3, 3), np.uint8))
    wanted = cv2.resize(mask.astype(np.float32), (w, h), interpolation=cv2.INTER_AREA) > 0.5
    return float(hit[wanted].mean()) if wanted.any() else 1.0
