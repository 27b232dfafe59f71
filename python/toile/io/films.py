"""Pictures of films, by PyAV: numbered in the order of showing from 0, whatever times they carry."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError
from ..kernels.arrays import Anything
from .bounded import check_file, reason_of
from .image import MAX_PIXELS

LATE = 1.5  # usual steps in time after which a picture shows that one before it is missing


def film_size(path: Path) -> tuple[int, int]:
    """(height, width) of a film's pictures, as they are shown (turned as its header says)."""
    with _opened(path) as container:
        for frame in _pictures(path, container):
            return _shown(frame).shape[:2]
    raise UserError(f"{path}: no picture in it")


def film_count(path: Path) -> int:
    """How many pictures a film has: what its header says, else they are counted."""
    with _opened(path) as container:
        return container.streams.video[0].frames or sum(1 for _ in _pictures(path, container))


def film_rate(path: Path) -> float:
    """Pictures a second on average, to a thousandth, as its header says; 0 where it does not."""
    with _opened(path) as container:
        return round(float(container.streams.video[0].average_rate or 0), 3)


def dropped(path: Path) -> tuple[int, int]:
    """(how many pictures a film lacks by the times of the others, as where a recorder dropped some; the picture before which
    the first is missing)."""
    with _opened(path) as container:
        times = np.array(sorted(packet.pts for packet in container.demux(video=0) if packet.pts is not None))
    steps = np.diff(times)
    usual = float(np.median(steps)) if len(steps) else 0.0
    late = np.flatnonzero(steps > LATE * usual) if usual > 0 else steps[:0]
    return (int(np.round(steps[late] / usual - 1).sum()), int(late[0]) + 1) if len(late) else (0, 0)


def decoded(path: Path, wanted: Iterable[int]) -> Iterator[tuple[int, Anything]]:
    """(index, (H,W,3) uint8) of the wanted pictures that the film has, in order."""
    left = set(wanted)
    with _opened(path) as container:
        for index, frame in enumerate(_pictures(path, container)):
            if index in left:
                left.remove(index)
                yield index, _shown(frame)
            if not left:
                return


@contextmanager
def _opened(path: Path) -> Any:
    try:
        import av
    except ImportError:
        raise UserError(f"{path}: films need PyAV: pip install 'toile[import]'") from None
    check_file(path)
    try:
        container = av.open(str(path))
    except (av.error.FFmpegError, ValueError) as error:
        raise UserError(f"{path}: not a film that can be read: {reason_of(error)}") from None
    with container:
        if not container.streams.video:
            raise UserError(f"{path}: no pictures in it")
        codec = container.streams.video[0].codec_context
        if codec.width * codec.height > MAX_PIXELS:
            raise UserError(f"{path}: {codec.width} x {codec.height} pixels, at most {MAX_PIXELS} are read")
        yield container


def _pictures(path: Path, container: Any) -> Iterator[Any]:
    import av

    try:
        yield from container.decode(video=0)
    except av.error.FFmpegError as error:
        raise UserError(f"{path}: cannot be decoded: {reason_of(error)}") from None


def _shown(frame: Any) -> Anything:
    picture = frame.to_ndarray(format="rgb24")
    return np.ascontiguousarray(np.rot90(picture, round(getattr(frame, "rotation", 0) / 90) % 4))
