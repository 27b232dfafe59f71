"""Scans that a run makes on its way, of the pictures of frames that bring none: what `toile reconstruct` would write, kept
in RUN/scans."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from ..config import Config
from ..errors import UserError, first_line
from ..io.capture import Capture
from ..io.files import replace_file
from ..io.run_folder import scans_folder
from ..io.status import Status
from ..surface.poisson import check_poisson
from .reconstruct import MADE, made_of


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


def make_scan(capture: Capture, number: int, config: Config, status: Status) -> None:
    """Makes the scan of a frame that lacks one, where the settings ask for it and it is not there. A frame with keypoints
    goes on without, with a warning, where its pictures give none, or a depth to fewer pixels than `least_depth`.
    UserError: the same of a frame without keypoints."""
    assert capture.made is not None
    folder, start = capture.made / f"{number:06d}", time.perf_counter()
    if not config.make_scans or folder.exists() or not lacks_scan(capture, number):
        return
    try:
        check_poisson()
        made = made_of(capture, number, config)
        if made.depth < config.least_depth:
            raise UserError(f"frame {number}: too little to make a scan of: {made.said}")
    except UserError as error:
        if not (capture.folder(number) / "keypoints.json").exists():
            raise
        replace_file(folder, Path.mkdir)
        status.add(stage="stereo", ok=False, warning=f"registered without a scan: {first_line(error)}")
        return

    def write(part: Path) -> None:
        part.mkdir()
        made.write(part)

    replace_file(folder, write)
    seconds = time.perf_counter() - start
    status.add(frame=number, stage="stereo", seconds=seconds, ok=True, said=made.said)


def make_scans(capture: Capture, numbers: Iterable[int], config: Config, status: Status) -> dict[int, str]:
    """`make_scan` of each, one after the other; {number: why it failed}."""
    failed = {}
    for number in numbers:
        try:
            make_scan(capture, number, config, status)
        except Exception as error:
            failed[number] = first_line(error)
    return failed


def forget(capture: Capture, numbers: Iterable[int]) -> None:
    """The scans of these frames are made again."""
    for number in numbers:
        shutil.rmtree(Path(str(capture.made)) / f"{number:06d}", ignore_errors=True)
