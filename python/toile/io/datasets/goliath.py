"""Goliath, body captures: `s--DATE--...--ClothedBody/`.

Taken: `camera_calibration.json` (`KRT`: K and T are stored transposed; world to camera, millimetres, pixel centres at whole
numbers, of the full 2668 x 4096), `image/camID.zip` (AVIF at half the size: c' = (c + 0.5) / 2 - 0.5), decoded to JPEG;
`segmentation_parts/camID.zip` (PNG, 0 the background) as labels part_1, part_2, ... and masks; `scan_mesh/scan_mesh.zip`.

Left: `keypoints_3d`, `kinematic_tracking`, `uv_image`, splits, `floor_transformation.txt`. 30 frames a second.
"""

from __future__ import annotations

import io
import re
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import UserError
from ...scene import Camera
from ..bounded import read_json, reason_of
from ..calibration.checked import HALF, add, intrinsics, make_camera, numbers, rigid, rotation
from ..image import MAX_PIXELS, write_image
from ..importing import Found, Source, moved, moved_scan
from ..zips import Zip
from .upright import upright

FPS, HALVED, METRES = 30.0, 2, 0.001
PARTS = 63  # labels that may occur


def read(source: Path, up: str = "") -> Found:
    """A capture as a capture. UserError names the file and the field."""
    cameras = moved(_cameras(source / "camera_calibration.json"), METRES, np.eye(3))
    images = {name: Zip(path) for name in cameras for path in [source / "image" / f"cam{name}.zip"] if path.exists()}
    if not images:
        raise UserError(f"{source / 'image'}: no camID.zip of a camera of camera_calibration.json")
    cameras, axis, turn, note = upright(source, {name: cameras[name] for name in images}, up)
    frames: dict[int, dict[str, Source]] = {}
    sized = {}
    for name, archive in images.items():
        members = _members(archive, "avif")
        for number, member in members.items():
            frames.setdefault(number, {})[f"images/{name}.jpg"] = _picture(archive, member)
        if members:
            size = _decoded(archive, min(members.values()), False)
            sized[name] = replace(cameras[name], height=size[0], width=size[1])
    labelled = _add_parts(source, frames, sized)
    scans = source / "scan_mesh" / "scan_mesh.zip"
    if scans.exists():
        archive = Zip(scans)
        for number, member in _members(archive, "ply").items():
            frames.setdefault(number, {})["scan.ply"] = _scan(archive, member, turn)
    labels = {f"part_{i}": i for i in range(1, PARTS + 1)} if labelled else {}
    notes = (note, "left: 3D keypoints, kinematic tracking, UV pictures; AVIF pictures became JPEG")
    return Found(sized, dict(sorted(frames.items())), axis, FPS, labels, notes=notes)


def _cameras(path: Path) -> dict[str, Camera]:
    cameras: dict[str, Camera] = {}
    for i, fields in enumerate(read_json(path, dict).get("KRT") or []):
        if not isinstance(fields, dict) or not {"cameraId", "K", "T"} <= set(fields):
            raise UserError(f"{path}: KRT.{i}: expected cameraId, K, T")
        K = numbers(path, f"KRT.{i}.K", fields["K"], (3, 3)).T
        T = numbers(path, f"KRT.{i}.T", fields["T"], (4, 4), (4, 3)).T
        (fx, fy), (cx, cy) = K[[0, 1], [0, 1]] / HALVED, (K[:2, 2] + HALF) / HALVED
        K = intrinsics(fx, fy, cx, cy, K[0, 1] / HALVED)
        pose = rigid(rotation(path, f"KRT.{i}.T", T[:3, :3]), T[:3, 3])
        add(path, cameras, make_camera(path, str(fields["cameraId"]), (0, 0), K, np.zeros(5), pose))
    return cameras


def _members(archive: Zip, ending: str) -> dict[int, str]:
    """{frame: member} of names that end in six digits and the ending."""
    found = ((re.search(rf"(?:^|/)(\d{{6}})\.{ending}$", name), name) for name in archive.members)
    return {int(match[1]): name for match, name in found if match}


def _decoded(archive: Zip, member: str, pixels: bool = True) -> Any:
    """(H,W,3) or (H,W) uint8, or without `pixels` only (height, width) from the header."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(archive.read(member)), formats=("AVIF", "PNG")) as image:
            width, height = image.size
            if width * height > MAX_PIXELS:
                raise UserError(f"{archive.path}: {member}: {width} x {height} pixels, at most {MAX_PIXELS} are read")
            if not pixels:
                return height, width
            return np.array(image if image.mode in ("L", "P", "1") else image.convert("RGB"))
    except UserError:
        raise
    except Exception as error:
        raise UserError(f"{archive.path}: {member}: cannot be read as a picture: {reason_of(error)}") from None


def _picture(archive: Zip, member: str) -> Source:
    return lambda path: write_image(path, _decoded(archive, member))


def _add_parts(source: Path, frames: dict[int, dict[str, Source]], cameras: dict[str, Camera]) -> bool:
    """Adds labels and masks; whether there are any."""
    found = False
    for name in cameras:
        path = source / "segmentation_parts" / f"cam{name}.zip"
        if not path.exists():
            continue
        archive = Zip(path)
        for number, member in _members(archive, "png").items():
            if number in frames:
                frames[number][f"labels/{name}.png"] = _parts(archive, member, False)
                frames[number][f"masks/{name}.png"] = _parts(archive, member, True)
                found = True
    return found


def _parts(archive: Zip, member: str, mask: bool) -> Source:
    def write(path: Path) -> None:
        parts = _decoded(archive, member)
        if parts.ndim != 2 or parts.max(initial=0) > PARTS:
            raise UserError(f"{archive.path}: {member}: expected one channel of labels 0 to {PARTS}")
        write_image(path, np.where(parts > 0, 255, 0).astype(np.uint8) if mask else parts.astype(np.uint8))

    return write


def _scan(archive: Zip, member: str, turn: Any) -> Source:
    def write(out: Path) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / Path(member).name
            path.write_bytes(archive.read(member))
            scan = moved_scan(path, METRES, turn)
            assert not isinstance(scan, Path)  # millimetres: it is written anew
            scan(out)

    return write
