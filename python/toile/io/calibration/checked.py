"""Numbers of a calibration become a Camera, or a UserError that names the file and the field."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any
from unicodedata import normalize

import numpy as np

from ...errors import UserError
from ...kernels.arrays import Anything, Floats
from ...scene import Camera
from ..image import MAX_PIXELS
from .lenses import COUNTS, Bent, Lens, fisheye, polynomial

ROUNDED = 2e-3  # how far a rotation may be from orthonormal: files round to four digits
FISHEYE = re.compile("fish|equidist|kannala", re.IGNORECASE)
OTHER_LENS = re.compile("omnidir|double.?sphere", re.IGNORECASE)
COEFFICIENTS = re.compile(r"dist(?!ance)|radial|tangential|[kp]\d$", re.IGNORECASE)  # what a field of them is called
SHOWN = 3  # names in a message
HALF = 0.5  # from pixel centres at whole numbers (OpenCV) to centres at halves


def numbers(path: Path, field: str, value: Any, *shapes: tuple[int, ...]) -> Floats:
    """`value` as finite float64 of the first of `shapes` that has as many numbers."""
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.full(1, np.nan)
    wanted = " or ".join(map(str, shapes))
    if not np.isfinite(array).all():
        raise UserError(f"{path}: {field}: expected finite numbers of shape {wanted}")
    for shape in shapes:
        if array.size == np.prod(shape):
            return array.reshape(shape)
    raise UserError(f"{path}: {field}: {array.size} numbers, expected {wanted}")


def rotation(path: Path, field: str, value: Any) -> Floats:
    """(3,3), from nine numbers or from a rotation vector of three (Rodrigues), made orthonormal to the last digit."""
    from scipy.spatial.transform import Rotation

    R = numbers(path, field, value, (3, 3), (3,))
    if R.shape == (3,):
        return Rotation.from_rotvec(R).as_matrix()
    if np.abs(R @ R.T - np.eye(3)).max() > ROUNDED:
        raise UserError(f"{path}: {field}: not a rotation")
    if np.linalg.det(R) < 0:
        raise UserError(f"{path}: {field}: a mirrored rotation (determinant -1)")
    U, _, Vt = np.linalg.svd(R)
    return U @ Vt


def placed(path: Path, field: str, value: Any) -> Floats:
    """(4,4) of (4,4) or (3,4) numbers, its upper left a rotation. UserError: its last row is not 0 0 0 1."""
    M = numbers(path, field, value, (4, 4), (3, 4))
    if len(M) == 4 and not np.allclose(M[3], [0, 0, 0, 1]):
        raise UserError(f"{path}: {field}: its last row is {M[3].tolist()}, expected 0 0 0 1: is it transposed?")
    return rigid(rotation(path, field, M[:3, :3]), M[:3, 3])


def rigid(R: Anything, t: Anything) -> Floats:
    """(4,4) that maps x to R x + t."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T


def inverse(T: Anything) -> Floats:
    """Of a rigid motion."""
    return rigid(T[:3, :3].T, -T[:3, :3].T @ T[:3, 3])


def intrinsics(fx: float, fy: float, cx: float, cy: float, skew: float = 0.0) -> Floats:
    """K (3,3)"""
    return np.array([[fx, skew, cx], [0, fy, cy], [0, 0, 1.0]])


def make_camera(
    path: Path,
    name: str,
    size: tuple[int, int],
    K: Anything,
    distortion: Any,
    T_camera_world: Anything,
    lens: Lens | None = None,
) -> Camera:
    """A Camera whose K has pixel centres at halves, its name in NFC; `size` (height, width), zeros where unknown. Bent where it has a
    `lens`, which stands for `distortion`, or where of OpenCV's coefficients others than the first five are not zero."""
    name = normalize("NFC", name)
    if name != Path(name).name or name.startswith(".") or not name.isprintable():
        raise UserError(f"{path}: camera {name!r}: its name cannot be a file's")
    where = f"{path}: camera '{name}'"
    given = numbers(path, f"camera '{name}': distortion", distortion, (np.size(distortion),))
    if lens is None and np.any(given[5:]):
        if len(given) > COUNTS[-1]:
            raise UserError(f"{where}: distortion: {len(given)} numbers, at most {COUNTS[-1]} are known")
        lens = Lens(polynomial(given), f"distortion {given[5:].tolist()} beyond k1 k2 p1 p2 k3")
    bend = np.zeros(5)
    if lens is None:
        bend[: min(len(given), 5)] = given[:5]
    height, width = (int(n) for n in size)
    if K[0, 0] <= 0 or K[1, 1] <= 0 or abs(K[2, 2] - 1) > 1e-9 or np.any(K[2, :2]) or K[1, 0]:
        raise UserError(f"{where}: K: not an intrinsic matrix of positive focal lengths whose last row is 0 0 1")
    if min(height, width) < 0 or (height == 0) != (width == 0):
        raise UserError(f"{where}: size {width} x {height}")
    if width * height > MAX_PIXELS:
        raise UserError(f"{where}: {width} x {height} pixels, at most {MAX_PIXELS} are read")
    if not all(np.isfinite(a).all() for a in (K, T_camera_world)):
        raise UserError(f"{where}: K or its pose is not finite")
    fields = name, width, height, np.asarray(K, float), bend, np.asarray(T_camera_world, float)
    return Camera(*fields) if lens is None else Bent(*fields, lens)


def check_lens(path: Path, where: str, fields: Mapping[str, Any], read: Collection[str]) -> str:
    """The field, if any, that says that the lens is a fisheye. UserError for fields, numbers and words, that speak of a lens of yet
    another kind, and for coefficients that are not zero and not among the fields that are `read`."""
    told = ""
    for key, value in fields.items():
        word = value if isinstance(value, str) else ""
        said = not word and bool(np.any(value))
        if OTHER_LENS.search(word) or (said and OTHER_LENS.search(key)):
            raise UserError(f"{path}: {where}{key}: lenses of this kind are not known: undistort the pictures first")
        if FISHEYE.search(word) or (said and FISHEYE.search(key)):
            told = key
        elif COEFFICIENTS.match(key) and key not in read and said:
            raise UserError(f"{path}: {where}{key}: coefficients are read from {', '.join(read)} alone")
    return told


def fisheye_lens(path: Path, where: str, coefficients: Any, told: str) -> Lens | None:
    """The fisheye that the field `told` speaks of, "" for none, of up to four coefficients."""
    if not told:
        return None
    given = numbers(path, f"{where}distortion", coefficients, (np.size(coefficients),))
    if np.any(given[4:]):
        raise UserError(f"{path}: {where}distortion: {len(given)} numbers, a fisheye ({told}) has k1 k2 k3 k4")
    return Lens(fisheye(given[:4]), f"{told}: a fisheye")


def add(path: Path, cameras: dict[str, Camera], camera: Camera) -> None:
    """Into `cameras` under its name, which may be there once."""
    if camera.name in cameras:
        raise UserError(f"{path}: camera '{camera.name}' stands there twice")
    cameras[camera.name] = camera


def few(names: Iterable[str]) -> str:
    """The first of some names, for a message."""
    names = list(names)
    return ", ".join(names[:SHOWN]) + (", ..." if len(names) > SHOWN else "")
