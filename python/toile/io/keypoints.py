"""keypoints.json."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError
from ..kernels.arrays import Floats
from ..scene import Camera, Keypoints, Points3D
from .bounded import read_json

SUREST = 2.0  # detectors go a little beyond 1; a confidence in percent does so by far
UNSEEN = [math.nan, math.nan, math.nan, math.inf]  # of keypoints in space


def read_keypoints(path: Path, cameras: dict[str, Camera], left_out: Sequence[str] = ()) -> Keypoints:
    """2D keypoints of one frame, for the cameras that are known; those of cameras that are left out are passed over."""
    data = read_json(path, dict)
    names, given = _names(path, data), data.get("points")
    if not isinstance(given, dict):
        raise UserError(f"{path}: points: expected {{camera: [[u, v, confidence], ...]}}")
    points = {}
    for camera, listed in given.items():
        if camera in left_out:
            continue
        if camera not in cameras:
            raise UserError(f"{path}: points.{camera}: no such camera in cameras.json")
        points[camera] = rows = _rows(path, f"points.{camera}", listed, names, ("u", "v", "confidence"))
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
    names = _names(path, data)
    points = _rows(path, "points", data.get("points"), names, ("x", "y", "z", "sigma"), UNSEEN)
    seen = np.array([row is not None for row in data["points"]], bool)
    bad = np.flatnonzero(seen & ~(np.isfinite(points).all(1) & (points[:, 3] > 0)))
    if len(bad):
        raise UserError(f"{path}: points[{bad[0]}]: expected three finite numbers and a sigma above 0, or null")
    return Points3D(names, points[:, :3], points[:, 3], np.zeros(len(names), np.int32))


def _names(path: Path, data: dict[str, Any]) -> tuple[str, ...]:
    """The names of keypoints, each once."""
    names = data.get("names")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise UserError(f"{path}: names: expected a list of the keypoints' names")
    if len(set(names)) < len(names):
        raise UserError(f"{path}: names: {max(names, key=names.count)} stands there twice")
    return tuple(names)


def _rows(
    path: Path, field: str, listed: Any, names: Sequence[str], columns: Sequence[str], unseen: list[float] | None = None
) -> Floats:
    """(k,c) of a list of rows, one a name, of JSON's numbers; null is the row `unseen`, if that is given."""
    expected = f"[{', '.join(columns)}]"
    if not isinstance(listed, list):
        raise UserError(f"{path}: {field}: expected [{expected}, ...]")
    if len(listed) != len(names):
        raise UserError(f"{path}: {field} has {len(listed)} rows, names {len(names)}")
    rows = [unseen if row is None else row for row in listed]
    for k, row in enumerate(rows):
        if not isinstance(row, list) or len(row) != len(columns) or not all(type(v) in (int, float) for v in row):
            raise UserError(f"{path}: {field}[{k}]: expected {expected}")
    try:
        return np.array(rows, dtype=np.float64).reshape(len(names), len(columns))
    except OverflowError:
        raise UserError(f"{path}: {field}: holds a number beyond 64 bits") from None


def keypoints3d_json(points: Points3D) -> str:
    """The text of keypoints3d.json: x, y, z and sigma [m] a name, null where a point is unseen."""
    rows = [
        [*np.round(p, 6).tolist(), round(float(sigma), 6)] if np.isfinite(p).all() else None
        for p, sigma in zip(points.points, points.sigma)
    ]
    return json.dumps({"names": list(points.names), "points": rows})
