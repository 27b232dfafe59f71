"""keypoints.json."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from ..errors import UserError
from ..scene import Camera, Keypoints, Points3D
from .bounded import read_json


def read_keypoints(path: Path, cameras: dict[str, Camera]) -> Keypoints:
    """2D keypoints of one frame, for the cameras that are known."""
    data = read_json(path, dict)
    try:
        names = tuple(str(n) for n in data["names"])
        points = {camera: np.array(rows, dtype=np.float64).reshape(-1, 3) for camera, rows in data["points"].items()}
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:
        raise UserError(f"{path}: expected {{names, points: {{camera: [[u, v, confidence], ...]}}}}: {error}") from None
    for camera, rows in points.items():
        if camera not in cameras:
            raise UserError(f"{path}: points.{camera}: no such camera in cameras.json")
        if len(rows) != len(names):
            raise UserError(f"{path}: points.{camera} has {len(rows)} rows, names {len(names)}")
        bad = np.flatnonzero(~np.isfinite(rows).all(1))
        if len(bad):
            raise UserError(f"{path}: points.{camera}[{bad[0]}] is not finite")
    return Keypoints(names, points)


def keypoints3d_json(points: Points3D) -> str:
    """The text of keypoints3d.json: x, y, z and sigma [m] a name, null where a point is unseen."""
    rows = [
        [*np.round(p, 6).tolist(), round(float(sigma), 6)] if np.isfinite(p).all() else None
        for p, sigma in zip(points.points, points.sigma)
    ]
    return json.dumps({"names": list(points.names), "points": rows})
