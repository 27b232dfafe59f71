"""A capture on disk: scene.toml, cameras.json, templates/ and frames/, validated when opened, frames read when asked."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError, first_line
from ..kernels.arrays import Anything
from ..scene import Camera, Frame, Garment, Mesh, Scene, Vote
from .body import model_in_capture
from .camera import read_cameras
from .image import check_image, read_image
from .keypoints import read_keypoints, read_keypoints3d
from .mesh import read_mesh
from .scene_file import METRES, SEGMENTERS, inside, network_files, read_scene
from .template import lost_material, read_template, texture_files
from .votes import read_votes

HEIGHT = (0.3, 3.0)  # of a scanned person [m]; outside, the units are wrong
VOTES = "votes.json"
MODES = {"labels": "P", "masks": "L", "images": "RGB"}  # of a frame's pictures, as `read_image` calls them
KINDS = ("images", "masks", "labels")  # folders that a frame may have
ALONE = ("scan.ply", "keypoints.json", "keypoints3d.json")  # files that a frame may have
LITTER = ("thumbs.db", "ehthumbs.db", "desktop.ini", "@eadir", "__macosx")  # left by systems, besides hidden files
CHECKED = 3  # frames that are read before a run begins


@dataclass(frozen=True)
class Capture:
    """An opened capture; everything it gives is in metres."""

    root: Path
    scene: Scene
    cameras: dict[str, Camera]
    frames: tuple[int, ...]
    templates: dict[str, Mesh]  # of the garments that name one; cleaned, see io/template.py
    kept: dict[str, np.ndarray]  # of each template, the vertices of its file that it has (g,)
    files: tuple[Path, ...] = ()  # that the scene is made of
    warnings: tuple[str, ...] = ()
    textures: dict[str, Path] = field(default_factory=dict)  # pictures of printed garments whose template names one
    votes: tuple[Vote, ...] = ()
    made: Path | None = None  # where a run keeps what it makes of frames, a folder a frame: scans of their pictures
    left_out: tuple[str, ...] = ()  # cameras whose files are passed over

    def frame(self, number: int, thin: Callable[[Any], Any] = lambda picture: picture) -> Frame:
        """Reads one frame, see `pictures`. UserError names the file and the field."""
        scan, keypoints, points3d = self.scan(number), self.keypoints(number), self.points3d(number)
        return replace(self.pictures(number, thin), scan=scan, keypoints=keypoints, points3d=points3d)

    def scan(self, number: int) -> Mesh | None:
        """The scan of a frame, None where it has none."""
        path = self._own_or_made(self.folder(number), "scan.ply")
        if not os.path.lexists(path):
            return None
        scan = _scaled(read_mesh(path), METRES[self.scene.units])
        self._check_height(path, scan)
        if scan.face_labels is not None:
            self._check_ids(path, scan.face_labels)
        if scan.confidence is not None and not scan.confidence.any():
            raise UserError(f"{path}: confidence: 0 at every vertex, so that nothing of the scan counts")
        return scan

    def keypoints(self, number: int) -> Any:
        """The keypoints of a frame's pictures, None where it has none."""
        path = self.folder(number) / "keypoints.json"
        return read_keypoints(path, self.cameras, self.left_out) if os.path.lexists(path) else None

    def points3d(self, number: int) -> Any:
        """The keypoints of a frame in space, None where it has none."""
        path = self._own_or_made(self.folder(number), "keypoints3d.json")
        return read_keypoints3d(path) if os.path.lexists(path) else None

    def pictures(self, number: int, thin: Callable[[Any], Any] = lambda picture: picture) -> Any:
        """Reads images, masks and labels of one frame, and nothing else of it. Each is given to `thin` once it is read, so
        that no two are held whole."""

        def read(kind: str, give: Callable[[Any], Any] = lambda picture: picture) -> dict[str, Any]:
            files = self.picture_files(number, kind).items()
            return {name: thin(give(self.picture(kind, name, path))) for name, path in files}

        labels, masks = read("labels"), read("masks", lambda mask: mask > 127)
        return Frame(number, None, None, read("images"), masks, labels)

    def picture_files(self, number: int, kind: str) -> dict[str, Path]:
        """{camera: path} of a frame's images, masks or labels, for the cameras that have them, in their order."""
        return self._files(self.folder(number) / kind)

    def picture(self, kind: str, camera: str, path: Path) -> Anything:
        """One of a camera's images (h,w,3), masks or labels (h,w), uint8."""
        image = read_image(path, self.cameras[camera].size, MODES[kind])
        if kind == "labels":
            self._check_ids(path, image)
        return image

    def without(self, cameras: Sequence[str]) -> Capture:
        """The capture as if it had no such cameras."""
        kept = {name: camera for name, camera in self.cameras.items() if name not in cameras}
        return replace(self, cameras=kept, left_out=(*self.left_out, *cameras))

    def has(self, number: int) -> bool:
        """Is the frame there?"""
        return (self.root / "frames" / f"{number:06d}").is_dir()

    def folder(self, number: int) -> Path:
        """Where a frame's files lie."""
        if not isinstance(number, (int, np.integer)):
            raise UserError(f"{self.root / 'frames'}: {number!r}: expected the number of a frame, a whole number")
        folder = self.root / "frames" / f"{number:06d}"
        if not folder.is_dir():
            raise UserError(f"{folder}: no such frame")
        return folder

    def pictured(self, number: int) -> tuple[str, ...]:
        """Names of the cameras that have a picture of a frame, in the cameras' order."""
        return tuple(self._files(self.folder(number) / "images"))

    def labelled(self, number: int) -> tuple[str, ...]:
        """Names of the cameras that have a label image of a frame; none where the frame is at fault, which reading it tells."""
        try:
            return tuple(self._files(self.folder(number) / "labels"))
        except UserError:
            return ()

    def masked(self, number: int) -> tuple[str, ...]:
        """Names of the cameras that have a mask of a frame."""
        return tuple(self._files(self.folder(number) / "masks"))

    def inputs(self, number: int) -> list[Path]:
        """The files that are read of a frame, in order."""
        folder = self.folder(number)
        pictures = [path for kind in KINDS if (folder / kind).is_dir() for path in pictures_in(folder / kind)]
        return sorted(path for path in (*(folder / name for name in ALONE), *pictures) if path.is_file())

    def unread(self, number: int) -> list[Path]:
        """What lies in a frame's folder and is not read, in order, without what systems leave there."""
        folder = self.folder(number)
        found = {path for path in folder.iterdir() if path.name not in (*KINDS, *ALONE)}
        for kind in KINDS:
            if (folder / kind).is_dir():
                found |= set((folder / kind).iterdir()) - set(pictures_in(folder / kind))
        return sorted(path for path in found if not path.name.startswith(".") and path.name.lower() not in LITTER)

    def check_pictures(self, number: int) -> None:
        """UserError where a frame has no picture, or one of another size than its camera's; only headers are read."""
        folder = self.folder(number) / "images"
        files = self._files(folder)
        if not files:
            raise UserError(f"{folder}: no pictures")
        for name, path in files.items():
            check_image(path, self.cameras[name].size)

    def _own_or_made(self, folder: Path, name: str) -> Path:
        """A file of a frame's folder; where that has none, of what was made of the frame."""
        own = folder / name
        return own if self.made is None or os.path.lexists(own) else self.made / folder.name / name

    def _files(self, folder: Path) -> dict[str, Path]:
        """{camera: path} of one kind, for the cameras that have it, in their order."""
        if not os.path.lexists(folder):
            return {}
        if not folder.is_dir():
            raise UserError(f"{folder}: not a folder")
        paths: dict[str, Path] = {}
        for path in pictures_in(folder):
            if path.stem in self.left_out:
                continue
            if path.stem not in self.cameras:
                raise UserError(f"{path}: no camera '{path.stem}' in cameras.json")
            if path.stem in paths:
                raise UserError(f"{path}: {paths[path.stem].name} is there too")
            paths[path.stem] = path
        return {name: paths[name] for name in self.cameras if name in paths}

    def _check_ids(self, path: Path, labels: Anything) -> None:
        strange = labels.tobytes().translate(None, bytes([0, *self.scene.labels.values()]))
        if strange:
            raise UserError(f"{path}: label id {min(strange)} is not in scene.toml's [labels]")

    def _check_height(self, path: Path, scan: Mesh) -> None:
        used = np.zeros(len(scan.vertices), bool)
        used[scan.faces] = True
        extent = float(np.ptp(scan.vertices[used], axis=0).max())
        if not HEIGHT[0] <= extent <= HEIGHT[1]:
            raise UserError(
                f'{path}: the scan is {extent:.4g} m large with [scene] units = "{self.scene.units}"; '
                f"expected {HEIGHT[0]} to {HEIGHT[1]} m"
            )


def pictures_in(folder: Path) -> list[Path]:
    """Pictures in a folder, in order; hidden files, which some systems leave, are none."""
    endings = (".png", ".jpg", ".jpeg")
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in endings and not p.name.startswith("."))


def open_capture(path: Path | str) -> Capture:
    """Opens and validates a capture folder. UserError: one line that names the file and the field."""
    root = Path(path)
    if not root.is_dir():
        raise UserError(f"{root}: no such folder; a capture is a folder with scene.toml, cameras.json and frames/")
    scene, cameras_file = read_scene(root)
    cameras = _cameras(root, cameras_file, METRES[scene.units])
    frames = tuple(
        sorted(int(p.name) for p in (root / "frames").glob("*") if p.is_dir() and re.fullmatch(r"\d{6}", p.name))
    )
    if not frames:
        raise UserError(f"{root / 'frames'}: no frames (folders named 000000, 000001, ...)")
    with_file = [g for g in scene.garments if g.template]
    found = {g.name: read_template(root / g.template, g.name) for g in with_file}
    templates = {name: _scaled(t.mesh, METRES[scene.units]) for name, t in found.items()}
    warnings = tuple(warning for t in found.values() for warning in t.warnings)
    named = [cameras_file, *(g.template for g in with_file)]
    named += [scene.body_model] if scene.body_model.endswith(".npz") else []
    named += [] if scene.segmenter in SEGMENTERS else network_files(root, scene.segmenter)
    drawn = {g.name: texture_files(root, root / g.template) for g in with_file if g.prints}
    named += [os.path.relpath(path, os.path.realpath(root)) for paths in drawn.values() for path in paths]
    files = tuple(path for path in (root / "scene.toml", *(root / name for name in (*named, VOTES))) if path.exists())
    votes = read_votes(root / VOTES, scene.labels) if os.path.lexists(root / VOTES) else ()
    textures = {name: paths[-1] for name, paths in drawn.items() if paths}
    warnings += tuple(_pictureless_prints(root, scene.garments, templates, textures))
    kept = {name: t.kept for name, t in found.items()}
    return Capture(root, scene, cameras, frames, templates, kept, files, warnings, textures, votes)


def _pictureless_prints(
    root: Path, garments: Sequence[Garment], templates: dict[str, Mesh], textures: dict[str, Path]
) -> Iterator[str]:
    """Why the pictures that templates of printed garments name are not taken, a line each."""
    for g in garments:
        if g.name in textures and templates[g.name].uv is None:
            why = (
                f"corners of faces of garment '{g.name}' have no UV: {textures[g.name].name} is not taken for its print"
            )
            yield f"{root / g.template}: {why}"
        elif g.prints and g.template and (lost := lost_material(root, root / g.template)):
            yield f"{root / g.template}: mtllib: no file '{lost.name}': no picture is taken for the print of garment '{g.name}'"


def check_capture(capture: Capture, frames: Sequence[int]) -> None:
    """Reads the first frames of a run before anything is written.

    What is wrong in every one of them, and a garment whose label no pixel carries, is the capture's fault and raises;
    a bad frame among good ones is left for the run to record.
    """
    model = model_in_capture(capture.root, capture.scene.body_model, capture.scene.up)
    for i, vote in enumerate(capture.votes):
        if vote.vertices[-1] >= len(model.v_template):
            n = len(model.v_template)
            raise UserError(f"{capture.root / VOTES}: {i}.vertices: {vote.vertices[-1]}: the surface has {n} vertices")
        if absent := sorted(set(vote.frames or ()) - set(capture.frames)):
            raise UserError(f"{capture.root / VOTES}: {i}.frames: {absent[0]}: the capture has no such frame")
    errors, seen, labelled = [], set(), False
    checked = list(frames[:CHECKED])
    segmented = bool(capture.scene.segmenter) and any(capture.pictured(number) for number in frames)
    if capture.scene.garments and not segmented and not any(capture.labelled(number) for number in checked):
        checked += [number for number in frames[CHECKED:] if capture.labelled(number)][:CHECKED]  # key frames
    for number in checked:
        try:
            frame = capture.frame(number)
        except Exception as error:
            errors.append(first_line(error))
            continue
        labelled |= bool(frame.labels) or frame.scan_labels is not None
        for image in frame.labels.values():
            seen |= set(np.unique(image).tolist())
        if frame.scan_labels is not None:
            seen |= set(np.unique(frame.scan_labels).tolist())
    if len(errors) == len(checked):
        raise UserError(errors[0])
    for i, garment in enumerate(capture.scene.garments):
        if garment.prints and not any(capture.pictured(number) for number in frames):
            raise UserError(
                f"{capture.root / 'scene.toml'}: garment.{i}.prints: frame {frames[0]:06d} has no images to show the print of "
                f"'{garment.name}', nor has any other"
            )
        if segmented:
            continue
        if not labelled:
            raise UserError(
                f"{capture.root / 'frames'}: garment '{garment.name}' needs labels/*.png, labels on the scans, or "
                'segmenter = "clothes" under [scene], the packaged network'
            )
        if capture.scene.labels[garment.label] not in seen:
            raise UserError(
                f"{capture.root / 'scene.toml'}: labels.{garment.label} = {capture.scene.labels[garment.label]}: "
                f"nothing in frame {frames[0]} and its neighbours carries this id"
            )


def _cameras(root: Path, name: str, metres: float) -> dict[str, Camera]:
    """Cameras where the capture has pictures or keypoints; scans alone need none."""
    path = inside(root, root / "scene.toml", "cameras.file", name)
    needed = any((root / "frames").glob("*/images/*")) or any((root / "frames").glob("*/keypoints.json"))
    return read_cameras(path, metres) if needed or path.exists() else {}


def _scaled(mesh: Mesh, metres: float) -> Mesh:
    if metres == 1:
        return mesh
    return replace(mesh, vertices=mesh.vertices * metres)
