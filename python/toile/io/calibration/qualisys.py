"""Qualisys' calibration (`.qca.txt` or `.xml`): lengths in millimetres, pixels in 1/64 with centres at whole numbers (the
sensor's last, `sensorMaxU`, is 64 (width - 1)), cameras that look along their negative z axis, y up.

Taken: `fov_video` (the part of the sensor that is filmed), `transform` (camera to world), `intrinsic`. Left: `fov_marker`,
residuals, wand. Cameras with `active="0"` are left out, and said.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from ...errors import UserError
from ...kernels.arrays import Floats
from ...scene import Camera
from ..bounded import read_xml
from .checked import HALF, add, few, intrinsics, make_camera, numbers, rigid, rotation

NAMES = ("*.qca.txt", "*.qca", "*.xml")
SUBPIXELS = 64
LENS = (*(f"radialDistortion{i}" for i in (1, 2)), "tangentalDistortion1", "tangentalDistortion2", "radialDistortion3")


def read(path: Path, notes: list[str]) -> dict[str, Camera]:
    """{serial: Camera}, lengths in millimetres."""
    cameras: dict[str, Camera] = {}
    inactive = []
    for element in read_xml(path).iter("camera"):
        if element.get("active", "1") == "0":
            inactive.append(element.get("serial", ""))
        else:
            add(path, cameras, _camera(path, element))
    if inactive:
        notes.append(f"left: {len(inactive)} cameras that are not active: {few(inactive)}")
    return cameras


def _camera(path: Path, element: Element) -> Camera:
    name = element.get("serial", "")
    if not name:
        raise UserError(f"{path}: a camera without serial")

    def read_from(table: str, fields: Any, default: float | None = None) -> Floats:
        found = element.find(table)
        if found is None:
            raise UserError(f"{path}: camera '{name}': <{table}> is missing")
        values = [found.get(field, default) for field in fields]
        return numbers(path, f"camera '{name}': {table} {' '.join(fields)}", values, (len(values),))

    left, top, right, bottom = read_from("fov_video", ("left", "top", "right", "bottom"))
    R = rotation(path, name, read_from("transform", [f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)]))
    R = np.diag([1.0, -1, -1]) @ R
    centre = read_from("transform", "xyz")
    fx, fy, cx, cy = (
        read_from("intrinsic", ("focalLengthU", "focalLengthV", "centerPointU", "centerPointV")) / SUBPIXELS
    )
    skew = read_from("intrinsic", ("skew",), 0.0)[0] / SUBPIXELS
    bend = read_from("intrinsic", LENS, 0.0)
    K = intrinsics(fx, fy, cx - left + HALF, cy - top + HALF, skew)
    return make_camera(path, name, (int(bottom - top) + 1, int(right - left) + 1), K, bend, rigid(R, -R @ centre))
