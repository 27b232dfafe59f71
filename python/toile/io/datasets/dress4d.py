"""4D-DRESS: a take, `SUBJECT/Inner|Outer/TAKE/`.

Taken: `Meshes_pkl/mesh-f00001.pkl` (vertices, faces [m]) with `Semantic/labels/label-f00001.pkl` (`scan_labels`, a vertex) as
labelled scans; `Capture/cameras.pkl` (K and world to camera 3x4, pixel centres at whole numbers as OpenCV's) with
`Capture/ID/images/capture-f00001.png` and `masks/mask-f00001.png`. Labels are moved up by one: 0 is the background here.

Left: `atlas-*.pkl`, colours, normals, `SMPL*`, `Capture/ID/labels` (pictures of the scans' labels), extracted clothes,
`rotation` and `offset` of `basic_info.pkl`. Its y is up, its rate 30 frames a second.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import UserError
from ...scene import Camera, Mesh
from ..calibration.checked import HALF, intrinsics, make_camera, numbers, rigid, rotation
from ..importing import Found, Source
from ..mesh import check_mesh, face_labels_of, write_mesh
from ..pickles import plain, read_pickle
from .upright import upright

LABELS = {"skin": 1, "hair": 2, "shoe": 3, "upper": 4, "lower": 5, "outer": 6}
FPS = 30.0


def read(source: Path, up: str = "") -> Found:
    """A take as a capture. UserError names the file and the field."""
    cameras = _cameras(source / "Capture" / "cameras.pkl")
    cameras, axis, turn, note = upright(source, cameras, up or "y")
    frames: dict[int, dict[str, Source]] = {}
    for path in sorted((source / "Meshes_pkl").glob("mesh-f*.pkl")):
        number = _number(path)
        labels = source / "Semantic" / "labels" / f"label-{path.stem.removeprefix('mesh-')}.pkl"
        frames.setdefault(number, {})["scan.ply"] = _scan(path, labels, turn)
    for camera in cameras:
        for kind, word in (("images", "capture"), ("masks", "mask")):
            for path in sorted((source / "Capture" / camera / kind).glob(f"{word}-f*.png")):
                frames.setdefault(_number(path), {})[f"{kind}/{camera}.png"] = path
    if not frames:
        raise UserError(f"{source}: neither Meshes_pkl/mesh-f*.pkl nor Capture/*/images: not a take of 4D-DRESS")
    labelled = any((source / "Semantic" / "labels").glob("label-f*.pkl"))
    notes = (note, "left: textures, SMPL fits, label pictures, extracted clothes")
    return Found(cameras, dict(sorted(frames.items())), axis, FPS, LABELS if labelled else {}, notes=notes)


def _number(path: Path) -> int:
    match = re.search(r"-f(\d{1,6})$", path.stem)
    if not match:
        raise UserError(f"{path}: expected a name that ends in -f and the frame's number")
    return int(match[1])


def _cameras(path: Path) -> dict[str, Camera]:
    if not path.exists():
        return {}
    cameras: dict[str, Camera] = {}
    for name, fields in read_pickle(path, dict).items():
        if not isinstance(fields, dict) or not {"intrinsics", "extrinsics"} <= set(fields):
            raise UserError(f"{path}: {name}: expected intrinsics and extrinsics")
        K = numbers(path, f"{name}.intrinsics", plain(path, f"{name}.intrinsics", fields["intrinsics"]), (3, 3))
        T = numbers(path, f"{name}.extrinsics", plain(path, f"{name}.extrinsics", fields["extrinsics"]), (3, 4), (4, 4))
        K = intrinsics(K[0, 0], K[1, 1], K[0, 2] + HALF, K[1, 2] + HALF, K[0, 1])
        pose = rigid(rotation(path, f"{name}.extrinsics", T[:3, :3]), T[:3, 3])
        cameras[str(name)] = make_camera(path, str(name), (0, 0), K, np.zeros(5), pose)
    return cameras


def _scan(path: Path, labels: Path, turn: Any) -> Source:
    def write(out: Path) -> None:
        fields = read_pickle(path, dict)
        for name in ("vertices", "faces"):
            if name not in fields:
                raise UserError(f"{path}: {name} is missing")
        V = numbers(path, "vertices", plain(path, "vertices", fields["vertices"]), (_rows(fields["vertices"]), 3))
        F = plain(path, "faces", fields["faces"])
        if F.ndim != 2 or F.shape[1] != 3 or F.dtype.kind not in "iu":
            raise UserError(f"{path}: faces: {F.dtype} {F.shape}, expected whole numbers (m, 3)")
        mesh = check_mesh(path, Mesh(V @ turn.T, F.astype(np.int32)))
        write_mesh(out, Mesh(mesh.vertices, mesh.faces, face_labels=_labels(labels, mesh)))

    return write


def _rows(value: Any) -> int:
    return len(value) if hasattr(value, "__len__") else 0


def _labels(path: Path, mesh: Mesh) -> Any:
    if not path.exists():
        return None
    ids = plain(path, "scan_labels", read_pickle(path, dict).get("scan_labels", ())).ravel()
    if len(ids) != len(mesh.vertices) or ids.min(initial=0) < 0 or ids.max(initial=0) >= len(LABELS):
        raise UserError(
            f"{path}: scan_labels: expected {len(mesh.vertices)} labels of 0 to {len(LABELS) - 1}, one a vertex"
        )
    return face_labels_of(ids.astype(np.uint8) + 1, mesh.faces)
