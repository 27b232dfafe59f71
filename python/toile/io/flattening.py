"""Pictures of lenses that a Camera does not know become those that a pinhole camera would have taken from the same place.

The pinhole camera has the same focal lengths, so that the middle of a picture is as sharp as it was. Its picture is the largest of
the same shape that shows nothing but what the lens showed, at most WIDEST times as wide.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ..errors import UserError
from ..kernels.arrays import Anything, Floats
from ..scene import Camera
from .bounded import read_json
from .calibration.lenses import Bent
from .files import replace_file
from .image import one_channel, read_image

WIDEST = 2.0
ALONG = 65  # points of each side of the picture that are asked where the lens showed them
OUTWARDS = 256  # and of each way from the middle to them, along which a lens must not turn back
HALVINGS = 24
NEWTON = 30  # steps of the inverse, which converges in five where the lens is not at its limit
STEP, EXACT = 1e-6, 1e-7  # of normalised coordinates: of a difference quotient, and of an inverse that was found


@dataclass(frozen=True)
class Flattening:
    """Of one camera's pictures."""

    bent: Bent

    @cached_property
    def camera(self) -> Camera:
        """The pinhole camera. UserError: the lens turns back at once."""
        b, share, most = self.bent, 0.0, WIDEST
        for _ in range(HALVINGS):
            middle = (share + most) / 2
            share, most = (middle, most) if _shown(b, middle) else (share, middle)
        height, width = (int(share * side) for side in b.size)
        if min(height, width) < 1:
            raise UserError(f"camera '{b.name}': {b.lens.told}: its lens shows nothing that a pinhole camera would")
        K = np.diag(np.diag(b.K))
        K[:2, 2] = share * b.K[:2, 2]
        return Camera(b.name, width, height, K, np.zeros(5), b.T_camera_world)

    @cached_property
    def _sources(self) -> Anything:
        """Where each pixel lies in the lens' picture (H,W,2), pixel centres at whole numbers, as cv2.remap takes it."""
        camera, b = self.camera, self.bent
        v, u = np.mgrid[: camera.height, : camera.width] + 0.5
        at = b.distort((np.stack([u, v], -1) - camera.K[:2, 2]) / np.diag(camera.K)[:2])
        return (at @ b.K[:2, :2].T + b.K[:2, 2] - 0.5).astype(np.float32)

    def resampled(self, pixels: Anything, kind: str) -> Anything:
        """A picture, mask or label image (H,W,...) uint8, as the pinhole camera's; `kind`: images, masks or labels."""
        import cv2

        how = {"images": cv2.INTER_CUBIC, "masks": cv2.INTER_LINEAR, "labels": cv2.INTER_NEAREST}[kind]
        found: Anything = cv2.remap(pixels, self._sources, None, how, borderMode=cv2.BORDER_REPLICATE)
        return np.where(found > 127, 255, 0).astype(np.uint8) if kind == "masks" else found

    def read(self, path: Path, kind: str) -> Anything:
        """`resampled` of a file."""
        mode = {"images": "RGB", "labels": "P"}.get(kind)
        return self.resampled(read_image(path, self.bent.size, mode) if mode else one_channel(path), kind)

    def points(self, uv: Floats) -> Floats:
        """Pixels (n,2) of the lens' picture in the pinhole camera's; NaN where that does not show them."""
        b, camera = self.bent, self.camera
        at = np.linalg.solve(b.K[:2, :2], (uv - b.K[:2, 2]).T).T
        xy = at.copy()
        for _ in range(NEWTON):
            moved = [(b.distort(xy + d) - b.distort(xy - d)) / (2 * STEP) for d in STEP * np.eye(2)]
            J = np.stack(moved, -1)
            safe = np.abs(np.linalg.det(J)) > 1e-12
            xy[safe] += np.linalg.solve(J[safe], (at - b.distort(xy))[safe][..., None])[..., 0]
        found = xy @ camera.K[:2, :2].T + camera.K[:2, 2]
        there = (np.abs(b.distort(xy) - at) < EXACT).all(1) & ((found >= 0) & (found <= camera.size[::-1])).all(1)
        found[~there] = np.nan
        return found


def _shown(b: Bent, share: float) -> bool:
    """Whether the lens shows a pinhole camera's picture of `share` of the calibrated sides, all of it and once."""
    low, high = (share * (corner - b.K[:2, 2]) / np.diag(b.K)[:2] for corner in (np.zeros(2), np.array(b.size[::-1])))
    t = np.linspace(0, 1, ALONG)[:, None]
    across, down = low + t * (high - low) * [1, 0], low + t * (high - low) * [0, 1]
    border = np.concatenate([across, across + (high - low) * [0, 1], down, down + (high - low) * [1, 0]])
    ways = b.distort(np.linspace(0, 1, OUTWARDS + 1)[:, None, None] * border)
    pixels = ways[-1] @ b.K[:2, :2].T + b.K[:2, 2]
    inside = ((pixels >= 0) & (pixels <= b.size[::-1])).all()
    return bool(inside and (np.diff(np.linalg.norm(ways, axis=-1), axis=0) > 0).all())


def flatten_keypoints(path: Path, flattenings: Mapping[str, Flattening]) -> int:
    """Rewrites keypoints.json with the points of these cameras where the pinhole cameras show them, of confidence 0 where they do not;
    gives how many that had been seen are not now."""
    data, lost = read_json(path, dict), 0
    for name in flattenings.keys() & data["points"].keys():
        rows = np.array(data["points"][name], np.float64).reshape(-1, 3)
        rows[:, :2] = flattenings[name].points(rows[:, :2])
        gone = ~np.isfinite(rows).all(1)
        lost += int((rows[gone, 2] > 0).sum())
        rows[gone] = 0
        data["points"][name] = np.round(rows, 4).tolist()
    replace_file(path, lambda part: part.write_text(json.dumps(data), encoding="utf-8"))
    return lost
