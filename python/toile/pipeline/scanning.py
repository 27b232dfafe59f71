"""Scans that a run makes on its way, of the pictures of frames that bring none: what `toile reconstruct` would write, kept
in RUN/scans."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

from ..config import Config
from ..errors import RoomError, UserError, first_line
from ..io.capture import Capture
from ..io.files import replace_file, write_text
from ..io.run_folder import scans_folder
from ..io.status import Status
from ..surface.poisson import check_poisson, load_poisson
from .blocks import raise_where_disk
from .identity import Identities
from .reconstruct import MADE, made_of

NONE = "none"  # a file beside the frames' folders: sampled frames gave no scan
MADE_OF = "made_of"  # a file in a frame's folder: the identity of what it was made of


def kept_in(run: Path | str, capture: Capture) -> Capture:
    """The capture with the scans that the run makes of it."""
    return replace(capture, made=scans_folder(run))


def lacks_scan(capture: Capture, number: int) -> bool:
    """Does a frame bring neither a scan nor keypoints in space, but pictures of two cameras with a mask or labels? False
    where it is at fault, which reading it tells."""
    try:
        if any(os.path.lexists(capture.folder(number) / name) for name in MADE):
            return False
        shown = {*capture.masked(number), *capture.labelled(number)}
        return len(shown.intersection(capture.pictured(number))) >= 2
    except UserError:
        return False


def load_libraries(capture: Capture, numbers: Iterable[int], config: Config) -> None:
    """In the main thread, before others make scans of any of these frames."""
    if config.make_scans and any(lacks_scan(capture, number) for number in numbers):
        load_poisson()


def make_scan(capture: Capture, number: int, config: Config, status: Status, identities: Identities) -> None:
    """Makes the scan of a frame that lacks one, where the settings ask for it and it is not there, or of something else. A frame with keypoints
    goes on without, with a warning, where its pictures give none, or a depth to fewer pixels than `least_depth`.
    UserError: the same of a frame without keypoints, and of any where memory is lacking: what is free must not change results."""
    folder, start = _folder(capture, number), time.perf_counter()
    asked = config.make_scans and _text(folder.parent / NONE) != identities.stages["scan"]
    identity = identities.inputs(number)
    if (folder.exists() and _text(folder / MADE_OF) != identity) or not config.make_scans:
        shutil.rmtree(folder, ignore_errors=True)
    if not asked or folder.exists() or not lacks_scan(capture, number):
        return

    for left in folder.parent.glob(f".{folder.name}.*.part"):  # of a killed process
        shutil.rmtree(left, ignore_errors=True)

    def write(part: Path, give: Callable[[Path], None] = lambda part: None) -> None:
        part.mkdir()
        give(part)
        (part / MADE_OF).write_text(identity)

    try:
        check_poisson()
        made = made_of(capture, number, config)
        if made.depth < config.least_depth:
            raise UserError(f"frame {number}: too little to make a scan of: {made.said}")
    except UserError as error:
        if isinstance(error, RoomError) or not (capture.folder(number) / "keypoints.json").exists():
            raise
        replace_file(folder, write)
        status.add(stage="stereo", ok=False, warning=f"registered without a scan: {first_line(error)}")
        return

    replace_file(folder, lambda part: write(part, made.write))
    seconds = time.perf_counter() - start
    status.add(frame=number, stage="stereo", seconds=seconds, ok=True, said=made.said)


def make_scans(
    capture: Capture, numbers: Iterable[int], config: Config, status: Status, identities: Identities
) -> dict[int, str]:
    """`make_scan` of sampled frames, one after the other; {number: why it failed}. Where all of those that lack a scan go
    on with their keypoints alone, no other frame's is tried."""
    failed: dict[int, str] = {}
    status.forget("stereo")
    tried = [number for number in numbers if config.make_scans and lacks_scan(capture, number)]
    for number in tried:
        try:
            make_scan(capture, number, config, status, identities)
        except Exception as error:
            raise_where_disk(error)
            failed[number] = first_line(error)
    found = [number for number in tried if (_folder(capture, number) / MADE[0]).exists()]
    if tried and not found and not failed:
        write_text(_folder(capture, tried[0]).parent / NONE, identities.stages["scan"])
        status.add(
            stage="stereo", ok=False, warning=f"the pictures of {len(tried)} sampled frames gave no scan: none is made"
        )
    return failed


def _text(path: Path) -> str:
    return path.read_text() if path.exists() else ""


def _folder(capture: Capture, number: int) -> Path:
    """Where what is made of a frame is kept."""
    assert capture.made is not None
    return capture.made / f"{number:06d}"
