"""Where a picture's keypoints say that the person is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from ...io.skeletons import SIDED

SURE = 0.3  # confidence of a keypoint that counts
BONES = (("nose", "ear"), ("ear", "shoulder"), ("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"),
         ("ankle", "heel"), ("ankle", "big_toe"))  # fmt: skip
FORESHORTENED = 0.2  # of the keypoints' extent: a trunk seen shorter than this points at the camera
EVEN = 0.1  # trunks' lengths from the limbs: as likely person as background
SAYS = 1.0  # bound of the log-odds: the network, where it is sure, has the last word


@dataclass(frozen=True)
class SeenLimbs:
    """Bones (n,2,2) and trunk (4,2) of a person in a picture [px], and the trunk's length [px]."""

    bones: Any
    trunk: Any
    length: float

    def background(self, shape: tuple[int, int]) -> Any:
        """Log-odds (H,W) float32 of the background: -1 on the limbs, 0 a tenth of the trunk from them, 1 from a fifth on."""
        off = np.ones(shape, np.uint8)
        cv2.fillConvexPoly(off, cv2.convexHull(_pixels(self.trunk)), 0)
        cv2.polylines(off, list(_pixels(self.bones)), False, 0)
        distance = cv2.distanceTransform(off, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        return SAYS * np.minimum(distance / (EVEN * self.length) - 1, 1)


def limbs_of(names: Sequence[str], rows: Any) -> SeenLimbs | None:
    """The limbs that rows (k,3) of u, v [px] and confidence of keypoints show; None unless they show shoulders and hips."""
    points = np.asarray(rows, np.float64)
    seen = {name: row[:2] for name, row in zip(names, points) if row[2] > SURE and np.isfinite(row).all()}
    trunk = [seen.get(_name(part, side)) for part in ("shoulder", "hip") for side in "LR"]
    if any(corner is None for corner in trunk):
        return None
    pairs = [(_name(a, side), _name(b, side)) for a, b in BONES for side in "LR"]
    bones = [(seen[a], seen[b]) for a, b in pairs if a in seen and b in seen]
    extent = float(np.ptp(list(seen.values()), axis=0).max())
    corners = np.array(trunk)
    length = float(np.linalg.norm(corners[:2].mean(0) - corners[2:].mean(0)))
    return SeenLimbs(np.array(bones).reshape(-1, 2, 2), corners, max(length, FORESHORTENED * extent, 1.0))


def _name(part: str, side: str) -> str:
    return "face.nose_tip" if part == "nose" else f"{SIDED[part]}.{side}"


def _pixels(points: Any) -> Any:
    return np.clip(np.floor(points), -(2**20), 2**20).astype(np.int32)  # 0.5 is the first pixel's centre
