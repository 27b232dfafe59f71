"""cameras.json."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from ..errors import UserError
from ..kernels.arrays import Anything
from ..scene import Camera
from .bounded import read_json
from .image import MAX_PIXELS


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str
    width: int
    height: int
    K: list[list[float]]
    distortion: list[float]
    T_camera_world: list[list[float]]


class _CamerasFile(BaseModel):
    model_config = ConfigDict(extra="forbid")
    cameras: list[_Entry]


def first_error(path: Path | str, error: ValidationError, *within: object) -> UserError:
    """One line of a pydantic error: the file, the field (of the table `within`), what is wrong."""
    first = error.errors()[0]
    field = ".".join(str(part) for part in (*within, *first["loc"]))
    return UserError(f"{path}: {field}: {first['msg']}")


def read_cameras(path: Path, metres: float = 1.0) -> dict[str, Camera]:
    """{name: Camera}; translations are scaled by `metres` a unit."""
    try:
        entries = _CamerasFile(**read_json(path, dict)).cameras
    except ValidationError as error:
        raise first_error(path, error) from None
    cameras = {}
    for i, entry in enumerate(entries):
        if entry.name in cameras:
            raise UserError(f"{path}: cameras.{i}.name: '{entry.name}' stands there twice")
        cameras[entry.name] = _camera(path, i, entry, metres)
    return cameras


def _camera(path: Path, i: int, entry: Any, metres: float) -> Camera:
    def array(field: str, shape: tuple[int, ...]) -> Anything:
        values = np.array(getattr(entry, field), dtype=np.float64) if _regular(getattr(entry, field)) else np.zeros(0)
        if values.shape != shape or not np.isfinite(values).all():
            raise UserError(f"{path}: cameras.{i}.{field} ({entry.name}): expected {shape} finite numbers")
        return values

    K, distortion, T = array("K", (3, 3)), array("distortion", (5,)), array("T_camera_world", (4, 4))
    if entry.width <= 0 or entry.height <= 0 or K[0, 0] <= 0 or K[1, 1] <= 0:
        raise UserError(f"{path}: cameras.{i} ({entry.name}): width, height and focal lengths must be positive")
    if entry.width * entry.height > MAX_PIXELS:
        raise UserError(f"{path}: cameras.{i} ({entry.name}): more than {MAX_PIXELS} pixels")
    if not np.array_equal(K[2], [0, 0, 1]) or abs(K[1, 0]) > 1e-6 * K[0, 0]:
        raise UserError(f"{path}: cameras.{i}.K ({entry.name}): expected [[fx, s, cx], [0, fy, cy], [0, 0, 1]]")
    R, place = T[:3, :3], f"{path}: cameras.{i}.T_camera_world ({entry.name})"
    if not np.allclose(T[3], [0, 0, 0, 1]):
        raise UserError(f"{place}: its last row is not 0 0 0 1: is it transposed?")
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-4 or np.linalg.det(R) < 0:
        raise UserError(f"{place}: its upper left is not a rotation")
    T = T.copy()
    T[:3, 3] *= metres
    return Camera(entry.name, entry.width, entry.height, K, distortion, T)


def _regular(values: Any) -> bool:
    return not values or not isinstance(values[0], list) or len({len(row) for row in values}) == 1
