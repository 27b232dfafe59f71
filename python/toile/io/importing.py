"""What a reader of others' data found becomes a capture: whole or not at all, pictures linked where links do."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError
from ..frame_numbers import frame_ranges
from ..kernels.arrays import Anything, Floats
from ..scene import Camera
from .calibration.checked import few
from .calibration.lenses import Bent
from .files import whole_folder
from .films import decoded, film_size
from .flattening import Flattening, flatten_keypoints
from .image import check_labels, image_header, one_channel, write_image
from .mesh import read_mesh, write_mesh

Source = Path | Callable[[Path], Any]  # a file to be linked, or what writes it under a path
CLEAR = 0.85  # cosine between the cameras' mean up direction and an axis, above which that axis is up
AXES = ("x", "y", "z")
MANY = 4  # runs of frame numbers in a message


@dataclass(frozen=True)
class Found:
    """A capture that is not yet written: `frames[number]` {path in the frame's folder: where it comes from}, metres."""

    cameras: dict[str, Camera]
    frames: dict[int, dict[str, Source]]
    up: str = "z"
    fps: float = 30.0
    labels: dict[str, int] = field(default_factory=dict)
    films: dict[str, tuple[Path, int]] = field(default_factory=dict)  # camera: film, its picture of frame 0
    cropped: bool = False  # pictures may be smaller than the calibration says
    scaled: bool = False  # pictures may be the calibration's by another factor each
    notes: tuple[str, ...] = ()  # what was taken, turned, left: said, and kept in scene.toml


def write_capture(found: Found, out: Path, head: str, copy: bool = False) -> Found:
    """Writes `found` as the capture folder `out`, which must not be there or be empty; every picture's header is checked
    against its camera. Gives back what was written. An error leaves nothing behind."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise UserError(f"{out}: is there already")
    if not found.frames:
        raise UserError(f"{head}: no frame with pictures, keypoints or a scan")
    cameras = _sized(found)
    found = replace(found, cameras=cameras, notes=(*found.notes, *_scaled_cameras(found, cameras)))
    flat = {name: Flattening(camera) for name, camera in found.cameras.items() if isinstance(camera, Bent)}
    pinholes = {name: flattening.camera for name, flattening in flat.items()}
    with whole_folder(out) as part:
        for number in sorted(found.frames):
            _write_frame(part / "frames" / f"{number:06d}", found.frames[number], found.cameras, flat, copy)
        said = [note for camera in found.films if (note := _write_film(part / "frames", found, camera, flat))]
        said += _sizes_said(found.cameras, pinholes) + _flattened_keypoints(part / "frames", flat)
        found = replace(found, cameras=found.cameras | pinholes, notes=(*found.notes, *said))
        (part / "scene.toml").write_text(_scene(found, out.resolve().name, head), encoding="utf-8")
        (part / "cameras.json").write_text(cameras_json(found.cameras), encoding="utf-8")
    return found


def _sizes_said(before: Mapping[str, Camera], pinholes: Mapping[str, Camera]) -> list[str]:
    size = lambda camera: f"{camera.width} x {camera.height}"
    each = few(f"{name} from {size(before[name])} pixels to {size(camera)}" for name, camera in pinholes.items())
    return [f"undistorted: {len(pinholes)} cameras: {each}"] if pinholes else []


def _flattened_keypoints(frames: Path, flat: Mapping[str, Flattening]) -> list[str]:
    """Moves the keypoints of all frames to the pinhole cameras' pictures; says how many of these lie in none."""
    lost = sum(flatten_keypoints(path, flat) for path in sorted(frames.glob("*/keypoints.json"))) if flat else 0
    return [f"undistorted: {lost} keypoints lie beyond the new pictures and are unseen now"] if lost else []


def _write_film(frames: Path, found: Found, camera: str, flat: Mapping[str, Flattening]) -> str:
    """A film's pictures of all frames; what is to be said of those that it lacks, "" where it has all."""
    film, first = found.films[camera]
    left = set(found.frames)
    for index, picture in decoded(film, [number + first for number in found.frames]):
        _check_size(film, picture.shape[:2], found.cameras[camera])
        picture = flat[camera].resampled(picture, "images") if camera in flat else picture
        write_image(frames / f"{index - first:06d}" / "images" / f"{camera}.jpg", picture)
        left.remove(index - first)
    return f"{film.name}: no pictures of {len(left)} frames: {frame_ranges(sorted(left), MANY)}" if left else ""


def _write_frame(
    folder: Path, sources: dict[str, Source], cameras: dict[str, Camera], flat: Mapping[str, Flattening], copy: bool
) -> None:
    folder.mkdir(parents=True)
    for name, source in sources.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if isinstance(source, Path):
            link(source, path, copy)
        else:
            source(path)
        kind, camera = path.parent.name, cameras.get(path.stem)
        if kind in ("images", "masks", "labels") and camera is not None:
            where = source if isinstance(source, Path) else Path(folder.name) / name
            written = source if isinstance(source, Path) else path
            size, mode = image_header(written)
            _check_size(where, size, camera, kind)
            if kind == "labels":
                check_labels(written)
            if camera.name in flat:  # written anew, as a link is: what it points to stays
                write_image(path, flat[camera.name].read(written, kind))
            elif kind == "masks" and mode not in ("L", "1"):
                write_image(path, one_channel(path))


def _check_size(path: Path, size: tuple[int, ...], camera: Camera, kind: str = "images") -> None:
    if tuple(size) == camera.size:
        return
    if kind != "images":
        expected = f"expected {camera.width} x {camera.height}, as camera '{camera.name}' has"
        raise UserError(f"{path}: {size[1]} x {size[0]} pixels, {expected}")
    scaled = "were they scaled since: --scaled" if _same_shape(size, camera) else "scaled they were not by one factor"
    raise UserError(
        f"{path}: {size[1]} x {size[0]} pixels, the calibration of camera '{camera.name}' is for "
        f"{camera.width} x {camera.height} (were they cut at the right or below: --cropped; {scaled})"
    )


def _same_shape(size: tuple[int, ...], camera: Camera) -> bool:
    """Whether both sides of a picture have one ratio to the calibration's, within half a pixel."""
    height, width = size
    return (
        abs(height - camera.height * width / camera.width) <= 0.5
        or abs(width - camera.width * height / camera.height) <= 0.5
    )


def link(source: Path, path: Path, copy: bool) -> None:
    """A hard link, where that cannot be a symbolic one; or a copy."""
    if copy:
        shutil.copyfile(source, path)
        return
    try:
        os.link(os.path.realpath(source), path)
    except OSError:
        path.symlink_to(os.path.realpath(source))


def _sized(found: Found) -> dict[str, Camera]:
    """The cameras with the sizes that their first pictures have, where the calibration says none; with `cropped` also
    where it says more, which were cut off at the right and below; with `scaled` also where it says others of the same shape."""
    cameras = {}
    for name, camera in found.cameras.items():
        size = _picture_size(found, name) or camera.size
        if not any(size):
            continue  # nothing is known of it and nothing was taken by it
        if not camera.width or found.cropped:
            if camera.width and (size[0] > camera.height or size[1] > camera.width):
                _check_size(Path(f"camera '{name}'"), size, camera)
            camera = replace(camera, width=size[1], height=size[0])
        elif found.scaled and size != camera.size:
            camera = _scaled(camera, size)
        cameras[name] = camera
    return cameras


def _picture_size(found: Found, camera: str) -> tuple[int, ...] | None:
    """Height and width of a camera's first picture, None where it has none."""
    endings = (".jpg", ".png")
    pictures = (sources.get(f"images/{camera}{end}") for sources in found.frames.values() for end in endings)
    first = next((path for path in pictures if isinstance(path, Path)), None)
    if first is not None:
        return image_header(first)[0]
    return film_size(found.films[camera][0]) if camera in found.films else None


def _scaled_cameras(found: Found, cameras: dict[str, Camera]) -> list[str]:
    """A line that says which cameras were scaled to their pictures, with `scaled`; none where none was."""
    before = {name: found.cameras[name] for name in cameras if found.scaled and found.cameras[name].width}
    each = [
        f"{name} from {before[name].width} x {before[name].height} to {cameras[name].width} x {cameras[name].height}"
        for name in before
        if before[name].size != cameras[name].size
    ]
    return [f"calibration scaled to the pictures: {few(each)}"] if each else []


def _scaled(camera: Camera, size: tuple[int, ...]) -> Camera:
    """The camera for pictures of another size (height, width): K, whose pixel centres are at halves, times the ratio of the sides.
    Its distortion bends directions, which stay."""
    height, width = size
    if not _same_shape(size, camera):
        _check_size(Path(f"camera '{camera.name}'"), size, camera)
    K = np.diag([width / camera.width, height / camera.height, 1.0]) @ camera.K
    return replace(camera, width=width, height=height, K=K)


def _scene(found: Found, name: str, head: str) -> str:
    import tomli_w

    table: dict[str, Any] = {"scene": {"name": name, "fps": found.fps, "units": "m", "up": found.up}}
    if found.labels:
        table["labels"] = found.labels
    notes = [f"made by toile import from {head}", *found.notes]
    return "".join(f"# {' '.join(note.split())}\n" for note in notes) + "\n" + tomli_w.dumps(table)


def cameras_json(cameras: dict[str, Camera]) -> str:
    """The text of cameras.json."""
    entries = [
        {
            "name": c.name, "width": c.width, "height": c.height, "K": np.asarray(c.K).tolist(),
            "distortion": np.asarray(c.distortion).tolist(), "T_camera_world": np.asarray(c.T_camera_world).tolist(),
        }
        for c in cameras.values()
    ]  # fmt: skip
    return json.dumps({"cameras": entries}, indent=1) + "\n"


def moved(cameras: dict[str, Camera], metres: float, turn: Anything) -> dict[str, Camera]:
    """The cameras in metres, in a world turned by `turn` (3,3)."""
    cameras_moved = {}
    for name, camera in cameras.items():
        T = np.array(camera.T_camera_world)
        T[:3, :3], T[:3, 3] = T[:3, :3] @ turn.T, metres * T[:3, 3]
        cameras_moved[name] = replace(camera, T_camera_world=T)
    return cameras_moved


def text_of(text: str) -> Source:
    """A file of this text."""
    return lambda path: path.write_text(text, encoding="utf-8")


def moved_scan(path: Path, metres: float, turn: Anything) -> Source:
    """A scan in metres, turned: the file itself where nothing changes and it is a PLY."""
    if metres == 1 and np.array_equal(turn, np.eye(3)) and path.suffix.lower() == ".ply":
        return path

    def write(out: Path) -> None:
        mesh = read_mesh(path)
        write_mesh(out, replace(mesh, vertices=metres * mesh.vertices @ turn.T, uv=None, face_uv=None))

    return write


def up_of(cameras: Iterable[Camera]) -> str:
    """The axis ("x", ..., "-z") that the cameras' pictures hold up, on average; "" if that is no axis."""
    up = np.sum([-camera.T_camera_world[1, :3] for camera in cameras], axis=0)
    length = float(np.linalg.norm(up))
    axis = int(np.abs(up).argmax())
    if length == 0 or abs(up[axis]) < CLEAR * length:
        return ""
    return ("-" if up[axis] < 0 else "") + AXES[axis]


def turned_up(up: str) -> tuple[str, Floats]:
    """An axis that a scene may have up, and the half turn (3,3) that takes `up` there; none for "x", "y", "z"."""
    if up in AXES:
        return up, np.eye(3)
    if up[:1] != "-" or up[1:] not in AXES:
        raise UserError(f"--up {up}: expected x, y, z, -x, -y or -z")
    return up[1:], np.diag([-1.0, -1, 1] if up == "-x" else [1.0, -1, -1])
