"""What a path shows, in the bytes that the page draws."""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np

from ..errors import UserError, first_line
from ..frame_numbers import rate_of
from ..io.animation import FACTS, is_animation
from ..io.bounded import read_bytes
from ..io.capture import open_capture
from ..io.export.clip import Clip
from ..io.export.glb import split_layer
from ..io.export.source import open_clip
from ..io.image import read_rgba
from ..io.layout import FAILED, PENDING, STORE, VERDICTS
from ..io.run import is_run, open_run
from ..kernels import SurfaceIndex
from ..kernels.arrays import Floats
from ..measure.truth import open_truth

PLAIN, CONFIDENCE, DISTANCE, TRUTH = "plain", "confidence", "distance to the scan", "distance to the truth"
TEXTURE = "texture"
FARTHEST = 0.02  # m: the end of the scale of distances
PICTURE = 720  # pixels, the longer side of pictures that are sent
LAST = 65535
KINDS = {  # what a folder may be: the file that makes it one, and what else shows that it was meant to be
    "an avatar": ("avatar.json", ("avatar.safetensors", "checkpoints", "assets")),
    "a run": (STORE, ("config.toml", "status.jsonl", "diagnostics")),
    "an animation": (FACTS, ("skeleton.npz", "meshes", "layers")),
    "a capture": ("scene.toml", ("cameras.json", "frames")),
}
CURVES = ("two_sided_mm", "surface_to_scan_mm", "keypoint_mm")  # of the verdict's evidence, the first that there is


class Posed(Protocol):
    """What can be posed: an avatar."""

    clip: Clip
    turns: Sequence[str]  # names of what can be turned
    warnings: Sequence[str]  # what a user should know of how it follows its motion

    def vertices(self, frame: int, turns: dict[str, float]) -> dict[str, Floats]: ...


def check_kind(path: Path) -> None:
    """UserError: a folder that is none of KINDS; it names what the folder lacks, and by which of its contents it is taken for what."""
    if not path.is_dir() or any((path / file).exists() for file, _ in KINDS.values()):
        return
    for kind, (file, others) in KINDS.items():
        if there := [name for name in others if (path / name).exists()]:
            raise UserError(f"{path}: taken for {kind} by its {' and '.join(there)}, but it lacks {file}")
    expected = ", ".join(f"{file} of {kind}" for kind, (file, _) in KINDS.items())
    raise UserError(f"{path}: there is nothing to view; expected one of {expected}")


class Shown:
    """A run, an animation, a capture, or what can be `posed`. Bytes are little-endian; frames are numbers, layers and cameras
    names."""

    def __init__(self, path: Path, posed: Posed | None = None):
        self.path, self.posable, self.gone = Path(path), posed, ""
        self.run = open_run(path) if posed is None and is_run(path) else None
        if posed is not None:
            self.clip = posed.clip
        elif self.run is not None or is_animation(path):
            self.clip = open_clip(path, skeleton=False)
        else:
            check_kind(self.path)
            self.clip = self._bare()
        self.layers = {layer.name: layer for layer in self.clip.layers}

    def _bare(self) -> Clip:
        scene = self.capture.scene
        return Clip(scene.name, scene.fps, scene.up.removeprefix("-"), tuple(self.capture.frames), ())

    @cached_property
    def capture(self):
        """The Capture behind it; None where there is none, or none any more."""
        if self.posable is not None:
            return None
        if self.run is None:
            return None if is_animation(self.path) else open_capture(self.path)
        try:
            return self.run.capture
        except UserError as error:
            self.gone = first_line(error)
            return None

    @cached_property
    def truth(self):
        """The Truth of a studio capture, None without."""
        return open_truth(self.capture) if self.capture else None

    @cached_property
    def warnings(self) -> list[str]:
        """What of this the page cannot show."""
        if self.posable is not None:
            return list(self.posable.warnings)
        if self.run is None:
            return []
        found, pending = [], int((self.run.done == PENDING).sum())
        if pending:
            found.append(
                f"{self.path}: {pending} of {len(self.run.done)} frames are not registered yet: they are not shown"
            )
        if self.capture is None:
            found.append(f"scans, cameras and pictures are not shown: {self.gone}")
        return found

    def facts(self) -> dict:
        """What the page asks first."""
        cameras = self.capture.cameras.values() if self.capture else ()
        return {
            "name": str(self.path), "up": self.clip.up, "rate": rate_of(self.clip.frames, self.clip.fps), "frames": list(self.clip.frames),
            "layers": [self._layer(name) for name in self.layers], "scan": self.capture is not None,
            "cameras": [camera_facts(camera) for camera in cameras], "marks": self._marks(), "curve": self._curve(),
            "turns": list(self.posable.turns) if self.posable else [],
        }  # fmt: skip

    def _layer(self, name):
        kinds = [PLAIN] if self.layers[name].texture is None else [TEXTURE, PLAIN]
        if self.run is not None:
            kinds += [CONFIDENCE] + ([DISTANCE] if self.capture else [])
            kinds += [TRUTH] if self._true(name) else []
        shown = name != "track" or "inner" not in self.layers
        return {"name": name, "colours": kinds, "shown": shown}

    def _true(self, layer):
        """Does the truth have what a layer is to be? It has no single surface."""
        return self.truth is not None and (layer == "inner" or (layer != "track" and self.truth.has(layer)))

    def _marks(self):
        """{frame: what is wrong with it}."""
        if self.run is None:
            return {}
        found = {int(n): "failed" for n in self.run.frames[self.run.done == FAILED]}
        verdict = self.run.verdict if self.run.verdict is not None else np.zeros(len(self.run.frames), int)
        for number, level in zip(self.run.frames.tolist(), verdict.tolist()):
            if level and number not in found and level < len(VERDICTS):
                found[number] = VERDICTS[level]
        return found

    def _curve(self):
        """{"name", "values": one a frame, None where unknown} of what the verdicts rest on; None without."""
        evidence = self.run.diagnostics.get("evidence", {}) if self.run is not None else {}
        name = next((name for name in CURVES if name in evidence), None)
        if name is None:
            return None
        values = dict(zip(self.run.frames.tolist(), evidence[name].tolist()))
        return {"name": name.replace("_", " "), "values": [number(values[frame]) for frame in self.clip.frames]}

    # bytes ------------------------------------------------------------------------------------------------------------

    def faces(self, layer: str) -> bytes:
        """uint32 (m,3)."""
        return np.asarray(self.layer(layer).faces, "<u4").tobytes()

    def split(self, layer: str) -> bytes:
        """A vertex for each of its UVs: uint32 count, uint32 vertices (q,) of the layer, uint16 UVs (q,2) over the unit square,
        v down, uint32 faces (m,3) into these."""
        found = self.layer(layer)
        split = split_layer(found, len(found.at(self.clip.frames[0])))
        uv = (LAST * np.clip(split.uv, 0, 1)).round().astype("<u2")
        head = struct.pack("<I", len(uv)) + split.vertex.astype("<u4").tobytes()
        return head + uv.tobytes() + split.faces.astype("<u4").tobytes()

    def texture(self, layer: str) -> bytes:
        """The picture over a layer's UV square, as it lies on disk."""
        if self.layer(layer).texture is None:
            raise UserError(f"{self.path}: {layer} has no texture")
        return read_bytes(self.layer(layer).texture)

    def points(self, layer: str, frame: int) -> bytes:
        """See `quantised`."""
        return quantised(self.layer(layer).at(self.frame(frame)))

    def posed(self, layer: str, pose: str, frame: int) -> bytes:
        """`quantised` points of a frame with joints turned as `pose` says: "left arm up:30,head turned:-10" [degrees]."""
        self.layer(layer)
        if self.posable is None:
            raise UserError(f"{self.path}: nothing that can be posed")
        try:
            parts = (part.rpartition(":") for part in pose.split(","))
            turns = {name: np.radians(float(angle)) for name, _, angle in parts}
        except ValueError:
            raise UserError(f"'{pose}' is no pose") from None
        if not all(abs(angle) <= np.pi for angle in turns.values()):
            raise UserError(f"'{pose}': angles are of -180 to 180 degrees")
        return quantised(self.posable.vertices(self.frame(frame), turns)[layer])

    def colours(self, layer: str, kind: str, frame: int) -> bytes:
        """uint8 (n,): shares of the scale, 255 its end."""
        self.layer(layer)
        if self.run is not None and kind == CONFIDENCE:
            return (255 - 127 * np.minimum(self.run.confidence[layer].at(self.frame(frame)), 2)).astype("u1").tobytes()
        index = self._index(layer, kind, frame) if self.run is not None else None
        if index is None:
            raise UserError(f"{layer} has no colours '{kind}' in frame {frame}")
        distance = index.closest(self.layer(layer).at(frame))[3]
        return (255 * np.clip(distance / FARTHEST, 0, 1)).astype("u1").tobytes()

    def _index(self, layer, kind, frame):
        """The SurfaceIndex that a kind's distances are to; None where there is none."""
        if kind == DISTANCE:
            return self._scan(frame).index
        if kind != TRUTH or not self._true(layer) or frame not in self.truth:
            return None
        return SurfaceIndex(*(self.truth.body(frame) if layer == "inner" else self.truth.garment(layer, frame)))

    def scan(self, frame: int) -> bytes:
        """uint32 n and m, `quantised` points and padding to four bytes, uint32 faces (m,3)."""
        scan = self._scan(frame)
        points = quantised(scan.vertices)
        head = struct.pack("<2I", len(scan.vertices), len(scan.faces))
        return head + points + bytes(-len(points) % 4) + np.asarray(scan.faces, "<u4").tobytes()

    def _scan(self, frame):
        scan = self.capture.frame(self.frame(frame)).scan if self.capture else None
        if scan is None:
            raise UserError(f"{self.path}: frame {frame} has no scan")
        return scan

    def picture(self, camera: str, frame: int) -> bytes:
        """A JPEG of what a camera saw, at most PICTURE pixels large."""
        from PIL import Image

        files = self.capture.picture_files(self.frame(frame), "images") if self.capture else {}
        if camera not in files:
            raise UserError(f"{self.path}: frame {frame} has no picture of camera {camera}")
        image, out = Image.fromarray(read_rgba(files[camera])).convert("RGB"), io.BytesIO()
        image.thumbnail((PICTURE, PICTURE))
        image.save(out, "JPEG", quality=85)
        return out.getvalue()

    def layer(self, name):
        if name not in self.layers:
            raise UserError(f"{self.path}: no layer '{name}'")
        return self.layers[name]

    def frame(self, frame: int) -> int:
        if frame not in self.clip.frames:
            raise UserError(f"{self.path}: no frame {frame}")
        return frame


def quantised(V) -> bytes:
    """float32 least corner (3,) and step (3,), uint16 (n,3): a place is the corner plus steps. A person's are under 0.04 mm."""
    low, high = V.min(0), V.max(0)
    step = np.maximum((high - low) / LAST, 1e-12)
    return np.concatenate([low, step]).astype("<f4").tobytes() + ((V - low) / step).round().astype("<u2").tobytes()


def camera_facts(camera) -> dict:
    """A camera as JSON."""
    K, T = np.asarray(camera.K), np.asarray(camera.T_camera_world)
    return {
        "name": camera.name, "width": camera.width, "height": camera.height, "K": K.tolist(), "T": T.tolist(),
        "distorted": bool(np.any(camera.distortion)),
    }  # fmt: skip


def number(value):
    """A number of JSON, None for NaN."""
    return float(value) if np.isfinite(value) else None
