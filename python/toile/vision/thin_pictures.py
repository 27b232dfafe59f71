"""Pictures by fewer pixels: those of a camera of 4096 pixels show more than labels and openings need, and fill the memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from ..scene import Camera, Frame
from .threads import parallel_map


def thin_camera(camera: Camera, most: int) -> Camera:
    """The Camera of the pixels that `thin_pictures` keeps: every f-th from f // 2 on. Pixel i has its centre at
    i + 0.5, so that u' = (u - f // 2 - 0.5) / f + 0.5."""
    f = _step(camera.size, most)
    if f == 1:
        return camera
    K = camera.K.copy()
    K[:2, 2] -= f // 2 + 0.5
    K[:2] /= f
    K[:2, 2] += 0.5
    height, width = (len(range(f // 2, side, f)) for side in camera.size)
    return replace(camera, width=width, height=height, K=K)


def thin_cameras(cameras: Mapping[str, Camera], most: int) -> dict[str, Camera]:
    """`thin_camera` of each."""
    return {name: thin_camera(camera, most) for name, camera in cameras.items()}


def thin_pictures(frame: Frame, most: int) -> Frame:
    """The Frame whose pictures have no side longer than `most` [px]: every f-th pixel, the least such f. Images are means over
    about f pixels across; masks, labels and their certainty are those of the pixels kept."""
    fields = {name: getattr(frame, name) for name in ("images", "masks", "labels", "certainty")}
    return replace(frame, **{name: _thinned(pictures, most) for name, pictures in fields.items()})


def _thinned(pictures: Mapping[str, Any], most: int) -> dict[str, Any]:
    return dict(zip(pictures, parallel_map(lambda picture: thin_picture(picture, most), list(pictures.values()))))


def thin_picture(picture: Any, most: int) -> Any:
    """One picture of `thin_pictures`; itself where it has no longer side."""
    f = _step(picture.shape[:2], most)
    if f == 1:
        return picture
    smooth = cv2.blur(picture, (f | 1, f | 1)) if picture.ndim == 3 else picture
    return np.ascontiguousarray(smooth[f // 2 :: f, f // 2 :: f])


def _step(size: tuple[int, ...], most: int) -> int:
    """The least f such that no side has more than `most` pixels when every f-th is kept."""
    return max(1, *(-(-side // most) for side in size))
