"""Plain lists of K, R, t.

- JSON: {name: {...}} or [{"name": ..., ...}], alone or under "cameras". A camera has `K` (3x3), and `R` (3x3 or Rodrigues)
  with `t`, or `RT` (3x4 or 4x4), or `camera_to_world` (3x4 or 4x4); optionally `dist`, `width` and `height`. Other spellings
  are in SPELLINGS. The file may say `"pixel_centre": 0.5`; without it pixel centres are whole numbers, as OpenCV's.
- Middlebury multi-view stereo `*_par.txt`: `name.png K (9) R (9) t (3)`, whole pixel centres.

World to camera, unless it is called camera_to_world. Where a field tells of a fisheye lens, `dist` is k1 k2 k3 k4 of one. Left:
every other field; refused are those that tell of yet other lenses and coefficients of other names.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import UserError
from ...kernels.arrays import Floats
from ...scene import Camera
from ..bounded import read_json, read_text
from .checked import (
    HALF,
    add,
    check_lens,
    fisheye_lens,
    intrinsics,
    inverse,
    make_camera,
    numbers,
    placed,
    rigid,
    rotation,
)

NAMES = ("*_par.txt", "*.json")
SPELLINGS = {
    "K": ("K", "intrinsics", "intrinsic", "camera_matrix", "intrinsic_matrix"),
    "R": ("R", "rotation", "Rot", "rvec"),
    "t": ("t", "T", "translation", "tvec"),
    "RT": ("RT", "Rt", "extrinsics", "extrinsic", "world_to_camera", "w2c"),
    "camera_to_world": ("camera_to_world", "c2w", "cam2world"),
    "dist": ("dist", "D", "distortion", "dist_coeffs", "distCoef", "distortion_coefficients"),
    "width": ("width", "w", "W", "image_width"),
    "height": ("height", "h", "H", "image_height"),
}


def read(path: Path, notes: list[str]) -> dict[str, Camera]:
    """{name: Camera} of either file."""
    return _json(path) if path.suffix.lower() == ".json" else _middlebury(path)


def _json(path: Path) -> dict[str, Camera]:
    data = read_json(path)
    half = HALF
    if isinstance(data, dict):
        half -= float(numbers(path, "pixel_centre", data.pop("pixel_centre", 0), (1,))[0])
        data = data.get("cameras", data)
    if isinstance(data, dict):
        data = [{"name": name, **fields} for name, fields in data.items() if isinstance(fields, dict)]
    if not isinstance(data, list) or not all(isinstance(fields, dict) for fields in data):
        raise UserError(f"{path}: expected {{name: {{K, R, t}}}} or a list of {{name, K, R, t}}")
    cameras: dict[str, Camera] = {}
    for i, fields in enumerate(data):
        add(path, cameras, _camera(path, str(fields.get("name", i)), fields, half))
    return cameras


def _camera(path: Path, name: str, fields: dict[str, Any], half: float) -> Camera:
    given = {word: next((fields[k] for k in SPELLINGS[word] if k in fields), None) for word in SPELLINGS}

    def needed(word: str, *shapes: tuple[int, ...]) -> Floats:
        if given[word] is None:
            raise UserError(f"{path}: camera '{name}': {word} is missing")
        return numbers(path, f"camera '{name}': {word}", given[word], *shapes)

    told = check_lens(path, f"camera '{name}': ", fields, SPELLINGS["dist"])
    K = needed("K", (3, 3))
    K = intrinsics(K[0, 0], K[1, 1], K[0, 2] + half, K[1, 2] + half, K[0, 1])
    word = next((w for w in ("camera_to_world", "RT") if given[w] is not None), None)
    if word is None:
        T = rigid(rotation(path, f"camera '{name}': R", needed("R", (3, 3), (3,))), needed("t", (3,)))
    else:
        T = placed(path, f"camera '{name}': {word}", given[word])
        T = inverse(T) if word == "camera_to_world" else T
    size = [int(numbers(path, f"camera '{name}': {side}", given[side] or 0, (1,))[0]) for side in ("height", "width")]
    bend = np.zeros(5) if given["dist"] is None else np.ravel(given["dist"])
    lens = fisheye_lens(path, f"camera '{name}': ", bend, told)
    return make_camera(path, name, (size[0], size[1]), K, bend, T, lens)


def _middlebury(path: Path) -> dict[str, Camera]:
    cameras: dict[str, Camera] = {}
    for number, line in enumerate(read_text(path).split("\n"), 1):
        words = line.split()
        if len(words) < 2:
            continue  # the count, or nothing
        field = f"line {number}"
        values = numbers(path, field, words[1:], (21,))
        K, R = values[:9].reshape(3, 3), rotation(path, field, values[9:18])
        K = intrinsics(K[0, 0], K[1, 1], K[0, 2] + HALF, K[1, 2] + HALF, K[0, 1])
        add(path, cameras, make_camera(path, Path(words[0]).stem, (0, 0), K, np.zeros(5), rigid(R, values[18:])))
    return cameras
