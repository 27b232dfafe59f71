"""Somebody's folder of pictures with a calibration: frames are found by how its files are called."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError
from ..frame_numbers import frame_ranges
from ..kernels.arrays import Floats
from ..scene import Camera
from .calibration import KINDS, find_calibration, read_calibration
from .calibration.checked import SHOWN, few
from .calibration.lenses import Bent
from .films import dropped, film_count, film_rate
from .importing import Found, Source, moved, moved_scan, text_of, turned_up, up_of
from .openpose import read_person
from .places import ENDINGS, PICTURES, Placed, files_of, folder_of, numbered, place, placed
from .scene_file import METRES
from .skeletons import SKELETONS

FPS = 30.0  # where nothing tells
SAME_RATE = 1.01  # films whose rates differ by less tell the same


@dataclass(frozen=True)
class Options:
    """What a folder does not say itself; folders that are None are found by their names."""

    folders: Mapping[str, Path | None] = field(
        default_factory=dict
    )  # of images, masks, labels, keypoints, scans, videos
    units: str = ""  # of the calibration and scans: m, dm, cm, mm, or metres a unit
    up: str = ""  # x, y, z, -x, -y, -z
    skeleton: str = ""
    offsets: Mapping[str, int] = field(default_factory=dict)  # camera: its file number of frame 0
    fps: float | None = None  # frames a second, by default those of the films
    cropped: bool = False  # pictures lack columns at the right or rows below that the calibration has
    scaled: bool = False  # pictures were scaled since their calibration, both sides by one factor
    undistort: bool = False  # pictures of lenses that a Camera does not know become a pinhole camera's


def read_rig(kind: str, source: Path, options: Options) -> Found:
    """What a calibration of a kind and the files about it make. UserError names the file or the option."""
    if options.cropped and options.scaled:
        raise UserError("--cropped, --scaled: of pictures that were cut and scaled nothing tells by how much")
    path = find_calibration(kind, source)
    root = source if source.is_dir() else path.parent
    said: list[str] = []
    cameras = read_calibration(kind, path, said, options.undistort)
    for name in options.offsets:
        if name not in cameras:
            raise UserError(f"--offset {name}: no such camera in {path.name}: {few(cameras)}")
    unit = options.units or KINDS[kind].units
    up, turn = turned_up(options.up or _guessed_up(path, cameras))
    metres = metres_of(unit or "m")
    notes = [f"calibration: {kind}, {path.name}, {len(cameras)} cameras, unit {unit or 'm (assumed)'}", *said]
    notes.append(
        f"up: {options.up or 'told by the cameras'}{'' if np.trace(turn) == 3 else ', turned by half a turn to ' + up}"
    )
    bent = [name for name, camera in cameras.items() if isinstance(camera, Bent)]
    if options.undistort and not bent:
        notes.append("undistort: no lens asks for it, distortion of five coefficients is kept")
    straight = [name for name, camera in cameras.items() if not np.any(camera.distortion) and name not in bent]
    if straight:
        which = "any camera" if len(straight) == len(cameras) else few(straight)
        notes.append(f"distortion: none of {which}: such pictures are taken as they are")
    cameras = moved(cameras, metres, turn)
    frames: dict[int, dict[str, Source]] = {}
    for what in ("images", "masks", "labels"):
        found = _placed(root, what, cameras, options, notes)
        _add(frames, found, what, options.offsets)
    _add_keypoints(frames, root, cameras, options, notes)
    films = _films(frames, root, cameras, options, notes)
    if not frames:
        left = "".join(f"; {note}" for note in notes if note.startswith("left: "))
        raise UserError(f"{root}: no pictures of the cameras {few(cameras)}: folders images/, CAM/ or videos/{left}")
    _add_scans(frames, root, metres, turn, options, notes)
    fps = options.fps or _rate(films)
    notes.append(f"frames a second: {fps or FPS:g}{'' if fps else ' (assumed, give them by --fps)'}")
    made = Found(cameras, frames, up, fps or FPS, films=films, notes=tuple(notes))
    return replace(made, cropped=options.cropped, scaled=options.scaled)


def _rate(films: Mapping[str, tuple[Path, int]]) -> float:
    """What all films' headers say; 0 where none does. UserError: they say different things."""
    rates = {path.name: rate for path, _ in films.values() if (rate := film_rate(path))}
    slowest, fastest = min(rates, key=rates.__getitem__, default=""), max(rates, key=rates.__getitem__, default="")
    if rates and rates[fastest] > SAME_RATE * rates[slowest]:
        each = f"{slowest} has {rates[slowest]:g} pictures a second, {fastest} {rates[fastest]:g}"
        raise UserError(f"{each}: give those that frames are to be numbered by as --fps")
    return rates[slowest] if rates else 0.0


def metres_of(units: str) -> float:
    """Metres a unit, of m, dm, cm, mm or a number."""
    try:
        metres = METRES[units] if units in METRES else float(units)
    except ValueError:
        metres = 0.0
    if not 1e-6 <= metres <= 1e6:
        raise UserError(f"--units {units}: expected m, dm, cm, mm or metres a unit")
    return metres


def _guessed_up(path: Path, cameras: dict[str, Camera]) -> str:
    up = up_of(cameras.values())
    if not up:
        raise UserError(f"{path}: its cameras do not tell which axis is up: say --up x, y, z, -x, -y or -z")
    return up


def _folder(root: Path, what: str, options: Options) -> Path | None:
    given = options.folders.get(what)
    if given is not None and not given.is_dir():
        raise UserError(f"--{what} {given}: no such folder")
    return given or folder_of(root, what)


def _placed(root: Path, what: str, cameras: dict[str, Camera], options: Options, notes: list[str]) -> Placed:
    folder = _folder(root, what, options)
    if folder is None:
        return Placed()
    found = placed(folder, what, cameras)
    if what != "keypoints" and (unread := files_of(folder, what, PICTURES)):
        names = few(path.relative_to(folder).as_posix() for path in unread)
        notes.append(f"left: {len(unread)} {what} that are neither PNG nor JPEG: {names}")
    strange = [path.relative_to(folder).as_posix() for path in found.strange]
    if found.strange and not found.files and what == "images" and folder != root:
        raise UserError(
            f"{folder}: pictures of no camera of the calibration: {few(strange)}; its cameras: {few(cameras)}"
        )
    if found.strange and folder != root:
        notes.append(f"left: {len(found.strange)} {what} of no camera: {few(strange)}")
    before = Counter(
        camera for n, files in found.files.items() for camera in files if n < options.offsets.get(camera, 0)
    )
    if before:
        each = few(f"{count} of {camera}" for camera, count in before.items())
        notes.append(f"left: {what} before frame 0, as --offset says: {each}")
    if found.files:
        seen = {camera for files in found.files.values() for camera in files}
        ask = ", whose ids [labels] of scene.toml has to name" if what == "labels" else ""
        notes.append(f"{what}: {sum(map(len, found.files.values()))} of {len(seen)} cameras in {folder.name}/{ask}")
    return found


def _add(frames: dict[int, dict[str, Source]], found: Placed, what: str, offsets: Mapping[str, int]) -> None:
    for number, files in found.files.items():
        for camera, path in files.items():
            if number - offsets.get(camera, 0) >= 0:
                ending = ".png" if path.suffix.lower() == ".png" else ".jpg"
                frames.setdefault(number - offsets.get(camera, 0), {})[f"{what}/{camera}{ending}"] = path


def _add_keypoints(
    frames: dict[int, dict[str, Source]], root: Path, cameras: dict[str, Camera], options: Options, notes: list[str]
) -> None:
    found = _placed(root, "keypoints", cameras, options, notes)
    shifted: dict[int, dict[str, Path]] = {}
    crowded = 0
    for number, files in found.files.items():
        for camera, path in files.items():
            shifted.setdefault(number - options.offsets.get(camera, 0), {})[camera] = path
    for number, files in shifted.items():
        people = {camera: read_person(path, options.skeleton) for camera, path in files.items()}
        crowded += any(count > 1 for _, count in people.values())
        text = keypoints_json({camera: points for camera, (points, _) in people.items()})
        if number >= 0:
            frames.setdefault(number, {})["keypoints.json"] = text_of(text)
    if crowded:
        notes.append(f"keypoints: {crowded} frames show several people, of each picture the surest was taken")


def keypoints_json(people: Mapping[str, Mapping[str, Floats]]) -> str:
    """The text of keypoints.json: {camera: {name: (u, v, confidence)}}, names in one order, unseen ones of confidence 0."""
    known = {name: None for names in SKELETONS.values() for name in names if name}
    there = {name: None for points in people.values() for name in points}
    names = [name for name in known if name in there] + sorted(name for name in there if name not in known)
    rows = {
        camera: [np.round(points.get(name, np.zeros(3)), 4).tolist() for name in names]
        for camera, points in people.items()
    }
    return json.dumps({"names": names, "points": rows})


def _films(
    frames: dict[int, dict[str, Source]], root: Path, cameras: dict[str, Camera], options: Options, notes: list[str]
) -> dict[str, tuple[Path, int]]:
    """{camera: (film, its picture of frame 0)}; the frames that films have are added."""
    folder = _folder(root, "videos", options)
    films: dict[str, tuple[Path, int]] = {}
    longest = sorted(cameras, key=len, reverse=True)
    if folder is None:
        return films
    for path in files_of(folder, "videos"):
        camera, _ = place(path.relative_to(folder), longest)
        if camera is None:
            notes.append(f"left: {path.name}, a film of no camera")
        elif camera in films:
            raise UserError(f"{path}: camera '{camera}' has {films[camera][0].name} too")
        else:
            films[camera] = path, options.offsets.get(camera, 0)
            count = film_count(path)
            if not count:
                raise UserError(f"{path}: no picture in it")
            for number in range(max(0, -films[camera][1]), count - films[camera][1]):
                frames.setdefault(number, {})
            missing, first = dropped(path)
            if missing:
                notes.append(
                    f"{path.name}: lacks {missing} pictures by its times: from picture {first} on it is out of step"
                )
    if films:
        notes.append(f"films: {len(films)}, decoded into JPEG pictures")
    return films


def _add_scans(
    frames: dict[int, dict[str, Source]], root: Path, metres: float, turn: Floats, options: Options, notes: list[str]
) -> None:
    folder = _folder(root, "scans", options)
    if folder is None:
        return
    found = numbered(folder, "scans") or _sole_scan(folder, frames)
    scans = {number: path for number, path in found.items() if number in frames}
    if not scans:
        there = (
            f"its numbers are {frame_ranges(sorted(found), SHOWN)}"
            if found
            else f"no {', '.join(ENDINGS['scans'])} with a number"
        )
        raise UserError(f"{folder}: no scan of the frames {frame_ranges(sorted(frames), SHOWN)}: {there}")
    for number, path in scans.items():
        frames[number]["scan.ply"] = moved_scan(path, metres, turn)
    notes.append(f"scans: {len(scans)} in {folder.name}/")
    if left := sorted(set(found) - set(scans)):
        notes.append(f"left: {len(left)} scans of other frames: {frame_ranges(left, SHOWN)}")


def _sole_scan(folder: Path, frames: Iterable[int]) -> dict[int, Path]:
    """The only scan of the only frame, which needs no number."""
    numbers, files = list(frames), files_of(folder, "scans")
    return dict(zip(numbers, files)) if len(numbers) == len(files) == 1 else {}


def chosen(found: Found, numbers: Any) -> Found:
    """Only the frames of these numbers."""
    return replace(found, frames={number: found.frames[number] for number in numbers if number in found.frames})
