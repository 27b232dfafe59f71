"""Lenses that a Camera does not know: fisheyes, and polynomials of more coefficients. Their pictures have to be resampled
(`io/flattening.py`)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...errors import UserError
from ...kernels.arrays import Anything, Floats
from ...scene import Camera

COUNTS = (5, 8, 12, 14)  # of OpenCV's coefficients: k1 k2 p1 p2 k3, k4 k5 k6, s1 s2 s3 s4, tau_x tau_y


class Lens(NamedTuple):
    """`bend` takes ideal normalised coordinates (..., 2) to distorted ones; `told`: the calibration's field that says so."""

    bend: Callable[[Floats], Floats]
    told: str


@dataclass(frozen=True)
class Bent(Camera):
    """A Camera as it was calibrated with such a lens; its `distortion` is zero."""

    lens: Lens

    def distort(self, xy: Anything) -> Floats:
        return self.lens.bend(np.asarray(xy, np.float64))


def polynomial(coefficients: Anything) -> Callable[[Floats], Floats]:
    """OpenCV's lens of up to 14 coefficients: rational, with a thin prism, tilted (calib3d, "Detailed Description")."""
    import cv2

    count = next((n for n in COUNTS if n >= len(coefficients)), len(coefficients))
    bends, still = np.pad(coefficients, (0, count - len(coefficients))), np.zeros(3)

    def bend(xy: Floats) -> Floats:
        points = np.concatenate([xy, np.ones_like(xy[..., :1])], -1).reshape(-1, 1, 3)
        found: Anything = cv2.projectPoints(points, still, still, np.eye(3), bends)[0]
        return np.asarray(found, np.float64).reshape(xy.shape)

    return bend


def fisheye(coefficients: Anything) -> Callable[[Floats], Floats]:
    """OpenCV's and COLMAP's fisheye of k1 k2 k3 k4 (Kannala and Brandt 2006): r' = t (1 + k1 t^2 + k2 t^4 + ...), t = atan r."""

    def bend(xy: Floats) -> Floats:
        r = np.linalg.norm(xy, axis=-1, keepdims=True)
        t = np.arctan(r)
        radial = t * (1 + sum(k * t ** (2 * i) for i, k in enumerate(coefficients, 1)))
        return xy * np.where(r > 0, radial / np.where(r > 0, r, 1), 1)

    return bend


def refuse_bent(
    path: Path, cameras: Iterable[Camera], way: str = "undistort the pictures first, or by --undistort"
) -> None:
    """UserError, which names the `way` out, for the first camera whose pictures would have to be resampled."""
    for camera in cameras:
        if isinstance(camera, Bent):
            where = f"{path}: camera '{camera.name}': {camera.lens.told}"
            raise UserError(f"{where}: such lenses are not read: {way}")
