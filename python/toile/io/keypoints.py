"""keypoints.json."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import UserError
from ..scene import Camera, Keypoints, Points3D
from .bounded import read_json

SUREST = 2.0  # detectors go a little beyond 1; a confidence in percent does so by far


def read_keypoints(path: Path, cameras: dict[str, Camera], left_out: Sequence[str] = ()) -> Keypoints:
    """2D keypoints of one frame, for the cameras that are known; those of cameras that are left out are passed over."""
    data = read_json(path, dict)
    try:
        names = tuple(str(n) for n in data["names"])
        points = {camera: np.array(rows, dtype=np.float64).reshape(-1, 3) for camera, rows in data["points"].items()}
        points = {camera: rows for camera, rows in points.items() if camera not in left_out}
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:
        raise UserError(f"{path}: expected {{names, points: {{camera: [[u, v, confidence], ...]}}}}: {error}") from None
    for camera, rows in points.items():
        if camera not in cameras:
            raise UserError(f"{path}: points.{camera}: no such camera in cameras.json")
        if len(set(names)) < len(names):
            raise UserError(f"{path}: names: {max(names, key=names.count)} stands there twice")
        if len(rows) != len(names):
            raise UserError(f"{path}: points.{camera} has {len(rows)} rows, names {len(names)}")
        bad = np.flatnonzero(~np.isfinite(rows).all(1))
        if len(bad):
            raise UserError(f"{path}: points.{camera}[{bad[0]}] is not finite")
        bad = np.flatnonzero((rows[:, 2] < 0) | (rows[:, 2] > SUREST))
        if len(bad):
            said = f"its confidence is {rows[bad[0], 2]:g}, expected 0 to 1"
            raise UserError(f"{path}: points.{camera}[{bad[0]}]: {said}")
    return Keypoints(names, points)


def read_keypoints3d(path: Path) -> Points3D:
    """keypoints3d.json: names, and x, y, z and sigma [m] of each, null for one that is unseen. UserError names the field."""
    data = read_json(path, dict)
    try:
        names = tuple(str(name) for name in data["names"])
        rows = [[np.nan] * 3 + [np.inf] if row is None else [float(value) for value in row] for row in data["points"]]
        points = np.array(rows, dtype=np.float64).reshape(len(rows), 4)
    except (ValueError, TypeError, KeyError, OverflowError) as error:
        raise UserError(f"{path}: expected {{names, points: [[x, y, z, sigma] or null, ...]}}: {error}") from None
    if len(points) != len(names):
        raise UserError(f"{path}: points has {len(points)} rows, names {len(names)}")
    seen = np.array([row is not None for row in data["points"]], bool)
    bad = np.flatnonzero(seen & ~(np.isfinite(points).all(1) & (points[:, 3] > 0)))
    if len(bad):
        raise UserError(f"{path}: points[{bad[0]}]: expected three finite numbers and a sigma above 0, or null")
    return Points3D(names, points[:, :3], points[:, 3], np.zeros(len(names), np.int32))


def keypoints3d_json(points: Points3D) -> str:
    """The text of keypoints3d.json: x, y, z and sigma [m] a name, null where a point is unseen."""
    rows = [
        [*np.round(p, 6).tolist(), round(float(sigma), 6)] if np.isfinite(p).all() else None
        for p, sigma in zip(points.points, points.sigma)
    ]
    return json.dumps({"names": list(points.names), "points": rows})
