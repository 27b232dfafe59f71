"""ActorsHQ: a sequence at one resolution, `Actor01/Sequence1/4x/`.

Taken: `calibration.csv` (axis-angle and position, camera to world [m]; focal lengths and principal points are shares of the
picture's sides, whose edges are at 0 and 1), `rgbs/CAM/CAM_rgb000012.jpg`, `masks/CAM/CAM_mask000012.png`.

Left: `aabbs.csv`, `occupancy_grids`, `meshes.abc`, light annotations. 25 frames a second.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from ...errors import UserError
from ...scene import Camera
from ..bounded import read_text
from ..calibration.checked import add, intrinsics, inverse, make_camera, numbers, rigid, rotation
from ..importing import Found, Source
from ..places import placed
from .upright import upright

COLUMNS = ("w", "h", "rx", "ry", "rz", "tx", "ty", "tz", "fx", "fy", "px", "py")
FPS = 25.0


def read(source: Path, up: str = "") -> Found:
    """A sequence as a capture. UserError names the file and the field."""
    cameras, axis, _, note = upright(source, _cameras(source / "calibration.csv"), up)
    frames: dict[int, dict[str, Source]] = {}
    for folder, kind, end in (("rgbs", "images", ".jpg"), ("masks", "masks", ".png")):
        if (source / folder).is_dir():
            for number, files in placed(source / folder, kind, cameras).files.items():
                for camera, path in files.items():
                    frames.setdefault(number, {})[f"{kind}/{camera}{end}"] = path
    notes = (note, "left: bounding boxes, occupancy grids, meshes.abc, light annotations")
    return Found(cameras, dict(sorted(frames.items())), axis, FPS, notes=notes)


def _cameras(path: Path) -> dict[str, Camera]:
    cameras: dict[str, Camera] = {}
    for i, row in enumerate(csv.DictReader(io.StringIO(read_text(path))), 2):
        missing = [column for column in ("name", *COLUMNS) if row.get(column) is None]
        if missing:
            raise UserError(f"{path}: line {i}: {missing[0]} is missing")
        w, h, *rest = numbers(path, f"line {i}", [row[column] for column in COLUMNS], (12,)).tolist()
        pose = rigid(rotation(path, f"line {i}", rest[:3]), rest[3:6])
        fx, fy, px, py = rest[6:]
        K = intrinsics(fx * w, fy * h, px * w, py * h)
        add(path, cameras, make_camera(path, row["name"], (int(h), int(w)), K, np.zeros(5), inverse(pose)))
    return cameras
