"""What a frame shows, thinned: enough to measure any surface against it later without reading the frame again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..frame_numbers import evenly
from ..kernels.arrays import Anything
from ..surface.sampling import by_area

SCAN_POINTS = 4000  # of a scan, evenly by area
MASK_VIEWS = 8  # pictures whose masks are kept, spread over the cameras
MASK_SIDE = 256  # longer side of a kept mask, about [px]


@dataclass(frozen=True)
class Glimpse:
    """Points of the scan and their unit normals, evenly by area, with their labels (0: none); the 2D keypoints; masks by
    every `step`-th pixel of few cameras, or where the frame has none what its label images show. Empty where the frame has
    none."""

    points: Anything  # (p,3) [m]
    normals: Anything  # (p,3)
    labels: Anything  # (p,) uint8
    spacing: float  # square root of the area that a point stands for [m]
    side: float  # median length of the scan's edges [m]
    keypoint_names: tuple[str, ...]
    keypoint_views: tuple[str, ...]
    keypoints: Anything  # (C,k,3) u, v [px], confidence
    mask_views: tuple[str, ...]
    mask_steps: Anything  # (M,)
    mask_sizes: Anything  # (M,2) height, width [px] of a kept mask
    masks: Anything  # their pixels one after the other, 8 in a byte, uint8
    of_labels: bool = False  # whether these are of label images, which may show the person in part

    def views(self):
        """(camera's name, step, mask (H,W)) of each kept mask."""
        pixels = self.mask_sizes.prod(1)
        bits = np.unpackbits(self.masks, count=pixels.sum()).astype(bool)
        for name, step, size, mask in zip(
            self.mask_views, self.mask_steps, self.mask_sizes, np.split(bits, np.cumsum(pixels)[:-1])
        ):
            yield name, step, mask.reshape(size)


class Outlines(NamedTuple):
    """Masks (H,W) by every `step`-th pixel of few cameras; `of_labels`: they are what label images show."""

    views: tuple[str, ...]
    steps: list[int]
    masks: list[Anything]
    of_labels: bool


def outlines(frame) -> Outlines:
    """Those of a frame's whole pictures: of its masks, or where it has none of its label images."""
    masks = frame.masks or _labelled(frame)
    chosen = evenly(sorted(masks), MASK_VIEWS) if masks else []
    steps = [-(-max(masks[name].shape) // MASK_SIDE) for name in chosen]
    thin = [masks[name][step // 2 :: step, step // 2 :: step] > 0 for name, step in zip(chosen, steps)]
    return Outlines(tuple(chosen), steps, thin, not frame.masks and len(chosen) > 0)


def glimpse(frame, scan_labels=None, outlined=None) -> Glimpse:
    """The Glimpse of a frame; `scan_labels` (m,) label ids of its scan's faces, `outlined` its Outlines where its pictures are
    thinned."""
    points, normals, labels, spacing = _scan_points(frame.scan, scan_labels)
    side = 0.0 if frame.scan is None else _median_edge(frame.scan)
    found = frame.keypoints
    views = () if found is None else tuple(name for name, at in found.points.items() if len(at))
    keypoints = np.stack([found.points[name] for name in views]) if views else np.zeros((0, 0, 3))
    names = () if found is None else tuple(found.names)
    mask_views, steps, masks, of_labels = outlined or outlines(frame)
    return Glimpse(
        points,
        normals,
        labels,
        spacing,
        side,
        names,
        views,
        keypoints,
        mask_views,
        np.array(steps, np.int64),
        np.array([mask.shape for mask in masks], np.int64).reshape(-1, 2),
        np.packbits(np.concatenate([mask.ravel() for mask in masks]) if masks else np.zeros(0, bool)),
        of_labels,
    )


def _labelled(frame):
    """{camera: label image (H,W)} of those that show something and that no network guessed."""
    return {name: labels for name, labels in frame.labels.items() if name not in frame.certainty and labels.any()}


def _median_edge(scan):
    """Over the first edges of the faces [m]."""
    return float(np.median(np.linalg.norm(scan.vertices[scan.faces[:, 0]] - scan.vertices[scan.faces[:, 1]], axis=1)))


def _scan_points(scan, labels):
    """(points, normals, labels, spacing) of a Glimpse."""
    if scan is None:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.uint8), 0.0
    face, step = by_area(scan.vertices, scan.faces, SCAN_POINTS)
    kept = np.zeros(len(face), np.uint8) if labels is None else np.asarray(labels, np.uint8)[face]
    return scan.vertices[scan.faces[face]].mean(1), scan.face_normals[face], kept, float(np.sqrt(step))
