"""What is wrong with the files of a capture's frames: every one of them is read and decoded."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from ..errors import UserError, first_line
from ..kernels import threads
from .capture import MODES, Capture


def faults(capture: Capture, numbers: Sequence[int]) -> Iterator[tuple[int, list[str]]]:
    """(frame, a line a bad file that names it) of each of the frames, in their order; several are read at once."""
    with ThreadPoolExecutor(threads()) as pool:
        yield from zip(numbers, pool.map(lambda number: faults_of(capture, number), numbers))


def faults_of(capture: Capture, number: int) -> list[str]:
    """A line a bad file of one frame, and one where it has nothing that could be registered."""
    found: list[str] = []

    def tried(read: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return read(*arguments)
        except (UserError, OSError, MemoryError) as error:
            found.append(first_line(error))

    scan, keypoints, points3d = (tried(read, number) for read in (capture.scan, capture.keypoints, capture.points3d))
    pictured = False
    for kind in MODES:
        files = tried(capture.picture_files, number, kind) or {}
        for camera, path in files.items():
            tried(capture.picture, kind, camera, path)
        pictured |= kind == "images" and bool(files)
    if not found and not pictured and scan is keypoints is points3d is None:
        found.append(f"{capture.folder(number)}: no scan, no keypoints and no pictures")
    return found
