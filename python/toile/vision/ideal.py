"""Pictures as an ideal camera would have taken them, cut to what they show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np


def ideal(camera, image, mask, margin):
    """The camera without distortion, its picture (h,w,3) uint8 and its mask (h,w) bool, cut to the mask's box and `margin`
    pixels about it. None where the mask is empty."""
    if camera.distortion.any():
        image, mask = _straight(camera, image, mask)
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if len(rows) == 0:
        return None
    top, bottom = _span(rows, margin, camera.height)
    left, right = _span(columns, margin, camera.width)
    K = camera.K.copy()
    K[:2, 2] -= left, top
    cut = replace(camera, K=K, width=right - left, height=bottom - top, distortion=np.zeros(5))
    return cut, image[top:bottom, left:right], mask[top:bottom, left:right]


def reduced(camera, image, mask, times):
    """An ideal camera whose pixels are `times` as large a side, its picture (h,w,3) uint8 of their means and its mask (h,w) bool
    of those that at least half lie inside; what is left over at the right and the bottom is cut off."""
    if times == 1:
        return camera, image, mask
    height, width = camera.height // times, camera.width // times
    K = camera.K.copy()
    K[:2] /= times
    blocks = lambda values: values[: times * height, : times * width].reshape(height, times, width, times, -1)
    image = np.rint(blocks(image).mean((1, 3))).astype(np.uint8)
    return replace(camera, K=K, width=width, height=height), image, blocks(mask).mean((1, 3))[..., 0] >= 0.5


def _span(inside, margin, size):
    """First and one past the last of the pixels, with a margin; at least 16 where the picture has them."""
    first, end = max(int(inside[0]) - margin, 0), min(int(inside[-1]) + 1 + margin, size)
    lacking = max(16 - (end - first), 0)
    return max(first - lacking, 0), min(end + lacking, size)


def _straight(camera, image, mask):
    """Picture and mask at the places where the ideal camera's rays fall."""
    import cv2

    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    xy = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(camera.K).T
    at = camera.distort(xy[..., :2]) @ camera.K[:2, :2].T + camera.K[:2, 2] - 0.5  # cv2: pixel (0,0) at (0,0)
    x, y = np.moveaxis(at.astype(np.float32), -1, 0)
    image = cv2.remap(image, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return image, cv2.remap(mask.astype(np.uint8), x, y, cv2.INTER_NEAREST) > 0
