"""Measures of label images, whoever made them, by what does not come from labels: masks, colours, templates."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import cv2
import numpy as np

from ...kernels.arrays import Array, Floats
from ...scene import BodyModel, Frame
from ...vision.limb_colours import parts_of
from .clothed import Clothed, Reading

BINS = (12, 8, 8)  # of L*, a*, b* in a histogram
SOFT = 1.0  # px, by which pictures are blurred
BAND = 0.03  # of the person's height in the picture: colours on either side of a border
SIDE = 30  # pixels of a band


def off_masks(frame: Frame) -> Iterator[tuple[str, float]]:
    """(camera, share of what its label image shows that lies off its mask), where a picture has both and neither is empty."""
    for name, labels in frame.labels.items():
        mask, on = frame.masks.get(name), labels > 0
        if mask is not None and mask.any() and on.any():
            yield name, float((on & ~mask).sum() / on.sum())


def between_others(labels: Array) -> tuple[int, int]:
    """Of a label image (H,W) the places where ids two and more apart lie on both sides of a pixel, and those where its own id lies
    between: nearly none, unless ids were interpolated as a picture was scaled or undistorted."""
    places, between = 0, 0
    for ids in (labels.astype(np.int16), labels.T.astype(np.int16)):
        one, own, other = ids[:-2], ids[1:-1], ids[2:]
        apart = np.abs(one - other) > 1
        places += int(apart.sum())
        between += int((apart & (own > np.minimum(one, other)) & (own < np.maximum(one, other))).sum())
    return places, between


def on_template(clothed: Clothed, reading: Reading, ids: Array, garment: int, over: Sequence[int]) -> Floats:
    """Areas (L,) [m^2] of a garment's template, away from its openings, on which most cameras show each label of `ids`; the
    labels of garments worn `over` it count as unseen."""
    votes = np.stack([(reading.labels == i).sum(0) for i in ids], axis=1).astype(float)
    votes[:, np.isin(ids, over)] = 0
    asked = (clothed.worn == garment) & clothed.inner & (votes.sum(1) > 0)
    return np.bincount(votes[asked].argmax(1), clothed.areas[asked], minlength=len(ids))


def skin_colours(model: BodyModel, frame: Frame, reading: Reading, label: int) -> dict[str, tuple[float, Array]]:
    """{part of the body: (share that carries the label `label`, RGB (k,3) uint8 where it does)}."""
    found: dict[str, tuple[float, Array]] = {}
    for part, vertices in parts_of(model).items():
        at = np.flatnonzero(vertices)
        shown, carry, colours = 0, 0, [np.zeros((0, 3), np.uint8)]
        for i, name in enumerate(reading.cameras):
            given, (x, y) = reading.labels[i, at], reading.pixels[i, at].T
            shown, carry = shown + int((given >= 0).sum()), carry + int((given == label).sum())
            if name in frame.images:
                colours.append(frame.images[name][y[given == label], x[given == label]])
        found[part] = carry / max(shown, 1), np.concatenate(colours)
    return found


def alike(frame: Frame, one: int, other: int) -> list[float]:
    """Of each picture in which two labels meet, how alike the colours are on both sides of their border, 0 to 1 (Bhattacharyya).
    Of each label the largest connected part counts, so that specks have no border."""
    found = []
    for name, labels in frame.labels.items():
        rows = np.flatnonzero((labels > 0).any(1))
        if name not in frame.images or not len(rows):
            continue
        parts, reach = (_largest(labels == one), _largest(labels == other)), max(3.0, BAND * float(np.ptp(rows)))
        if not all(part.any() for part in parts):
            continue
        away = [cv2.distanceTransform((~part).astype(np.uint8), cv2.DIST_L2, 5) for part in parts]
        bands = [part & (far > 1.5) & (far < reach) for part, far in zip(parts, away[::-1])]
        if min(band.sum() for band in bands) >= SIDE:
            image = _lab(frame.images[name])
            found.append(_overlap(*(image[band] for band in bands)))
    return found


def _overlap(a: Floats, b: Floats) -> float:
    """Of two sets of colours (k,3) in L*a*b*."""
    cells = np.floor(np.concatenate([a, b]) / BINS).astype(int)
    _, cell = np.unique(cells, axis=0, return_inverse=True)
    p, q = (np.bincount(of, minlength=cell.max() + 1) / len(of) for of in (cell[: len(a)], cell[len(a) :]))
    return float(np.sqrt(p * q).sum())


def _lab(image: Any) -> Any:
    """L*a*b* (H,W,3) of a picture, a little blurred."""
    return cv2.cvtColor(cv2.GaussianBlur(image, (0, 0), SOFT).astype(np.float32) / 255, cv2.COLOR_RGB2LAB)


def _largest(mask: Any) -> Any:
    """Its largest connected part (H,W) bool."""
    _, parts, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    return parts == 1 + stats[1:, cv2.CC_STAT_AREA].argmax() if len(stats) > 1 else mask
