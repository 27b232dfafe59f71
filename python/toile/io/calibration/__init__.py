"""Calibrations of other programs, one file a format: each says what it takes and what it leaves.

A reader gives {name: Camera} in toile's convention and in the file's own unit of length; width and height are 0 where the
file does not say them, and the pictures tell. What it left or had to assume it adds to the notes, a line each.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ...errors import UserError
from ...scene import Camera
from . import colmap, lists, metashape, opencv, pose2sim, qualisys
from .lenses import refuse_bent


@dataclass(frozen=True)
class Kind:
    """A format: the files it is known by, its reader, and the unit of length that it is written in, "" for any."""

    names: tuple[str, ...]  # patterns
    read: Callable[[Path, list[str]], dict[str, Camera]]  # adds to the notes
    units: str = ""
    many: bool = False  # a file a camera: any of them stands for all
    but: tuple[str, ...] = ()  # files of such names that hold something else


KINDS = {
    "opencv": Kind(opencv.NAMES, opencv.read, many=True),
    "colmap": Kind(colmap.NAMES, colmap.read),
    "metashape": Kind(metashape.NAMES, metashape.read),
    "qualisys": Kind(qualisys.NAMES, qualisys.read, "mm"),
    "pose2sim": Kind(pose2sim.NAMES, pose2sim.read, "m", but=pose2sim.OTHERS),
    "lists": Kind(lists.NAMES, lists.read),
}
# Patterns, below a folder that holds a capture.
PLACES = ("", "calibration", "calib", "cameras", "sparse/[0-9]*", "sparse")


def find_calibration(kind: str, source: Path) -> Path:
    """The calibration file of this kind: `source` itself, or the only one in that folder and its usual places."""
    if source.is_file():
        return source
    if not source.is_dir():
        raise UserError(f"{source}: no such file or folder")
    for place in PLACES:
        for pattern in KINDS[kind].names:
            paths = source.glob(f"{place}/{pattern}" if place else pattern)
            found = sorted(p for p in paths if p.is_file() and p.name not in KINDS[kind].but)
            if len(found) > 1 and not KINDS[kind].many:
                first, second = (p.relative_to(source) for p in found[:2])
                raise UserError(
                    f"{source}: {first} and {second} may both be the calibration: name one, and the pictures' folder by --images"
                )
            if found:
                return found[0]
    raise UserError(f"{source}: no calibration of kind '{kind}' ({', '.join(KINDS[kind].names)})")


def read_calibration(
    kind: str, path: Path, notes: list[str] | None = None, undistort: bool = False
) -> dict[str, Camera]:
    """{name: Camera} of a calibration file, translations in its own unit; what it leaves is added to `notes`. UserError names the
    file and the field, of cameras that are Bent too, unless `undistort`."""
    cameras = KINDS[kind].read(path, [] if notes is None else notes)
    if not cameras:
        raise UserError(f"{path}: no camera in it")
    if not undistort:
        refuse_bent(path, cameras.values())
    return cameras
