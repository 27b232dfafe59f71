"""Metashape's camera export (File > Export > Export Cameras, Agisoft XML).

The principal point (cx, cy) is an offset from the picture's middle (w/2, h/2), in which pixel centres are at halves; p1 and
p2 stand the other way round than OpenCV's:

    x' = x (1 + k1 r2 + k2 r4 + k3 r6 + k4 r8) + (p1 (r2 + 2 x2) + 2 p2 x y) (1 + p3 r2 + p4 r4)     u = w/2 + cx + x' (f + b1) + y' b2
    y' = y (1 + k1 r2 + k2 r4 + k3 r6 + k4 r8) + (p2 (r2 + 2 y2) + 2 p1 x y) (1 + p3 r2 + p4 r4)     v = h/2 + cy + y' f

(Metashape Professional manual, appendix "Camera models"). Before it a fisheye takes x, y to t / r of them, or 2 sin(t / 2) / r where it
is equisolid, t = atan r. A camera's `transform` takes its frame to the chunk's, the
component's or chunk's `transform` (scale, rotation, translation) that to the world's.

A camera of a multi-camera system has a `master_id` and no transform. Its sensor's `rotation` (3x3) and `location` (`translation` in
older files) take its frame to that of the master sensor, in units of the chunk, so that the camera's transform is the master's
times the offset. A master's sensor need not be the one that the sensors' `master_id` names: offsets are taken between the two.

Taken: sensors of type frame and fisheye, cameras with a transform or with a master that has one. Left, and said: other cameras. Left:
markers, references. Refused: other lens types, several chunks, and several components unless each
has its transform: nothing tells how they stand to one another.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from ...errors import UserError
from ...kernels.arrays import Floats
from ...scene import Camera
from ..bounded import read_xml
from .checked import add, few, intrinsics, inverse, make_camera, numbers, placed, rigid, rotation
from .lenses import Lens

NAMES = ("*.xml",)
WORLD = ("scale", "rotation", "translation")
REACHES: dict[
    str, Callable[[Floats], Floats]
] = {  # how far from the middle a point lies, of its r before the polynomial
    "frame": lambda r: r,
    "fisheye": np.arctan,
    "equidistant_fisheye": np.arctan,
    "equisolid_fisheye": lambda r: 2 * np.sin(np.arctan(r) / 2),
}
ENDING = re.compile(r"(?i)\.(jpe?g|png|tiff?|bmp|exr|dng|raw|cr[23]|nef|arw)$")  # of pictures; "cam.1" has none


def read(path: Path, notes: list[str]) -> dict[str, Camera]:
    """{what `_names` calls it: Camera}, in units of the chunk's world (metres where it has a scale)."""
    chunks = read_xml(path).findall("chunk")
    if len(chunks) != 1:
        found = f"{len(chunks)} chunks: export one" if chunks else "no <chunk>: not a camera export of Metashape"
        raise UserError(f"{path}: {found}")
    chunk = chunks[0]
    sensors = {sensor.get("id"): sensor for sensor in chunk.iter("sensor")}
    every = list(chunk.iter("camera"))
    aligned = [camera for camera in every if camera.find("transform") is not None]
    masters, offsets = {camera.get("id"): camera for camera in aligned}, _offsets(path, sensors)
    names = _names(chunk, every, notes)
    worlds = _worlds(path, chunk, {camera: names[camera] for camera in aligned})
    cameras: dict[str, Camera] = {}
    left: dict[str, list[str]] = {}
    for camera in every:
        name = names[camera]
        master, why = (camera, "") if camera in aligned else _master(camera, masters, offsets)
        if master is None:
            left.setdefault(why, []).append(name)
            continue
        sensor = sensors.get(camera.get("sensor_id"))
        if sensor is None:
            raise UserError(f"{path}: camera '{name}': no sensor {camera.get('sensor_id')}")
        T = placed(path, f"camera '{names[master]}': transform", master.findtext("transform", "").split())
        if master is not camera:
            T = T @ inverse(offsets[master.get("sensor_id")][1]) @ offsets[camera.get("sensor_id")][1]
        scale, R, t = worlds[master.get("component_id")]
        pose = rigid(R @ T[:3, :3], scale * R @ T[:3, 3] + t)
        if name in cameras:
            raise UserError(
                f"{path}: two cameras are called '{name}': group each in Metashape under the name of its pictures' folder, and export again"
            )
        add(path, cameras, _camera(path, name, sensor, inverse(pose)))
    notes += [f"left: {len(those)} cameras {why}: {few(those)}" for why, those in left.items()]
    return cameras


def _names(chunk: Element, cameras: list[Element], notes: list[str]) -> dict[Element, str]:
    """Labels of cameras without a picture's ending; where labels repeat, the names of the groups that cameras stand in."""
    names = {camera: ENDING.sub("", camera.get("label", "")) for camera in cameras}
    groups = {
        camera: name for group in chunk.iter("group") for camera in group.iter("camera") if (name := group.get("label"))
    }
    if not groups or len(set(names.values())) == len(names):
        return names
    notes.append(f"cameras are called by their groups, as labels repeat: {few(groups.values())}")
    return names | groups


def _master(
    camera: Element, masters: dict[str | None, Element], offsets: dict[str | None, tuple[str | None, Floats]]
) -> tuple[Element | None, str]:
    """The camera of its system that places one without a transform; None, and why none does."""
    if camera.get("master_id") in (None, camera.get("id")):
        return None, "that are not aligned"
    master = masters.get(camera.get("master_id"))
    if master is None:
        return None, "whose master is not aligned"
    heads = {offsets.get(one.get("sensor_id"), (None, None))[0] for one in (camera, master)}
    if None in heads or len(heads) > 1:
        return None, "whose sensor has no rotation and location to its master's"
    return master, ""


def _offsets(path: Path, sensors: dict[str | None, Element]) -> dict[str | None, tuple[str | None, Floats]]:
    """{sensor: (the sensor at the head of its system, the sensor's frame in that one's (4,4))}, of those whose offset is told."""
    offsets: dict[str | None, tuple[str | None, Floats]] = {}
    for key, sensor in sensors.items():
        master = sensor.get("master_id", key)
        turn, shift = sensor.findtext("rotation"), sensor.findtext("location", sensor.findtext("translation"))
        if master == key:
            offsets[key] = key, np.eye(4)
        elif turn is not None and shift is not None:
            R = rotation(path, f"sensor {key}: rotation", turn.split())
            offsets[key] = master, rigid(R, numbers(path, f"sensor {key}: location", shift.split(), (3,)))
    return offsets


def _worlds(path: Path, chunk: Element, aligned: dict[Element, str]) -> dict[str | None, tuple[float, Floats, Floats]]:
    """{component: its frame in the world}, of those that have cameras, given with their names; the chunk's where a component has none of its own."""
    first: dict[str | None, str] = {}
    for camera, name in aligned.items():
        first.setdefault(camera.get("component_id"), name)
    own = {c.get("id"): t for c in chunk.iter("component") if (t := c.find("transform")) is not None}
    loose = [component for component in first if component not in own]
    if loose and len(first) > 1:
        raise UserError(
            f"{path}: camera '{first[loose[0]]}': component {loose[0]} has no transform, so that nothing tells how it stands "
            f"to the other {len(first) - 1}: align or merge them"
        )
    return {component: _world(path, own.get(component, chunk.find("transform"))) for component in first}


def _camera(path: Path, name: str, sensor: Element, T_camera_world: Floats) -> Camera:
    kind = sensor.get("type", "frame")
    if kind not in REACHES:
        raise UserError(f"{path}: camera '{name}': a sensor of type {kind!r} is not read, only {', '.join(REACHES)}")
    adjusted = [c for c in sensor.findall("calibration") if c.get("class", "adjusted") == "adjusted"]
    if not adjusted:
        raise UserError(f"{path}: camera '{name}': its sensor has no adjusted calibration")
    resolution = adjusted[0].find("resolution")
    resolution = sensor.find("resolution") if resolution is None else resolution
    if resolution is None:
        raise UserError(f"{path}: camera '{name}': its sensor has no resolution")
    size = [resolution.get(side) for side in ("height", "width")]
    height, width = numbers(path, f"camera '{name}': resolution", size, (2,)).astype(int).tolist()

    def of(field: str) -> Any:
        return numbers(path, f"camera '{name}': {field}", adjusted[0].findtext(field, "0"), (1,))[0]

    K = intrinsics(of("f") + of("b1"), of("f"), width / 2 + of("cx"), height / 2 + of("cy"), of("b2"))
    beyond = [field for field in ("k4", "p3", "p4") if of(field)]
    told = f"a sensor of type {kind!r}" if kind != "frame" else f"{', '.join(beyond)} are not zero" if beyond else ""
    k, p = ([of(f"{letter}{i}") for i in range(1, 5)] for letter in "kp")
    bend = np.array([k[0], k[1], p[1], p[0], k[2]])
    lens = Lens(partial(_bent, reach=REACHES[kind], k=k, p=p), told) if told else None
    return make_camera(path, name, (height, width), K, bend, T_camera_world, lens)


def _bent(xy: Floats, reach: Callable[[Floats], Floats], k: list[float], p: list[float]) -> Floats:
    """Ideal normalised coordinates (..., 2) to distorted ones, by the equations above."""
    r = np.linalg.norm(xy, axis=-1, keepdims=True)
    xy = xy * np.where(r > 0, reach(r) / np.where(r > 0, r, 1), 1)
    x, y = xy[..., :1], xy[..., 1:]
    r2 = x * x + y * y
    radial = 1 + r2 * (k[0] + r2 * (k[1] + r2 * (k[2] + r2 * k[3])))
    aside = np.concatenate([p[0] * (r2 + 2 * x * x) + 2 * p[1] * x * y, p[1] * (r2 + 2 * y * y) + 2 * p[0] * x * y], -1)
    return xy * radial + aside * (1 + r2 * (p[2] + r2 * p[3]))


def _world(path: Path, element: Element | None) -> tuple[float, Floats, Floats]:
    """Scale, rotation, translation from the chunk's frame to the world's."""
    found = {name: None if element is None else element.findtext(name) for name in WORLD}
    scale = numbers(path, "transform.scale", found["scale"] or "1", (1,))[0]
    if scale <= 0:
        raise UserError(f"{path}: transform.scale: {scale:g}, expected a positive number")
    R = rotation(path, "transform.rotation", (found["rotation"] or "1 0 0 0 1 0 0 0 1").split())
    return scale, R, numbers(path, "transform.translation", (found["translation"] or "0 0 0").split(), (3,))
