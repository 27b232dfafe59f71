"""DNA-Rendering: `NAME.smc` with the annotations `NAME_annots.smc` (HDF5, read by h5py: `pip install 'toile[import]'`).

Taken: `Camera_5mp|Camera_12mp/ID/color/FRAME` (encoded pictures, kept as they are), `Mask/ID/mask/FRAME`,
`Camera_Parameter/ID/{K, D, RT}` (RT is camera to world; D k1 k2 p1 p2 k3 stays in the capture, pixel centres at whole numbers
as OpenCV's), `Keypoints_2D/ID` (COCO-WholeBody, 133).

Left: `Color_Calibration`, `Keypoints_3D`, `SMPLx`, Kinects, the actor's attributes. 15 frames a second.
"""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import UserError
from ...kernels.arrays import Anything
from ...scene import Camera
from ..bounded import check_file, reason_of
from ..calibration.checked import HALF, add, intrinsics, inverse, make_camera, numbers, rigid, rotation
from ..image import FORMATS
from ..importing import Found, Source, text_of
from ..rig import keypoints_json
from ..skeletons import SKELETONS
from .upright import upright

FPS = 15.0
GROUPS = ("Camera_5mp", "Camera_12mp")
BYTES = 1 << 30  # of one array
SKELETON = "coco_wholebody133"


def read(source: Path, up: str = "") -> Found:
    """A performance as a capture. UserError names the file and the array."""
    main, annotations = _pair(source)
    file, notes = _Arrays(main), _Arrays(annotations)
    cameras, axis, _, note = upright(annotations, _cameras(notes), up)
    frames: dict[int, dict[str, Source]] = {}
    pictured = {}
    for group in GROUPS:
        for name in file.names(group):
            camera = f"{int(name):02d}" if name.isdecimal() else name
            if camera not in cameras:
                raise UserError(f"{main}: {group}/{name}: no Camera_Parameter/{camera} in {annotations.name}")
            for frame in file.names(f"{group}/{name}/color"):
                found = frames.setdefault(_number(main, frame), {})
                found[f"images/{camera}.jpg"] = _encoded(file, f"{group}/{name}/color/{frame}")
            for frame in notes.names(f"Mask/{name}/mask"):
                if _number(annotations, frame) in frames:
                    found = frames[_number(annotations, frame)]
                    found[f"masks/{camera}.png"] = _encoded(notes, f"Mask/{name}/mask/{frame}")
            height, width = _size(file, f"{group}/{name}/color")
            pictured[camera] = replace(cameras[camera], height=height, width=width)
    _add_keypoints(notes, frames, pictured)
    left = "left: colour calibration, 3D keypoints, SMPL-X, Kinects"
    return Found(pictured, dict(sorted(frames.items())), axis, FPS, notes=(note, left))


def _pair(source: Path) -> tuple[Path, Path]:
    """The main file and its annotations; `source` is either or their folder."""
    if source.is_dir():
        mains = sorted(path for path in source.rglob("*.smc") if not path.stem.endswith("_annots"))
        if len(mains) != 1:
            raise UserError(f"{source}: {len(mains)} files NAME.smc in it: name one")
        source = mains[0]
    main = source.with_name(source.name.replace("_annots.smc", ".smc"))
    name = f"{main.stem}_annots.smc"
    beside = (main.with_name(name), *(main.parent.parent / folder / name for folder in ("annotations", "annots")))
    found = next((path for path in beside if path.is_file()), None)
    if found is None:
        raise UserError(f"{main}: no {name} beside it, which has the calibration")
    return main, found


class _Arrays:
    """Arrays of an HDF5 file that lie in it: links out of it, external and virtual ones are refused."""

    def __init__(self, path: Path) -> None:
        try:
            import h5py
        except ImportError:
            raise UserError(f"{path}: reading .smc files needs h5py: pip install 'toile[import]'") from None
        self.path, self.h5py = check_file(path), h5py
        try:
            self.file = h5py.File(path, "r")
        except OSError as error:
            raise UserError(f"{path}: not an HDF5 file: {reason_of(error)}") from None

    def at(self, name: str) -> Any:
        """The group or array of this name, None where there is none."""
        item = self.file
        for part in name.split("/"):
            if not isinstance(item, self.h5py.Group) or part not in item:
                return None
            if not isinstance(item.get(part, getlink=True), self.h5py.HardLink):
                raise UserError(f"{self.path}: {name}: a link that leaves its place")
            item = item[part]
        return item

    def names(self, name: str) -> list[str]:
        """What a group holds, [] where it is not there."""
        group = self.at(name)
        return sorted(group) if isinstance(group, self.h5py.Group) else []

    def array(self, name: str) -> Anything:
        """An array's numbers."""
        found = self.at(name)
        if not isinstance(found, self.h5py.Dataset):
            raise UserError(f"{self.path}: {name} is missing")
        if found.external or found.is_virtual:
            raise UserError(f"{self.path}: {name}: its numbers lie in other files")
        if found.nbytes > BYTES or found.dtype.kind not in "fiub":
            raise UserError(
                f"{self.path}: {name}: {found.dtype} of {found.nbytes} bytes, expected numbers, at most {BYTES}"
            )
        try:
            return found[()]
        except OSError as error:
            raise UserError(f"{self.path}: {name}: cannot be read: {reason_of(error)}") from None


def _cameras(file: _Arrays) -> dict[str, Camera]:
    cameras: dict[str, Camera] = {}
    for name in file.names("Camera_Parameter"):
        place = f"Camera_Parameter/{name}"
        K = numbers(file.path, f"{place}/K", file.array(f"{place}/K"), (3, 3))
        RT = numbers(file.path, f"{place}/RT", file.array(f"{place}/RT"), (4, 4), (3, 4))
        K = intrinsics(K[0, 0], K[1, 1], K[0, 2] + HALF, K[1, 2] + HALF, K[0, 1])
        pose = inverse(rigid(rotation(file.path, f"{place}/RT", RT[:3, :3]), RT[:3, 3]))
        bend = np.ravel(file.array(f"{place}/D"))
        add(file.path, cameras, make_camera(file.path, name, (0, 0), K, bend, pose))
    if not cameras:
        raise UserError(f"{file.path}: Camera_Parameter is missing")
    return cameras


def _number(path: Path, name: str) -> int:
    if not (name.isdecimal() and len(name) < 7):
        raise UserError(f"{path}: a frame called {name!r}")
    return int(name)


def _bytes(file: _Arrays, name: str) -> bytes:
    array = file.array(name)
    if array.dtype != np.uint8:
        raise UserError(f"{file.path}: {name}: {array.dtype}, expected the bytes of a picture")
    return array.tobytes()


def _encoded(file: _Arrays, name: str) -> Source:
    return lambda path: path.write_bytes(_bytes(file, name))


def _size(file: _Arrays, group: str) -> tuple[int, int]:
    """(height, width) of the first picture of a group, from its header."""
    from PIL import Image

    names = file.names(group)
    if not names:
        raise UserError(f"{file.path}: {group} holds no picture")
    try:
        with Image.open(io.BytesIO(_bytes(file, f"{group}/{names[0]}")), formats=FORMATS) as image:
            return image.size[1], image.size[0]
    except UserError:
        raise
    except Exception as error:
        raise UserError(f"{file.path}: {group}/{names[0]}: cannot be read as a picture: {reason_of(error)}") from None


def _add_keypoints(file: _Arrays, frames: dict[int, dict[str, Source]], cameras: dict[str, Camera]) -> None:
    names = SKELETONS[SKELETON]
    points = {
        camera: file.array(f"Keypoints_2D/{camera}") for camera in file.names("Keypoints_2D") if camera in cameras
    }
    for camera, array in points.items():
        if array.ndim != 3 or array.shape[1:] != (len(names), 3):
            raise UserError(f"{file.path}: Keypoints_2D/{camera}: {array.shape}, expected (frames, {len(names)}, 3)")
    for number, found in frames.items():
        people = {c: _person(array[number]) for c, array in points.items() if number < len(array)}
        if people:
            found["keypoints.json"] = text_of(keypoints_json(people))


def _person(rows: Anything) -> dict[str, Any]:
    seen = np.isfinite(rows).all(1) & (rows[:, 2] > 0)
    shift = np.array([HALF, HALF, 0])
    return {name: row + shift for name, row, there in zip(SKELETONS[SKELETON], rows, seen) if name and there}
