"""Scans and 3D keypoints of a capture's pictures, as another capture: what `toile reconstruct` does."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from pathlib import Path

from ..errors import UserError, first_line
from ..io.files import replace_file
from ..io.importing import link
from ..io.keypoints import keypoints3d_json, read_keypoints
from ..io.memory import free_memory
from ..io.mesh import write_mesh
from ..io.scene_file import METRES
from ..scene import Mesh, Points3D
from ..stages.reconstruct import triangulate
from ..stages.stereo import scan
from .workers import Workers, check_workers, everywhere

MADE = "scan.ply", "keypoints3d.json"


@dataclass(frozen=True)
class Made:
    """What the pictures of a frame gave: the scan in the capture's units, keypoints in space where it has 2D ones, the
    share of the masks' pixels that have a depth, and what became of the others in words."""

    scan: Mesh
    points: Points3D | None
    depth: float
    said: str

    def write(self, folder):
        """scan.ply and keypoints3d.json."""
        write_mesh(folder / "scan.ply", self.scan)
        if self.points is not None:
            (folder / "keypoints3d.json").write_text(keypoints3d_json(self.points), encoding="utf-8")


@dataclass(frozen=True)
class Reconstructed:
    """Numbers of the frames that were made now and that were there; the failed ones with their reasons; a line a frame of
    what the pictures gave."""

    made: tuple[int, ...]
    kept: tuple[int, ...]
    failed: dict[int, str]
    said: tuple[str, ...]


def reconstruct(capture, out, settings, frames, progress=None, workers=1, scheduler=None):
    """Writes a capture `out` that has all of `capture` and, in these frames, scan.ply (a confidence a vertex) and
    keypoints3d.json. `settings` ScanConfig. Pictures are linked, or copied where links do not do. A frame is written whole or
    not at all; frames that are there are left alone, so a stopped call goes on. A frame that fails stops no other. `workers`
    processes share the frames, or those of a running dask `scheduler`; without either one frame has all threads.
    UserError: `out` is the capture, or holds something else."""
    check_workers(workers, scheduler)
    out = everywhere(Path(out), scheduler)
    capture = replace(capture, root=everywhere(capture.root, scheduler))
    if out.resolve() == capture.root.resolve():
        raise UserError(f"{out}: is the capture itself; scans are written into another folder")
    _begin(capture.root, out)
    there = {number for number in frames if _folder(out, number).exists()}
    left, made, failed = [number for number in frames if number not in there], {}, {}
    with Workers(min(workers, max(len(left), 1)), _prepared, capture, out, settings, scheduler=scheduler) as pool:
        for done, (number, said, why) in enumerate(pool.each(_frame, left), len(there) + 1):
            (made if why is None else failed)[number] = said if why is None else why
            if progress is not None:
                progress("reconstruct", done, len(frames))
    said = tuple(f"frame {number}: {made[number]}" for number in frames if number in made)
    failed = {number: failed[number] for number in frames if number in failed}
    return Reconstructed(tuple(n for n in frames if n in made), tuple(n for n in frames if n in there), failed, said)


def _prepared(capture, out, settings):
    return capture, out, settings


def _folder(out, number):
    return out / "frames" / f"{number:06d}"


def _begin(root, out):
    """All of the capture but its frames; what is there stays."""
    if out.exists() and (not out.is_dir() or (any(out.iterdir()) and not (out / "scene.toml").exists())):
        raise UserError(f"{out}: is there already, and is no capture")
    for path in sorted(root.iterdir()):
        if path.name == "frames" or (out / path.name).exists():
            continue
        whole = lambda part, path=path: (
            shutil.copytree(path, part, copy_function=_linked) if path.is_dir() else _linked(path, part)
        )
        replace_file(out / path.name, whole)
    (out / "frames").mkdir(parents=True, exist_ok=True)


def _linked(source, path):
    link(Path(source), Path(path), copy=False)


def made_of(capture, number, settings):
    """What the pictures and keypoints of one frame give; `settings` has those of `stereo` and `reconstruct`. UserError: no
    pictures or masks, or no surface is found."""
    frame = capture.pictures(number)
    if not frame.images:
        raise UserError(f"{capture.folder(number) / 'images'}: no pictures")
    found = scan(frame.images, frame.silhouettes, capture.cameras, settings.stereo, free_memory())
    mesh = replace(found.scan, vertices=found.scan.vertices / METRES[capture.scene.units])
    keypoints = capture.folder(number) / "keypoints.json"
    points = None
    if keypoints.exists():
        points = triangulate(read_keypoints(keypoints, capture.cameras), capture.cameras, settings.reconstruct)
    return Made(mesh, points, found.depth, _told(found))


def _frame(prepared, number):
    """Writes one frame; yields (its number, what its pictures gave, in words, None), or why it failed as the last."""
    capture, out, settings = prepared
    try:
        made = made_of(capture, number, settings)

        def write(part):
            ignored = shutil.ignore_patterns(*MADE)
            shutil.copytree(capture.folder(number), part, copy_function=_linked, ignore=ignored)
            made.write(part)

        replace_file(_folder(out, number), write)
        yield number, made.said, None
    except UserError as error:
        yield number, "", first_line(error)


def _told(found):
    """Shares of the masks' pixels, in words."""
    holes = ", ".join(f"{why} {100 * share:.1f} %" for why, share in found.holes.items() if share >= 0.0005)
    return f"{100 * found.depth:.1f} % of the person's pixels have a depth; holes: {holes or 'none'}"
