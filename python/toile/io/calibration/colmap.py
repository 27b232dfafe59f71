"""COLMAP's sparse models, text (`cameras.txt`, `images.txt`) or binary (`.bin`). World to camera, pixel centres at halves.

A picture is a camera: it is called by its name without ending, or by its folder where pictures lie in folders, unless no two of a
folder have the same pose, as in `images/CAM.png` and `FRAME/CAM.png`. Pictures of one camera must have one pose and lens; that
several cameras of a folder share a lens is said, since they may be one that moved. Taken: SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL,
RADIAL, OPENCV, FULL_OPENCV, OPENCV_FISHEYE, SIMPLE_RADIAL_FISHEYE, RADIAL_FISHEYE. Refused: other lenses.
Left: points, observations, rigs, frames. The scale is COLMAP's own, unless the model was scaled: say metres a unit by `--units`.
"""

from __future__ import annotations

import struct
from collections import defaultdict
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ...errors import UserError
from ...kernels.arrays import Floats
from ...scene import Camera
from ..bounded import read_bytes, read_text
from .checked import few, fisheye_lens, intrinsics, make_camera, numbers, rigid

NAMES = ("cameras.bin", "cameras.txt")
BYTES = 2 << 30
# by the number that binary files give; parameters, and where k1 k2 p1 p2 k3 k4 k5 k6 stand among those after c
MODELS = {
    0: ("SIMPLE_PINHOLE", 3), 1: ("PINHOLE", 4), 2: ("SIMPLE_RADIAL", 4), 3: ("RADIAL", 5), 4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8), 6: ("FULL_OPENCV", 12), 8: ("SIMPLE_RADIAL_FISHEYE", 4), 9: ("RADIAL_FISHEYE", 5),
}  # fmt: skip
COUNTS = dict(MODELS.values())
SINGLE = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")  # one focal length
BENT = np.array([[0.5, 0.2], [-0.1, 0.4]])  # ideal normalised coordinates, by which lenses are compared
SAME = 1e-6  # difference of two poses of one camera


def read(path: Path, notes: list[str]) -> dict[str, Camera]:
    """{name: Camera} of the model whose `cameras` file is given."""
    binary = path.suffix == ".bin"
    images = path.with_name(f"images{path.suffix}")
    lenses = _cameras_bin(path) if binary else _cameras_txt(path)
    found = []
    for file, lens, pose in _images_bin(images) if binary else _images_txt(images):
        if lens not in lenses:
            raise UserError(f"{images}: {file}: no camera {lens} in {path.name}")
        q, t = numbers(images, f"{file}: pose", pose, (7,))[:4], np.array(pose[4:])
        if not 0.5 < np.linalg.norm(q) < 2:
            raise UserError(f"{images}: {file}: not a quaternion")
        found.append((PurePosixPath(file.replace("\\", "/")), lens, rigid(_rotation(q), t)))
    by_folder = _called_by_folder(found)
    if not by_folder:
        notes += _shared_lenses(found)
    cameras: dict[str, Camera] = {}
    for place, lens, T in found:
        model, size, parameters = lenses[lens]
        K, bend = _lens(path, model, parameters)
        own = by_folder and place.parent.name
        told = f"camera model {model}" if model.endswith("FISHEYE") else ""
        camera = make_camera(
            images, own or place.stem, size, K, bend, T, fisheye_lens(path, f"camera {lens}: ", bend, told)
        )
        before = cameras.setdefault(camera.name, camera)
        _check_same(
            f"{images}: {place}: camera '{camera.name}'{', called by its folder,' if own else ''}", before, camera
        )
    return cameras


def _called_by_folder(found: list[tuple[PurePosixPath, int, Floats]]) -> bool:
    """Whether a picture's folder is its camera: some folder holds one picture alone, or two of the same pose."""
    folders: dict[PurePosixPath, list[Floats]] = defaultdict(list)
    for place, _, T in found:
        folders[place.parent].append(T.ravel())
    different = lambda poses: len(np.unique(np.round(np.array(poses) / SAME), axis=0))
    return any(len(poses) == 1 or different(poses) < len(poses) for poses in folders.values())


def _shared_lenses(found: list[tuple[PurePosixPath, int, Floats]]) -> list[str]:
    """What is to be said of pictures of one folder that have one lens and a pose each."""
    shared: dict[tuple[PurePosixPath, int], list[str]] = defaultdict(list)
    for place, lens, _ in found:
        shared[place.parent, lens].append(place.name)
    return [
        f"{len(names)} pictures share lens {lens} and became a camera each: {few(names)}; no capture if one camera moved through them"
        for (_, lens), names in shared.items()
        if len(names) > 1
    ]


def _check_same(where: str, before: Camera, camera: Camera) -> None:
    """UserError unless two pictures' cameras are one."""
    if np.abs(before.T_camera_world - camera.T_camera_world).max() > SAME:
        raise UserError(f"{where} has another pose than before: a moving camera is not read")
    lenses = [np.r_[c.size, c.K.ravel(), c.distort(BENT).ravel()] for c in (before, camera)]
    if np.abs(lenses[0] - lenses[1]).max() > SAME:
        raise UserError(f"{where} has another lens than before: calibrate with one lens a folder")


def _rotation(q: Any) -> Floats:
    """Of a Hamilton quaternion w x y z."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(np.roll(q, -1)).as_matrix()


def _lens(path: Path, model: str, p: list[float]) -> tuple[Floats, list[float]]:
    if model not in COUNTS:
        raise UserError(f"{path}: camera model {model} is not read; one of {', '.join(COUNTS)}: undistort the pictures")
    if len(p) != COUNTS[model]:
        raise UserError(f"{path}: {model} has {len(p)} parameters, expected {COUNTS[model]}")
    if model in SINGLE:
        return intrinsics(p[0], p[0], p[1], p[2]), p[3:]
    return intrinsics(*p[:4]), p[4:]


def _cameras_txt(path: Path) -> dict[int, Any]:
    lenses = {}
    for number, line in _lines(path):
        words = line.split()
        try:
            size = int(words[3]), int(words[2])
            lenses[int(words[0])] = words[1], size, [float(w) for w in words[4:]]
        except (ValueError, IndexError):
            raise UserError(f"{path}: line {number}: not CAMERA_ID MODEL WIDTH HEIGHT PARAMS") from None
    return lenses


def _images_txt(path: Path) -> list[tuple[str, int, list[float]]]:
    images = []
    lines = [(i, line) for i, line in enumerate(read_text(path, BYTES).split("\n"), 1) if not line.startswith("#")]
    for number, line in lines[1::2]:
        if len(line.split()) % 3:
            raise UserError(f"{path}: line {number}: not X Y POINT3D_ID ..., the points of the image above, nor empty")
    for number, line in lines[::2]:
        words = line.split()
        if not words:
            continue
        try:
            images.append((" ".join(words[9:]), int(words[8]), [float(w) for w in words[1:8]]))
        except (ValueError, IndexError):
            raise UserError(f"{path}: line {number}: not IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME") from None
    return images


def _lines(path: Path) -> list[tuple[int, str]]:
    lines = enumerate(read_text(path, BYTES).split("\n"), 1)
    return [(i, line) for i, line in lines if line.strip() and not line.startswith("#")]


class _Bytes:
    """Little-endian numbers of a file, one after another; its end is a UserError."""

    def __init__(self, path: Path) -> None:
        self.path, self.data, self.at = path, read_bytes(path, BYTES), 0

    def take(self, layout: str) -> Any:
        try:
            values = struct.unpack_from("<" + layout, self.data, self.at)
        except struct.error:
            raise UserError(f"{self.path}: ends at byte {len(self.data)}, in the middle of an entry") from None
        self.at += struct.calcsize("<" + layout)
        return values

    def skip(self, count: int) -> None:
        if count > len(self.data) - self.at:
            raise UserError(f"{self.path}: ends at byte {len(self.data)}, in the middle of an entry")
        self.at += count

    def word(self) -> str:
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise UserError(f"{self.path}: a name without an end at byte {self.at}")
        word, self.at = self.data[self.at : end].decode("utf-8", "replace"), end + 1
        return word


def _cameras_bin(path: Path) -> dict[int, Any]:
    file, lenses = _Bytes(path), {}
    for _ in range(file.take("Q")[0]):
        lens, model, width, height = file.take("IiQQ")
        if model not in MODELS:
            raise UserError(
                f"{path}: camera model {model} is not read; one of {', '.join(COUNTS)}: undistort the pictures"
            )
        name, count = MODELS[model]
        lenses[lens] = name, (height, width), list(file.take(f"{count}d"))
    return lenses


def _images_bin(path: Path) -> list[tuple[str, int, list[float]]]:
    file, images = _Bytes(path), []
    for _ in range(file.take("Q")[0]):
        _, *pose, lens = file.take("I7dI")
        images.append((file.word(), lens, pose))
        file.skip(24 * file.take("Q")[0])  # x, y, point
    return images
