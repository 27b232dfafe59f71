"""MVHumanNet: an outfit's folder.

Taken: `camera_intrinsics.json` (one K for all, pixel centres at whole numbers, of the full picture), `camera_extrinsics.json`
({"1_CAMERA.png": {rotation, translation}}, world to camera, millimetres), `camera_scale.pkl` (a factor of translations),
`images/CAMERA/0005_img.jpg` at half the size, `fmask/CAMERA/0005_img_fmask.png`.

Left: `annots`, `openpose` (of which size is not said), `smpl_param`, `smplx`. Every fifth frame of films is there, under its number
in the film: 0005, 0010, ... Films have 25 frames a second, some 30 (https://github.com/GAP-LAB-CUHK-SZ/MVHumanNet/issues/15).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import UserError
from ...scene import Camera
from ..bounded import read_json
from ..calibration.checked import HALF, add, intrinsics, make_camera, numbers, rigid, rotation
from ..image import image_header
from ..importing import Found, Source
from ..pickles import plain, read_pickle
from ..places import placed
from .upright import upright

FPS = 25.0  # of the films, which frames are numbered by
SHARES = (1.0, 0.5, 0.25)  # of the full size that pictures may have


def read(source: Path, up: str = "") -> Found:
    """An outfit as a capture. UserError names the file and the field."""
    cameras, axis, _, note = upright(source, _cameras(source), up)
    frames: dict[int, dict[str, Source]] = {}
    for folder, kind in (("images", "images"), ("images_lr", "images"), ("fmask", "masks"), ("fmask_lr", "masks")):
        if (source / folder).is_dir():
            for number, files in placed(source / folder, kind, cameras).files.items():
                for camera, path in files.items():
                    end = ".png" if kind == "masks" or path.suffix.lower() == ".png" else ".jpg"
                    frames.setdefault(number, {})[f"{kind}/{camera}{end}"] = path
    pictured = {}
    for name, camera in cameras.items():
        pictures = (files.get(f"images/{name}{end}") for files in frames.values() for end in (".jpg", ".png"))
        first = next((path for path in pictures if isinstance(path, Path)), None)
        if first is not None:
            pictured[name] = _sized(first, camera)
    notes = (note, f"left: {len(cameras) - len(pictured)} cameras without pictures, annots, openpose, SMPL fits")
    return Found(pictured, dict(sorted(frames.items())), axis, FPS, notes=notes)


def _cameras(source: Path) -> dict[str, Camera]:
    path = source / "camera_intrinsics.json"
    lens = read_json(path, dict)
    K = numbers(path, "intrinsics", lens.get("intrinsics"), (3, 3))
    K = intrinsics(K[0, 0], K[1, 1], K[0, 2] + HALF, K[1, 2] + HALF)
    bend = numbers(path, "dist", lens.get("dist") or [0.0] * 5, (np.size(lens.get("dist") or [0.0] * 5),))
    file = source / "camera_scale.pkl"
    scale = numbers(file, "the scale", plain(file, "the scale", read_pickle(file)), (1,))[0]
    path = source / "camera_extrinsics.json"
    cameras: dict[str, Camera] = {}
    for key, fields in read_json(path, dict).items():
        if not isinstance(fields, dict) or not {"rotation", "translation"} <= set(fields):
            raise UserError(f"{path}: {key}: expected rotation and translation")
        R = rotation(path, f"{key}.rotation", fields["rotation"])
        t = scale * numbers(path, f"{key}.translation", fields["translation"], (3,)) / 1000
        name = Path(key).stem.split("_")[-1]
        add(path, cameras, make_camera(path, name, (0, 0), K, bend, rigid(R, t)))
    return cameras


def _sized(first: Path, camera: Camera) -> Camera:
    """The camera of pictures that are a share of the full size, whose middle is about the principal point."""
    (height, width), _ = image_header(first)
    middle = 2 * camera.K[:2, 2]
    share = min(SHARES, key=lambda s: abs(np.log(width / (s * middle[0]))) + abs(np.log(height / (s * middle[1]))))
    K = np.diag([share, share, 1.0]) @ camera.K  # edges stay edges: pixel centres are at halves here
    return replace(camera, width=width, height=height, K=K)
