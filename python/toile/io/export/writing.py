"""`write_clip`: a clip as one of FORMATS, whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ...errors import UserError
from ..files import output_file, part_folder, whole_folder
from .alembic import write_alembic
from .arrays import write_arrays
from .bvh import write_bvh
from .clip import Clip
from .glb import write_glb
from .rrd import write_rrd
from .sequence import write_sequence
from .usd import ENDINGS, check_pictures, write_usd

FORMATS = {  # name: the endings of its file, none for a folder
    "usd": ENDINGS,
    "glb": (".glb",),
    "obj": (),
    "ply": (),
    "abc": (".abc",),
    "npz": (".npz",),
    "bvh": (".bvh",),
    "rrd": (".rrd",),
}
POINTS, SKELETON = MOTIONS = "points", "skeleton"
BAKED = 120  # frames of a GLB that are morph targets by default: each is about half a megabyte
FAR = 16.0  # single precision rounds coordinates beyond by more than a millionth of a metre

Progress = Callable[..., None]


def format_of(out: Path, asked: str | None) -> str:
    """The format asked for, or that of the ending. UserError: neither, or they contradict each other."""
    by_ending = {ending: name for name, endings in FORMATS.items() for ending in endings}
    ending = out.suffix.lower()
    if asked is None:
        if ending not in by_ending:
            raise UserError(
                f"{out}: --format: expected one of {', '.join(FORMATS)}, or a file that ends in {', '.join(by_ending)}"
            )
        return by_ending[ending]
    if asked not in FORMATS:
        raise UserError(f"--format {asked}: expected one of {', '.join(FORMATS)}")
    expected = FORMATS[asked]
    if expected and ending not in expected:
        raise UserError(f"{out}: --format {asked}: expected a file that ends in {' or '.join(expected)}")
    if not expected and ending in by_ending:
        raise UserError(f"{out}: --format {asked} is a folder of numbered files, {ending} is {by_ending[ending]}")
    return asked


def write_clip(clip: Clip, out: Path, kind: str, motion: str | None, progress: Progress) -> list[str]:
    """Writes a clip; returns what a user should know of what was written. `motion` "points": every frame's vertices;
    "skeleton": rest surfaces that the skeleton moves, an approximation; None: points, but for GLB of more than BAKED frames."""
    motion = motion or chosen_motion(clip, kind)
    if motion == SKELETON and not (kind in ("usd", "glb") and clip.skinned):
        lacks = (
            f"{clip.name} has no skeleton" if kind in ("usd", "glb") else f"--format {kind} holds none: usd and glb do"
        )
        raise UserError(f"--motion skeleton: {lacks}")
    if kind in ("obj", "ply"):
        with whole_folder(out) as part:
            write_sequence(clip, part, kind, progress)
        return []
    if kind == "usd":
        check_pictures(clip, out)
    with whole_file(out) as part:
        if kind == "usd":
            notes = write_usd(clip, part, motion, progress)
        elif kind == "glb":
            notes = write_glb(clip, part, motion, progress)
        elif kind == "abc":
            notes = write_alembic(clip, part, progress)
        elif kind == "rrd":
            notes = write_rrd(clip, part, progress)
        elif kind == "bvh":
            notes = write_bvh(clip, part)
        else:
            notes = write_arrays(clip, part, progress)
    return notes if kind in ("npz", "bvh") else [*notes, *rounding(clip)]


def chosen_motion(clip: Clip, kind: str) -> str:
    return SKELETON if kind == "glb" and len(clip.frames) > BAKED and clip.skinned else POINTS


def rounding(clip: Clip) -> list[str]:
    """A line where single precision is too coarse, as judged in the first and last frame."""
    far = max(
        float(np.abs(layer.at(frame)).max()) for layer in clip.layers for frame in (clip.frames[0], clip.frames[-1])
    )
    return (
        [f"coordinates of up to {far:.0f} m: single precision rounds them by {1e6 * far * 2**-24:.0f} micrometres"]
        if far > FAR
        else []
    )


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A path of the same name to write to, in a folder beside; renamed to `path` at the end, gone after an exception."""
    path = output_file(path)
    with part_folder(path) as folder:
        yield folder / path.name
        for picture in folder.glob("*/*"):  # what the file names comes first
            place = path.parent / picture.relative_to(folder)
            place.parent.mkdir(exist_ok=True)
            os.replace(picture, place)
        os.replace(folder / path.name, path)
