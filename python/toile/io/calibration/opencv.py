"""OpenCV's FileStorage (YAML, XML or JSON), in the two layouts that people use. Pixel centres are whole numbers there.

- `intri.yml` and `extri.yml` (EasyMocap): `names`, `K_NAME`, `dist_NAME`, optionally `H_NAME`, `W_NAME`; `Rot_NAME` (3x3)
  or `R_NAME` (Rodrigues), `T_NAME`.
- A file a camera, in one folder: `camera_matrix`, `distortion_coefficients`, `image_width`, `image_height` as OpenCV's own
  calibration writes them, and `R` (3x3 or Rodrigues), `T`, world to camera.

Where `fisheye_model` or another field tells of a fisheye lens (in intri.yml also `fisheye_model_NAME`, of one camera), its
coefficients are k1 k2 k3 k4. Left: everything else in the files. Refused: coefficients of other names, cameras without a pose.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import UserError
from ...kernels.arrays import Floats
from ...scene import Camera
from ..bounded import read_text, reason_of
from .checked import HALF, add, check_lens, fisheye_lens, intrinsics, make_camera, numbers, rigid, rotation

NAMES = ("intri.yml", "*.yml", "*.yaml", "*.xml", "*.json")
BYTES = 16 << 20
ENTRIES = 64  # rows or columns of a matrix
MATRIX = ("camera_matrix", "K", "intrinsics", "cameraMatrix", "Camera_Matrix")
DISTORTION = ("distortion_coefficients", "dist", "D", "distCoeffs", "Distortion_Coefficients")
ROTATION = ("R", "Rot", "rvec", "rotation")
TRANSLATION = ("T", "t", "tvec", "translation")


def read(path: Path, notes: list[str]) -> dict[str, Camera]:
    """{name: Camera} of intri.yml and the extri.yml beside it, or of all files of a camera each beside `path`."""
    if _has(_opened(path), "names"):
        return _pair(path)
    cameras: dict[str, Camera] = {}
    for file in sorted(path.parent.glob(f"*{path.suffix}")):
        add(file, cameras, _single(file))
    return cameras


def _pair(path: Path) -> dict[str, Camera]:
    if path.stem.startswith("extri"):
        path = path.with_name(path.name.replace("extri", "intri", 1))
    inside, extri = _opened(path), path.with_name(path.name.replace("intri", "extri", 1))
    if extri == path:
        raise UserError(f"{path}: expected intri.yml with an extri.yml beside it")
    outside = _opened(extri)
    listed = inside.getNode("names")
    names = [_word(listed.at(i)) for i in range(listed.size())]
    cameras: dict[str, Camera] = {}
    fields = _fields(names, inside)
    for name in names:
        told = check_lens(path, f"camera '{name}': ", fields[name], ("dist",))
        K = _intrinsics(path, f"K_{name}", inside.getNode(f"K_{name}"))
        bend = _matrix(path, f"dist_{name}", inside.getNode(f"dist_{name}"))
        size = [int(inside.getNode(f"{side}_{name}").real()) for side in ("H", "W")]
        turn = next((key for key in (f"Rot_{name}", f"R_{name}") if _has(outside, key)), None)
        if turn is None:
            raise UserError(f"{extri}: Rot_{name}: camera '{name}' of {path.name} has no pose there")
        R = rotation(extri, turn, _matrix(extri, turn, outside.getNode(turn)))
        t = numbers(extri, f"T_{name}", _matrix(extri, f"T_{name}", outside.getNode(f"T_{name}")), (3,))
        lens = fisheye_lens(path, f"camera '{name}': ", bend.ravel(), told)
        add(path, cameras, make_camera(path, name, (size[0], size[1]), K, bend.ravel(), rigid(R, t), lens))
    return cameras


def _fields(names: list[str], file: Any) -> dict[str, dict[str, Any]]:
    """What intri.yml says of each camera, FIELD_NAME by FIELD, and of all."""
    every: dict[str, Any] = {}
    of: dict[str, dict[str, Any]] = {name: {} for name in names}
    for key in file.root().keys():
        owner = max((name for name in names if key.endswith(f"_{name}")), key=len, default=None)
        if owner is not None:
            of[owner][key.removesuffix(f"_{owner}")] = _plain(file.getNode(key))
        elif key != "names":
            every[key] = _plain(file.getNode(key))
    return {name: every | own for name, own in of.items()}


def _single(path: Path) -> Camera:
    file = _opened(path)

    def named(keys: tuple[str, ...], least: bool = True) -> Any:
        key = next((k for k in keys if _has(file, k)), None)
        if key is None and least:
            raise UserError(f"{path}: {keys[0]} is missing")
        return key

    told = check_lens(path, "", {key: _plain(file.getNode(key)) for key in file.root().keys()}, DISTORTION)
    matrix, bend, turn, place = named(MATRIX), named(DISTORTION, False), named(ROTATION), named(TRANSLATION)
    K = _intrinsics(path, matrix, file.getNode(matrix))
    coefficients = np.zeros(5) if bend is None else _matrix(path, bend, file.getNode(bend)).ravel()
    size = int(file.getNode("image_height").real()), int(file.getNode("image_width").real())
    R = rotation(path, turn, _matrix(path, turn, file.getNode(turn)))
    t = numbers(path, place, _matrix(path, place, file.getNode(place)), (3,))
    lens = fisheye_lens(path, "", coefficients, told)
    return make_camera(path, path.stem, size, K, coefficients, rigid(R, t), lens)


def _intrinsics(path: Path, field: str, node: Any) -> Floats:
    K = numbers(path, field, _matrix(path, field, node), (3, 3))
    return intrinsics(K[0, 0], K[1, 1], K[0, 2] + HALF, K[1, 2] + HALF, K[0, 1])


def _plain(node: Any) -> Any:
    """A node's word or number, else what its matrix holds, if it is one."""
    if node.isString() or node.isInt() or node.isReal():
        return node.string() if node.isString() else node.real()
    return node.mat() if node.isMap() else None


def _word(node: Any) -> str:
    return str(node.string()) if node.isString() else str(int(node.real()))


def _has(file: Any, key: str) -> bool:
    return not file.getNode(key).empty()


def _matrix(path: Path, field: str, node: Any) -> Floats:
    matrix = node.mat() if node.isMap() else None
    if matrix is None:
        raise UserError(f"{path}: {field}: expected an opencv-matrix")
    return np.asarray(matrix, np.float64)


def _opened(path: Path) -> Any:
    """A cv2.FileStorage of a text whose matrices are small."""
    import cv2

    text = read_text(path, BYTES)
    for word, count in re.findall(r"\b(rows|cols)\W{1,4}(\d+)", text):
        if len(count) > 4 or int(count) > ENTRIES:
            raise UserError(f"{path}: a matrix of {count} {word}, at most {ENTRIES} are read")
    try:
        return cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    except (cv2.error, SystemError, ValueError) as error:
        raise UserError(f"{path}: OpenCV cannot read it: {reason_of(error)}") from None
